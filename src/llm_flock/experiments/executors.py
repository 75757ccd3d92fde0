"""Where trials are flown: in this process, all waiting at once, or in a pool of processes.

A trial gives the same whichever it is (see `executors_ray` for a cluster): what happens in it depends on its
configuration alone.
"""

from __future__ import annotations

import asyncio
import multiprocessing
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from llm_flock.errors import FlockError
from llm_flock.experiments.store import Earlier, Ledger, Store, StoredTrial
from llm_flock.experiments.sweep_file import KeepRecords, TrialSpec
from llm_flock.experiments.sweep_trial import fly
from llm_flock.experiments.trials import end_with_parent, interrupts_held
from llm_flock.llm.limits import Budget
from llm_flock.llm.sharing import Lane, Pools, Rate, SharedGate, Spent
from llm_flock.runtime.trial import TrialProgress

try:
    import resource
except ImportError:  # pragma: no cover - systems without such limits
    resource = None

BOOKKEEPING_S = 1.0
"""What has been spent is written down so often [s]."""

AHEAD = 2
"""Trials handed to a pool beyond one for each of its processes: none of them waits for the next."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """A trial that is to be flown.

    Attributes:
        spec: the trial.
        tries: how often it had been flown when this was decided; if it has been again since, it is left as it is.
    """

    spec: TrialSpec
    tries: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Landed:
    """What a progress display has to know of a trial that is over.

    Attributes:
        fresh: whether this process has flown it; else somebody else had, in between.
        cut: the budget of the sweep ran out.
        error: what broke it off.
        spent: what it used.
        wall_s: duration [s].
    """

    fresh: bool
    formed: bool
    cut: bool
    error: str | None
    spent: Spent
    wall_s: float

    @classmethod
    def of(cls, trial: StoredTrial, *, fresh: bool) -> Landed:
        """From what is kept of it."""
        summary = trial.summary or {}
        spent = Spent(
            calls=summary.get("model_calls", 0),
            tokens=summary.get("tokens", 0),
            cost_usd=summary.get("cost_usd") or 0.0,
        )
        return cls(
            fresh=fresh,
            formed=trial.formed,
            cut=trial.cut,
            error=trial.error,
            spent=spent,
            wall_s=summary.get("wall_s", 0.0),
        )


class Watcher(Protocol):
    """Told of what happens, in the thread that flies."""

    def progress(self, flight: Flight, now: TrialProgress) -> None:
        """A trial has flown another round; only where trials are flown in this process."""
        ...

    def landed(self, flight: Flight, landed: Landed | None) -> None:
        """A trial is over; None: another process flies it right now."""
        ...

    def spent(self, spent: Spent, reason: str | None) -> None:
        """What all processes have spent, and which limit of the budget is used up."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What all trials of a sweep have in common while they are flown.

    Attributes:
        store: where results are kept.
        keep: trials whose record is kept.
        budget: of all trials together.
        rates: of each provider that has any.
        at_once: trials under way at once in a process, of those that wait for answers.
        watcher: told of what happens.
    """

    store: Store
    watcher: Watcher
    keep: KeepRecords = "none"
    budget: Budget = field(default_factory=Budget)
    rates: Mapping[str, Rate] = field(default_factory=dict[str, Rate])
    at_once: int = 256


Fly = Callable[[Flight, tuple[Earlier, ...]], Awaitable[tuple[StoredTrial, Path | bytes | None]]]


async def attend(flight: Flight, store: Store, fly_it: Fly) -> Landed | None:
    """Fly a trial and keep it, unless somebody else does or has; None while another process flies it."""
    trial = flight.spec.id
    claim = store.claim(trial)
    if claim is None:
        return None
    with claim:
        known = store.load(trial)
        if known is not None and known.tries != flight.tries:
            return Landed.of(known, fresh=False)
        flown, record = await fly_it(flight, () if known is None else known.as_earlier())
        if record is not None:
            store.keep_record(trial, record)
        _clear(store.scratch(trial))
        store.save(flown)
        return Landed.of(flown, fresh=True)


def _clear(scratch: Path) -> None:
    """Take away what a trial has left there: a record that is not kept."""
    with suppress(FileNotFoundError):
        for file in scratch.iterdir():
            file.unlink()
        scratch.rmdir()


# ---------------------------------------------------------------- one process


def fly_here(flights: Sequence[Flight], session: Session) -> None:
    """Fly all in this process: those that wait for answers at once, the others one after another.

    Raises:
        FlockError: results cannot be kept.
        KeyboardInterrupt: after all records were brought to a readable end.
    """
    if flights:
        _allow_open_files()
        asyncio.run(_fly_here(flights, session))


def _allow_open_files() -> None:
    """Every call under way has a connection: take as many open files as the system gives without asking."""
    if resource is not None:
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


async def _fly_here(flights: Sequence[Flight], session: Session) -> None:
    gate, pools = SharedGate(session.budget, session.rates), Pools()

    async def fly_it(flight: Flight, earlier: tuple[Earlier, ...]) -> tuple[StoredTrial, Path | None]:
        flown = await fly(
            flight.spec,
            lane=Lane(gate, pools),
            keep=session.keep,
            scratch=session.store.scratch(flight.spec.id),
            earlier=earlier,
            on_round=lambda now: session.watcher.progress(flight, now),
        )
        return flown.trial, flown.record

    try:
        await drive(flights, session, gate, fly_it, quick=1)
    finally:
        await pools.aclose()


class Books(Protocol):
    """What `drive` has to know of a gate."""

    @property
    def spent(self) -> Spent:
        """What this process has spent."""
        ...

    @property
    def reason(self) -> str | None:
        """Which limit of the budget is used up."""
        ...

    @property
    def exhausted(self) -> bool:
        """Whether a new call would be turned away."""
        ...

    def told_of(self, elsewhere: Spent) -> None:
        """What other processes have spent of the same budget."""
        ...


async def drive(flights: Sequence[Flight], session: Session, gate: Books, fly_it: Fly, *, quick: int) -> None:
    """Attend to all flights on this event loop, until all are over or the budget is used up.

    Args:
        flights: what is to be flown.
        session: what they have in common.
        gate: what they share.
        fly_it: flies one.
        quick: so many at once of those that never wait.
    """
    ledger = Ledger(session.store)

    def balance() -> None:
        ledger.write(gate.spent)
        others = ledger.others()
        gate.told_of(others)
        session.watcher.spent(gate.spent + others, gate.reason)

    async def keep_books() -> None:
        while True:
            balance()
            await asyncio.sleep(BOOKKEEPING_S)

    async def work(queue: Iterator[Flight]) -> None:
        for flight in queue:
            if gate.exhausted:
                return
            session.watcher.landed(flight, await attend(flight, session.store, fly_it))

    balance()
    waiting = [flight for flight in flights if flight.spec.waits]
    others = [flight for flight in flights if not flight.spec.waits]
    queues = [(iter(waiting), min(session.at_once, len(waiting))), (iter(others), min(quick, len(others)))]
    books = asyncio.create_task(keep_books())
    try:
        async with asyncio.TaskGroup() as group:
            for queue, workers in queues:
                for _ in range(workers):
                    group.create_task(work(queue))
    except ExceptionGroup as errors:
        raise errors.exceptions[0] from None
    finally:
        books.cancel()
        balance()


# ---------------------------------------------------------------- a pool of processes


def fly_in_pool(flights: Sequence[Flight], session: Session, jobs: int) -> None:
    """Fly all in a pool of processes, for trials that compute and do not wait.

    Each process keeps its trials itself, so that a kill loses those in flight and no others. Nothing is shared but
    the directory: budgets and rates need `fly_here`. Workers are started afresh (`spawn`): a script that calls this
    needs its `if __name__ == "__main__":` guard.

    Raises:
        FlockError: a worker was killed, or results cannot be kept.
        KeyboardInterrupt: after all workers were stopped.
    """
    if not flights:
        return
    others = set(multiprocessing.active_children())
    jobs = min(jobs, len(flights))
    pool = ProcessPoolExecutor(
        jobs,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin,
        initargs=(session.store.folder, session.keep),
    )
    ledger, spent, over = Ledger(session.store), Spent(), False
    queue = iter(flights)
    under_way: dict[Future[Landed | None], Flight] = {}

    def submit(count: int) -> None:
        for _, flight in zip(range(count), queue, strict=False):
            under_way[pool.submit(_fly_in_worker, flight)] = flight

    try:
        with interrupts_held():
            submit(jobs + AHEAD)
        while under_way:
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                flight, landed = under_way.pop(future), future.result()
                if landed is not None and landed.fresh:
                    spent += landed.spent
                    ledger.write(spent)
                session.watcher.landed(flight, landed)
                session.watcher.spent(spent, None)
                submit(1)
        over = True
    except BrokenProcessPool:
        raise FlockError(f"a worker was killed; is there memory for {jobs} jobs? The same command goes on") from None
    finally:
        if not over:
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
        pool.shutdown(cancel_futures=True)


_in_worker: dict[str, tuple[Store, KeepRecords]] = {}
"""What a worker was told when it began."""


def _begin(folder: Path, keep: KeepRecords) -> None:
    end_with_parent()
    _in_worker["session"] = Store(folder), keep


def _fly_in_worker(flight: Flight) -> Landed | None:
    store, keep = _in_worker["session"]

    async def fly_it(flight: Flight, earlier: tuple[Earlier, ...]) -> tuple[StoredTrial, Path | None]:
        scratch = store.scratch(flight.spec.id)
        flown = await fly(flight.spec, lane=Lane(), keep=keep, scratch=scratch, earlier=earlier)
        return flown.trial, flown.record

    return asyncio.run(attend(flight, store, fly_it))
