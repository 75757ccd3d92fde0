"""Trials on a Ray cluster (the extra `cluster`): workers fly, this process keeps what they bring.

Each worker is an actor with an event loop of its own, one for each processor. Budget and rates are kept by one more
actor that every call asks first. Workers need this package, the same version, and keys of models in their own
environment: keys are never sent over the cluster.
"""

from __future__ import annotations

import asyncio
import itertools
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from llm_flock.errors import BudgetExceeded, FlockError, InputError
from llm_flock.experiments.executors import Flight, Session, drive
from llm_flock.experiments.store import Earlier, StoredTrial
from llm_flock.experiments.sweep_file import KeepRecords
from llm_flock.experiments.sweep_trial import code_version, fly
from llm_flock.llm.limits import Budget
from llm_flock.llm.port import Call, Reply, Usage
from llm_flock.llm.sharing import Lane, Pools, Rate, SharedGate, Spent

TRIES = 3
"""So often a trial is flown, if its worker is lost each time."""

CALLS_AT_ONCE = 100_000
"""Calls that may stand before the gate."""

POLL_S = 0.2


def fly_on_cluster(flights: Sequence[Flight], session: Session, address: str, jobs: int | None) -> None:
    """Fly all on a Ray cluster.

    Args:
        flights: what is to be flown.
        session: what they have in common.
        address: of the cluster: `HOST:PORT`, `auto` or `ray://HOST:PORT`.
        jobs: workers; one for each processor of the cluster if None.

    Raises:
        InputError: Ray is not installed, the cluster cannot be reached, or it runs another version of this package.
        FlockError: a worker was lost again and again, or results cannot be kept.
        KeyboardInterrupt: after the workers were stopped.
    """
    if not flights:
        return
    try:
        import ray
    except ImportError:
        raise InputError("cluster", address, "given only with Ray: pip install 'llm-flock[cluster]'") from None
    remote: Any = ray
    try:
        remote.init(address=address, log_to_driver=False, logging_level="error")
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise InputError("cluster", address, f"the address of a Ray cluster that runs ({error})") from None
    try:
        asyncio.run(_fly(remote, flights, session, jobs))
    finally:
        remote.shutdown()


