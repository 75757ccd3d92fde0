"""Flies a sweep: every trial of a grid once, over any number of interruptions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias

import msgspec

from llm_flock.errors import InputError
from llm_flock.llm import Budget, Rate, check_priced, parse_base_urls
from llm_flock.runtime import check_planners
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.executors import Display, Session, fly_here, fly_in_pool
from llm_flock_lab._experiments.executors_ray import fly_on_cluster
from llm_flock_lab._experiments.grid import TrialSpec
from llm_flock_lab._experiments.store import Store, read_json, read_trial, trial_files, write_whole
from llm_flock_lab._experiments.sweep_file import Sweep
from llm_flock_lab._experiments.trial import KeepRecords, TrialResult, code_version

Executor: TypeAlias = Literal["auto", "one", "pool"]

SWEEP_NAME = "sweep.toml"
PLAN_NAME = "plan.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepStatus:
    """Progress of a sweep, counted in trials; of the finished ones, `formed`, `broken` and `other_code`."""

    trials: int
    finished: int
    formed: int
    broken: int
    cut: int  # by the sweep's budget; flown again when there is one
    other_code: int
    reason: str | None = None  # limit of the budget that is used up

    @property
    def complete(self) -> bool:
        return self.finished == self.trials


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
) -> SweepStatus:
    """Fly all trials of a sweep that are not finished yet, and build its tables.

    Args:
        sweep: as `load_sweep` reads it.
        folder: directory of results. A sweep that was started there goes on.
        executor: `one` process, for trials that wait for answers; a `pool`, for those that compute; `auto` chooses.
        cluster: address of a Ray cluster, used instead.
        jobs: processes of a pool; workers of a cluster if more than 1.
        at_once: trials in flight at once in one process.
        keep: trials whose record is kept; None: as the file says.
        again: fly trials again that broke off, after the cause was fixed; the tables say so.
        display: shows what happens.

    Raises:
        InputError: a value is not allowed, or `folder` holds another sweep; nothing has been flown then.
        FlockError: results cannot be kept, or a worker was killed.
        KeyboardInterrupt: everything that was finished is kept, and in the tables.
    """
    limits = sweep.file.budget
    budget = Budget(max_calls=limits.max_calls, max_tokens=limits.max_tokens, max_cost_usd=limits.max_cost)
    rates = {name: Rate(**table.model_dump()) for name, table in sweep.file.providers.items()}
    shares = budget.max_calls is not None or budget.max_tokens is not None or "simulated" in rates
    limited = shares or ((budget.max_cost_usd is not None or bool(rates)) and any(spec.waits for spec in sweep.trials))
    if executor == "pool" and cluster is None and limited:
        raise InputError("executor", executor, "one or auto, as a budget or a rate is shared by all trials")
    if any(model.startswith("local:") for spec in sweep.trials for model in spec.models):
        # Each process would load an engine, all of them on the same cores.
        if executor == "pool" and cluster is None:
            raise InputError("executor", executor, "one or auto with models on board, which share an engine")
        if cluster is not None:
            says = "cannot be used with models on board, which share an engine in one process"
            raise InputError("cluster", cluster, says=says)
    _check(sweep)
    store, display = Store(folder), display or Display()
    keep = keep or sweep.file.sweep.keep_records
    session = Session(store=store, display=display, keep=keep, budget=budget, rates=rates, at_once=at_once)
    with store.held():
        _register(sweep, store)
        flown = load_flown(sweep, store)
        pending = _pending(sweep, flown, again=again)
        display.begin(flown.values(), pending)
        try:
            if cluster is not None:
                fly_on_cluster(pending, session, cluster, jobs if jobs > 1 else None)
            else:
                pooled = {
                    s.id for s in pending if executor == "pool" or (executor == "auto" and not (s.waits or shares))
                }
                fly_in_pool([spec for spec in pending if spec.id in pooled], session, jobs)
                fly_here([spec for spec in pending if spec.id not in pooled], session)
        finally:
            tables.build_tables(folder)
        return _status(sweep, store, session.reason)


def _register(sweep: Sweep, store: Store) -> None:
    """Write into the directory which sweep it belongs to. A sweep may gain trials later, but not lose any."""
    plan = {spec.id: (spec.cell, str(spec.seed)) for spec in sweep.trials}
    path = store.folder / PLAN_NAME
    if path.exists():
        known = read_json(path, dict[str, tuple[str, str]], "the trials of a sweep")
        gone = [f"{cell}, seed {seed}" for trial, (cell, seed) in known.items() if plan.get(trial) != (cell, seed)]
        if gone:
            shown = "; ".join(gone[:3]) + (" ..." if len(gone) > 3 else "")
            raise InputError(
                "out",
                str(store.folder),
                f"a directory of this sweep: {len(gone)} of its {len(known)} trials are not in what was given, or "
                f"stored under another label ({shown}). A sweep may get more trials; others need another directory",
            )
    write_whole(path, msgspec.json.encode(plan))
    write_whole(store.folder / SWEEP_NAME, sweep.text.encode())


def _check(sweep: Sweep) -> None:
    """Refuse a sweep whose models cannot be asked: missing keys, wrong addresses or prompts, unknown prices."""
    for spec in {spec.cell: spec for spec in sweep.trials}.values():
        check_priced(sweep.file.budget.max_cost, spec.models, parse_base_urls(spec.config.model.base_url, spec.models))
        check_planners(spec.config)


def load_flown(sweep: Sweep, store: Store) -> dict[str, TrialResult]:
    """The results of this sweep's trials so far by their id, cut ones included."""
    wanted = {spec.id for spec in sweep.trials}
    return {path.stem: read_trial(path) for path in trial_files(store.folder) if path.stem in wanted}


def _pending(sweep: Sweep, flown: Mapping[str, TrialResult], *, again: bool) -> list[TrialSpec]:
    found: list[TrialSpec] = []
    for spec in sweep.trials:
        known = flown.get(spec.id)
        if known is None:
            found.append(spec)
        elif known.cut or (again and known.error is not None):
            found.append(replace(spec, earlier=known.as_earlier()))
    return found


def _status(sweep: Sweep, store: Store, reason: str | None) -> SweepStatus:
    trials = load_flown(sweep, store).values()
    over = [trial for trial in trials if not trial.cut]
    return SweepStatus(
        trials=len(sweep.trials),
        finished=len(over),
        formed=sum(trial.formed for trial in over),
        broken=sum(trial.error is not None for trial in over),
        cut=len(trials) - len(over),
        other_code=sum(trial.code != code_version() for trial in over),
        reason=reason,
    )
