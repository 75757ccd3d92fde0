"""Fly trials: in this process, where many wait for answers at once, or in a pool of processes.

A trial depends only on its configuration, so its result is the same in either of them and on a cluster
(`executors_ray`).
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import shutil
import signal
import threading
from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path
from typing import TypeAlias

import msgspec

from llm_flock.errors import FlockError
from llm_flock.llm import Budget, CallLane, ModelPool, Rate, SharedGate, Spent
from llm_flock_lab._experiments.grid import TrialSpec
from llm_flock_lab._experiments.store import SpendingLog, Store
from llm_flock_lab._experiments.trial import KeepRecords, TrialResult, fly

try:
    import resource
except ImportError:  # pragma: no cover - systems without such limits
    resource = None


class Display:
    """Shows the progress of an experiment in the executor's thread; this one shows nothing. Override what is needed."""

    def begin(self, flown: Collection[TrialResult], pending: Sequence[TrialSpec]) -> None:
        """Called first, with the trials that exist already, and those to fly."""

    def finished(self, spec: TrialSpec, result: TrialResult) -> None:
        """Called when a trial is over. The result of a pool has no `config` and no `rounds`."""

    def spent(self, spent: Spent, reason: str | None) -> None:
        """Called with what all sessions have spent, and with the limit of the budget that is used up."""


@dataclass(slots=True, kw_only=True)
class Session:
    """Settings and state that all trials of an experiment share while they are flown."""

    store: Store | None  # None if nothing is kept, which only a pool allows
    display: Display
    keep: KeepRecords = "none"
    budget: Budget = field(default_factory=Budget)
    rates: Mapping[str, Rate] = field(default_factory=dict[str, Rate])
    at_once: int = 256  # trials in flight in a process, of those that wait for answers
    reason: str | None = None  # limit of the budget that is used up


Fly: TypeAlias = Callable[[TrialSpec], Awaitable[tuple[TrialResult, Path | bytes | None]]]
"""Flies a trial; returns its result and its record."""

State: TypeAlias = Callable[[], Awaitable[tuple[Spent, str | None, bool]]]
"""Returns what this session has spent, the limit that is used up, and whether to stop."""


async def fly_and_keep(spec: TrialSpec, store: Store | None, fly_it: Fly) -> TrialResult:
    result, record = await fly_it(spec)
    if store is not None:
        if record is not None:
            store.keep_record(spec.id, record)
        shutil.rmtree(store.scratch(spec.id), ignore_errors=True)
        store.save(result)
    return result


def fly_here(specs: Sequence[TrialSpec], session: Session) -> None:
    """Fly trials in this process: those that wait for answers at once, the others one after another."""
    if not specs:
        return
    if resource is not None:  # each call holds a connection: allow as many open files as the system lets us
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    asyncio.run(_fly_here(specs, session))


async def _fly_here(specs: Sequence[TrialSpec], session: Session) -> None:
    assert session.store is not None
    store, gate, pool = session.store, SharedGate(session.budget, session.rates), ModelPool()
    log = SpendingLog(store)
    gate.elsewhere = log.before

    async def fly_it(spec: TrialSpec) -> tuple[TrialResult, Path | None]:
        return await fly(spec, lane=CallLane(gate, pool), keep=session.keep, scratch=store.scratch(spec.id))

    async def state() -> tuple[Spent, str | None, bool]:
        return gate.spent, gate.reason, gate.exhausted

    try:
        await drive(specs, session, log, fly_it, state, computing=1)
    finally:
        await pool.aclose()


async def drive(
    specs: Sequence[TrialSpec], session: Session, log: SpendingLog, fly_it: Fly, state: State, *, computing: int
) -> None:
    """Fly trials until all are over or the budget is used up; of those that never wait, `computing` fly at once."""

    async def balance() -> None:
        own, reason, _ = await state()
        log.write(own)
        session.reason = reason or session.reason
        session.display.spent(own + log.before, reason)

    async def balance_regularly() -> None:
        while True:
            await asyncio.sleep(1.0)
            await balance()

    async def work(queue: Iterator[TrialSpec]) -> None:
        for spec in queue:
            if (await state())[2]:
                return
            session.display.finished(spec, await fly_and_keep(spec, session.store, fly_it))

    await balance()
    waiting = [spec for spec in specs if spec.waits]
    others = [spec for spec in specs if not spec.waits]
    balancing = asyncio.create_task(balance_regularly())
    try:
        async with asyncio.TaskGroup() as group:
            for found, workers in ((waiting, session.at_once), (others, computing)):
                queue = iter(found)
                for _ in range(min(workers, len(found))):
                    group.create_task(work(queue))
    except ExceptionGroup as errors:
        raise errors.exceptions[0] from None
    finally:
        balancing.cancel()
        await balance()


def fly_in_pool(specs: Sequence[TrialSpec], session: Session, jobs: int) -> None:
    """Fly trials that compute in a pool of spawned processes, which share the directory, but no budget and no rate.

    The display hears of them in their order, whichever finishes first.
    """
    if not specs:
        return
    others = set(multiprocessing.active_children())
    jobs = min(jobs, len(specs))
    pool = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker)
    log = None if session.store is None else SpendingLog(session.store)
    spent, done, finished = Spent(), 0, False
    try:
        for spec, result in zip(
            specs, pool.map(_fly_in_worker, specs, repeat(session.store), repeat(session.keep)), strict=True
        ):
            spent += result.spent
            if log is not None:
                log.write(spent)
            session.display.finished(spec, result)
            session.display.spent(spent, None)
            done += 1
        finished = True
    except BrokenProcessPool:
        again = "" if session.store is None else " The same command goes on"
        raise FlockError(f"a worker was killed after {done} trials; is there memory for {jobs} jobs?{again}") from None
    finally:
        if not finished:
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
        pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Let a worker end when its parent dies, which alone handles Ctrl-C: a terminal sends it to all of them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None, "runs in workers only"

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _fly_in_worker(spec: TrialSpec, store: Store | None, keep: KeepRecords) -> TrialResult:
    async def fly_it(spec: TrialSpec) -> tuple[TrialResult, Path | None]:
        return await fly(spec, keep=keep, scratch=None if store is None else store.scratch(spec.id))

    return msgspec.structs.replace(asyncio.run(fly_and_keep(spec, store, fly_it)), config={}, rounds={})