async def _fly(ray: Any, flights: Sequence[Flight], session: Session, jobs: int | None) -> None:
    count = jobs or max(1, int(ray.cluster_resources().get("CPU", 1)))
    count = min(count, len(flights))
    shared = ray.remote(max_concurrency=CALLS_AT_ONCE, num_cpus=0)(_GateActor).remote(session.budget, session.rates)
    make = ray.remote(num_cpus=1, max_concurrency=session.at_once)(_Worker)
    names = itertools.count()

    def hire() -> _Hired:
        name = next(names)
        return _Hired(name=name, actor=make.remote(session.keep, shared, name))

    workers = [hire() for _ in range(count)]
    version = await workers[0].actor.version.remote()
    if version != code_version():
        raise InputError("cluster", version, f"a cluster with the version that is here: {code_version()}")
    # A worker's place is in the queue once for each trial that it may have: in turns, so that all have as many.
    free: asyncio.Queue[int] = asyncio.Queue()
    for _ in range(-(-session.at_once // count)):
        for place in range(count):
            free.put_nowait(place)

    async def fly_it(flight: Flight, earlier: tuple[Earlier, ...]) -> tuple[StoredTrial, bytes | None]:
        for _ in range(TRIES):
            place = await free.get()
            worker = workers[place]
            try:
                data, record = await worker.actor.fly.remote(flight, earlier)
                return msgspec.json.decode(data, type=StoredTrial), record
            except ray.exceptions.RayActorError:
                if workers[place] is worker:  # the first of its trials to notice
                    await shared.forget.remote(worker.name)
                    workers[place] = hire()
            finally:
                free.put_nowait(place)
        raise FlockError(f"workers of the cluster were lost {TRIES} times with {flight.spec.cell}")

    books = _RemoteBooks(shared)
    await books.refresh()
    polling = asyncio.create_task(books.poll())
    try:
        await drive(flights, session, books, fly_it, quick=count)
    finally:
        polling.cancel()
        await books.refresh()
        session.watcher.spent(books.spent, books.reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Hired:
    """A worker, and the name by which the gate knows it."""

    name: int
    actor: Any


class _Worker:
    """Flies trials on its own event loop."""

    def __init__(self, keep: KeepRecords, shared: Any, name: int) -> None:
        self._keep: KeepRecords = keep
        self._gate = _RemoteGate(shared, name)
        self._pools = Pools()

    async def version(self) -> str:
        """Version of this package on the worker's machine."""
        return code_version()

    async def fly(self, flight: Flight, earlier: tuple[Earlier, ...]) -> tuple[bytes, bytes | None]:
        """One trial, and its record where it is to be kept."""
        with tempfile.TemporaryDirectory(prefix="llm-flock-") as folder:
            flown = await fly(
                flight.spec,
                lane=Lane(self._gate, self._pools),
                keep=self._keep,
                scratch=Path(folder) / "record",
                earlier=earlier,
            )
            record = None if flown.record is None else flown.record.read_bytes()
            return msgspec.json.encode(flown.trial), record


class _GateActor:
    """The gate of all workers. Refusals are returned, not raised: they are no faults of the cluster."""

    def __init__(self, budget: Budget, rates: Mapping[str, Rate]) -> None:
        self._arguments = budget, rates
        self._made: SharedGate | None = None
        self._tickets: dict[int, int] = {}

    @property
    def _gate(self) -> SharedGate:
        """Made on first use, on the loop that uses it."""
        if self._made is None:
            self._made = SharedGate(*self._arguments)
        return self._made

    async def enter(self, worker: int, model: str, chars: int, again: bool) -> int | str:
        """A ticket, or why there is none."""
        try:
            ticket = await self._gate.enter_sized(model, chars, again=again)
        except BudgetExceeded as error:
            return error.detail
        self._tickets[ticket] = worker
        return ticket

    async def leave(self, ticket: int, usage: Usage | None, cost: float | None) -> None:
        """The call is over."""
        if self._tickets.pop(ticket, None) is not None:
            self._gate.leave_with(ticket, usage, cost)

    async def forget(self, worker: int) -> None:
        """A worker was lost, and its calls with it."""
        for ticket in [ticket for ticket, owner in self._tickets.items() if owner == worker]:
            await self.leave(ticket, None, None)

    async def state(self, elsewhere: Spent | None) -> tuple[Spent, str | None, bool]:
        """What was spent, which limit is used up, and whether a new call would be turned away."""
        if elsewhere is not None:
            self._gate.told_of(elsewhere)
        return self._gate.spent, self._gate.reason, self._gate.exhausted


class _RemoteGate:
    """A worker's side of the gate."""

    def __init__(self, shared: Any, worker: int) -> None:
        self._shared = shared
        self._worker = worker

    async def enter(self, model: str, call: Call, *, again: bool) -> int:
        """See `Gate`."""
        found = await self._shared.enter.remote(self._worker, model, sum(len(m.text) for m in call.messages), again)
        if isinstance(found, str):
            raise BudgetExceeded(found)
        return found

    def leave(self, ticket: int, reply: Reply | None) -> None:
        """See `Gate`."""
        self._shared.leave.remote(
            ticket, None if reply is None else reply.usage, None if reply is None else reply.cost_usd
        )


class _RemoteBooks:
    """This process's side of the gate: what it knew a moment ago."""

    def __init__(self, shared: Any) -> None:
        self._shared = shared
        self._elsewhere: Spent | None = None
        self.spent = Spent()
        self.reason: str | None = None
        self.exhausted = False

    def told_of(self, elsewhere: Spent) -> None:
        """Passed on with the next question."""
        self._elsewhere = elsewhere

    async def refresh(self) -> None:
        """Ask."""
        self.spent, self.reason, self.exhausted = await self._shared.state.remote(self._elsewhere)

    async def poll(self) -> None:
        """Ask again and again."""
        while True:
            await self.refresh()
            await asyncio.sleep(POLL_S)
