"""Fly trials on a Ray cluster (the extra `cluster`): workers fly them, this process keeps the results.

There is one worker for each processor, an actor that runs an event loop. Budget and rates are kept by one more actor,
which each call of a model asks first. Workers need the same version of this package, and the keys of models in their
environment: keys are never sent over the cluster.
"""

from __future__ import annotations

import asyncio
import itertools
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from llm_flock.errors import BudgetExceeded, FlockError, InputError
from llm_flock.extras import require
from llm_flock.llm import Budget, CallLane, ModelPool, Rate, SharedGate, Spent, Usage
from llm_flock_lab._experiments.executors import Session, drive
from llm_flock_lab._experiments.grid import TrialSpec
from llm_flock_lab._experiments.store import SpendingLog
from llm_flock_lab._experiments.trial import KeepRecords, TrialResult, code_version, fly

TRIES = 3  # how often a trial is flown before the sweep gives up, if its worker is lost each time


def fly_on_cluster(specs: Sequence[TrialSpec], session: Session, address: str, jobs: int | None) -> None:
    """Fly trials on a Ray cluster, with a worker for each of its processors unless `jobs` says how many."""
    if not specs:
        return
    require("cluster", "sweep --cluster")
    import ray

    remote: Any = ray
    try:
        remote.init(address=address, log_to_driver=False, logging_level="error")
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise InputError("cluster", address, f"the address of a Ray cluster that runs ({error})") from None
    try:
        asyncio.run(_fly(remote, specs, session, jobs))
    finally:
        remote.shutdown()


async def _fly(ray: Any, specs: Sequence[TrialSpec], session: Session, jobs: int | None) -> None:
    count = min(jobs or max(1, int(ray.cluster_resources().get("CPU", 1))), len(specs))
    assert session.store is not None
    log = SpendingLog(session.store)
    make_gate = ray.remote(max_concurrency=100_000, num_cpus=0)(_GateActor)  # calls that may wait there
    gate = make_gate.remote(session.budget, session.rates, log.before)
    make = ray.remote(num_cpus=1, max_concurrency=session.at_once)(_Worker)
    names = itertools.count()

    def start() -> tuple[int, Any]:
        """A new worker: the name by which the gate knows it, and its actor."""
        name = next(names)
        return name, make.remote(session.keep, gate, name)

    workers = [start() for _ in range(count)]
    version = await workers[0][1].version.remote()
    if version != code_version():
        raise InputError("cluster", version, f"a cluster with the version that is here: {code_version()}")
    # A worker is in the queue once for each trial that it may fly at once, in turns, so that all get the same share.
    free: asyncio.Queue[int] = asyncio.Queue()
    for _ in range(-(-session.at_once // count)):
        for place in range(count):
            free.put_nowait(place)

    async def fly_it(spec: TrialSpec) -> tuple[TrialResult, bytes | None]:
        for _ in range(TRIES):
            place = await free.get()
            name, actor = workers[place]
            try:
                data, record = await actor.fly.remote(spec)
                return msgspec.json.decode(data, type=TrialResult), record
            except ray.exceptions.RayActorError:
                if workers[place][0] == name:  # no other trial has noticed yet
                    await gate.forget.remote(name)
                    workers[place] = start()
            finally:
                free.put_nowait(place)
        raise FlockError(f"workers of the cluster were lost {TRIES} times with {spec.cell}")

    async def state() -> tuple[Spent, str | None, bool]:
        return await gate.state.remote()

    await drive(specs, session, log, fly_it, state, computing=count)


class _Worker:
    """Flies trials on one event loop."""

    def __init__(self, keep: KeepRecords, gate: Any, name: int) -> None:
        self._keep: KeepRecords = keep
        self._gate = _RemoteGate(gate, name)
        self._pool = ModelPool()

    async def version(self) -> str:
        return code_version()

    async def fly(self, spec: TrialSpec) -> tuple[bytes, bytes | None]:
        with tempfile.TemporaryDirectory(prefix="llm-flock-") as folder:
            lane, scratch = CallLane(self._gate, self._pool), Path(folder) / "record"
            result, record = await fly(spec, lane=lane, keep=self._keep, scratch=scratch)
            return msgspec.json.encode(result), None if record is None else record.read_bytes()


class _GateActor:
    """The gate of all workers. It returns refusals instead of raising them, as the cluster is not at fault."""

    def __init__(self, budget: Budget, rates: Mapping[str, Rate], spent_before: Spent) -> None:
        self._gate = SharedGate(budget, rates)
        self._gate.elsewhere = spent_before
        self._tickets: dict[int, int] = {}

    async def enter(self, worker: int, model: str, chars: int, again: bool) -> int | str:
        """Let a call in; returns a ticket, or the reason why there is none."""
        try:
            ticket = await self._gate.enter(model, chars, again=again)
        except BudgetExceeded as error:
            return error.detail
        self._tickets[ticket] = worker
        return ticket

    async def leave(self, ticket: int, usage: Usage | None, cost: float | None) -> None:
        if self._tickets.pop(ticket, None) is not None:
            self._gate.leave(ticket, usage, cost)

    async def forget(self, worker: int) -> None:
        """End all calls of a worker that was lost."""
        for ticket in [ticket for ticket, owner in self._tickets.items() if owner == worker]:
            await self.leave(ticket, None, None)

    async def state(self) -> tuple[Spent, str | None, bool]:
        return self._gate.spent, self._gate.reason, self._gate.exhausted


class _RemoteGate:
    """A worker's side of the gate, as a `CallGate`."""

    def __init__(self, actor: Any, worker: int) -> None:
        self._actor = actor
        self._worker = worker

    async def enter(self, model: str, chars: int, *, again: bool) -> int:
        found = await self._actor.enter.remote(self._worker, model, chars, again)
        if isinstance(found, str):
            raise BudgetExceeded(found)
        return found

    def leave(self, ticket: int, usage: Usage | None, cost_usd: float | None) -> None:
        self._actor.leave.remote(ticket, usage, cost_usd)
