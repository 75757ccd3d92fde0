"""Flies a sweep: all trials of a grid, each of them once, whatever happens in between."""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, TypeAlias

import msgspec

from llm_flock.errors import InputError
from llm_flock.experiments import tables
from llm_flock.experiments.executors import Flight, Landed, Session, Watcher, fly_here, fly_in_pool
from llm_flock.experiments.executors_ray import fly_on_cluster
from llm_flock.experiments.store import Store, StoredTrial, read_trial, trial_files, write_whole
from llm_flock.experiments.sweep_file import KeepRecords, Sweep, TrialSpec
from llm_flock.experiments.sweep_trial import code_version
from llm_flock.llm.models import check_priced, parse_base_urls
from llm_flock.llm.sharing import Spent
from llm_flock.runtime.team import Thinkers
from llm_flock.runtime.trial import TrialProgress

Executor: TypeAlias = Literal["auto", "one", "pool"]

ELSEWHERE_S = 0.5
"""Trials that another process flies are looked after so often [s]."""

SWEEP_NAME = "sweep.toml"
PLAN_NAME = "plan.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """How far a sweep has come.

    Attributes:
        trials: all of them.
        finished: those that need not be flown again.
        formed: of these, those that formed.
        broken: of these, those that broke off.
        cut: trials that the budget of the sweep cut short; they are flown again when there is one.
        other_code: finished trials that another version of the code has flown.
        reason: which limit of the budget is used up.
    """

    trials: int
    finished: int
    formed: int
    broken: int
    cut: int
    other_code: int
    reason: str | None = None

    @property
    def complete(self) -> bool:
        """Whether nothing is left to be flown."""
        return self.finished == self.trials


class Display(Watcher, Protocol):
    """A `Watcher` that is first told what there is."""

    def begin(self, flown: Mapping[str, Sequence[StoredTrial]], pending: Sequence[Flight]) -> None:
        """Trials that are there already, by cell, and those that will be flown."""
        ...


class Silent:
    """A display that shows nothing."""

    def begin(self, flown: Mapping[str, Sequence[StoredTrial]], pending: Sequence[Flight]) -> None:
        """Ignored."""

    def progress(self, flight: Flight, now: TrialProgress) -> None:
        """Ignored."""

    def landed(self, flight: Flight, landed: Landed | None) -> None:
        """Ignored."""

    def spent(self, spent: Spent, reason: str | None) -> None:
        """Ignored."""


@dataclass
class _Relay:
    """Passes everything on to a display, and remembers what the loop in `fly_sweep` has to know."""

    display: Display
    reason: str | None = None
    elsewhere: list[Flight] = field(default_factory=list[Flight])

    def progress(self, flight: Flight, now: TrialProgress) -> None:
        """See `Watcher`."""
        self.display.progress(flight, now)

    def landed(self, flight: Flight, landed: Landed | None) -> None:
        """See `Watcher`."""
        if landed is None:
            self.elsewhere.append(flight)
        else:
            self.display.landed(flight, landed)

    def spent(self, spent: Spent, reason: str | None) -> None:
        """See `Watcher`."""
        self.reason = reason or self.reason
        self.display.spent(spent, reason)


def fly_sweep(
    sweep: Sweep,
    folder: Path,
    *,
    executor: Executor = "auto",
    cluster: str | None = None,
    jobs: int = 1,
    at_once: int = 256,
    keep: KeepRecords | None = None,
    again: bool = False,
    display: Display | None = None,
) -> Standing:
    """Fly all trials of a sweep that are not there yet, and build its tables.

    Args:
        sweep: what is to be flown.
        folder: directory of results; a sweep that was begun there goes on.
        executor: `one` process, for trials that wait for answers; a `pool` of them, for those that compute; `auto`
            takes for each trial what fits it.
        cluster: address of a Ray cluster, used instead.
        jobs: processes of a pool; workers of a cluster if more than 1.
        at_once: trials under way at once in one process.
        keep: trials whose record is kept; None: as the file says.
        again: fly trials again that broke off, after the reason for it was cured; the tables say so.
        display: told of what happens.

    Raises:
        InputError: a value is not allowed, or `folder` holds another sweep; nothing has been flown then.
        FlockError: results cannot be kept, or a worker was killed.
        KeyboardInterrupt: everything that was finished is kept, and in the tables.
    """
    limits = sweep.file.budget
    rates = {name: table.rate() for name, table in sweep.file.providers.items()}
    shares = limits.max_calls is not None or limits.max_tokens is not None or "simulated" in rates
    limited = shares or ((limits.max_cost is not None or bool(rates)) and any(spec.waits for spec in sweep.trials))
    if executor == "pool" and cluster is None and limited:
        raise InputError("executor", executor, "one or auto, as a budget or a rate is shared by all trials")
    if any(model.startswith("local:") for spec in sweep.trials for model in spec.models):
        # Each process would have an engine, all of them on the same cores.
        if executor == "pool" and cluster is None:
            raise InputError("executor", executor, "one or auto with models on board, which share an engine")
        if cluster is not None:
            raise InputError("cluster", cluster, "nothing with models on board, which share an engine in one process")
    check(sweep)
    store = Store(folder)
    register(sweep, store)
    relay = _Relay(display or Silent())
    session = Session(
        store=store,
        watcher=relay,
        keep=keep or sweep.file.sweep.keep_records,
        budget=limits.budget(),
        rates=rates,
        at_once=at_once,
    )
    flown = load_flown(sweep, store)
    pending = _pending(sweep, flown, again=again)
    cells: defaultdict[str, list[StoredTrial]] = defaultdict(list)
    for trial in flown.values():
        cells[trial.cell].append(trial)
    relay.display.begin(cells, pending)
    try:
        while pending:
            relay.elsewhere = []
            if cluster is not None:
                fly_on_cluster(pending, session, cluster, jobs if jobs > 1 else None)
            else:
                compute = [f for f in pending if _in_pool(f.spec, executor, shares=shares)]
                fly_in_pool(compute, session, jobs)
                fly_here([f for f in pending if not _in_pool(f.spec, executor, shares=shares)], session)
            pending = relay.elsewhere
            if pending:
                time.sleep(ELSEWHERE_S)
    finally:
        tables.build_tables(folder)
    return stand(sweep, store, relay.reason)


def register(sweep: Sweep, store: Store) -> None:
    """Note what this directory is about; a sweep that was begun there may have got more trials, but none less.

    Raises:
        InputError: the directory holds another sweep.
    """
    plan = {spec.id: [spec.cell, str(spec.seed)] for spec in sweep.trials}
    path = store.folder / PLAN_NAME
    with store.wait_for("plan"):
        if path.exists():
            known = msgspec.json.decode(path.read_bytes(), type=dict[str, list[str]])
            gone = [f"{cell}, seed {seed}" for trial, (cell, seed) in known.items() if plan.get(trial) != [cell, seed]]
            if gone:
                shown = "; ".join(gone[:3]) + (" ..." if len(gone) > 3 else "")
                raise InputError(
                    "out",
                    str(store.folder),
                    f"a directory of this sweep: {len(gone)} of its {len(known)} trials are not in what was given, or "
                    f"there under another name ({shown}). A sweep may get more trials; others need another directory",
                )
        write_whole(path, msgspec.json.encode(plan))
        write_whole(store.folder / SWEEP_NAME, sweep.text.encode())


def check(sweep: Sweep) -> None:
    """Refuse what no model could answer: keys that are missing, addresses, prompts, prices that nobody knows.

    Raises:
        InputError: naming it.
    """
    seen: set[str] = set()
    for spec in sweep.trials:
        if spec.cell in seen:
            continue
        seen.add(spec.cell)
        check_priced(sweep.file.budget.max_cost, spec.models, parse_base_urls(spec.config.model.base_url, spec.models))
        asyncio.run(Thinkers(spec.config).close())


def load_flown(sweep: Sweep, store: Store) -> dict[str, StoredTrial]:
    """Trials of this sweep that are there, cut ones included, by their id.

    Raises:
        RecordError: one of them is damaged.
    """
    wanted = {spec.id for spec in sweep.trials}
    paths = [path for path in trial_files(store.folder) if path.stem in wanted]
    return {path.stem: read_trial(path) for path in paths}


def _pending(sweep: Sweep, flown: Mapping[str, StoredTrial], *, again: bool) -> list[Flight]:
    found: list[Flight] = []
    for spec in sweep.trials:
        known = flown.get(spec.id)
        if known is None:
            found.append(Flight(spec=spec))
        elif known.cut or (again and known.error is not None):
            found.append(Flight(spec=spec, tries=known.tries))
    return found


def _in_pool(spec: TrialSpec, executor: Executor, *, shares: bool) -> bool:
    return executor == "pool" or (executor == "auto" and not spec.waits and not shares)


def stand(sweep: Sweep, store: Store, reason: str | None = None) -> Standing:
    """How far a sweep has come, from what is in its directory."""
    trials = load_flown(sweep, store).values()
    over = [trial for trial in trials if not trial.cut]
    return Standing(
        trials=len(sweep.trials),
        finished=len(over),
        formed=sum(trial.formed for trial in over),
        broken=sum(trial.error is not None for trial in over),
        cut=len(trials) - len(over),
        other_code=sum(trial.code != code_version() for trial in over),
        reason=reason,
    )
