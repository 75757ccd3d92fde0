"""Watches a flight, and ends whatever is going on as soon as something is wrong."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Coroutine, Iterable
from typing import Any, TypeVar

from llm_flock.robots.base import RobotError
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.log import FlightLog
from llm_flock.runtime.flight.monitors import PERIOD_S, Kind, Monitors, Trouble
from llm_flock.runtime.flight.team import FlyingTeam

T = TypeVar("T")

CUT_FOR_S = 4.0
"""So long an emergency stop is repeated until it is confirmed [s]."""

CUT_TRY_S = 1.5
"""Longest wait for one confirmation [s]."""


class Grounded(Exception):
    """The flight is over before its mission is."""

    def __init__(self, trouble: Trouble) -> None:
        self.trouble = trouble
        super().__init__(f"{trouble.kind.value}: {trouble.detail}")


class Guard:
    """The one place where a flight is ended.

    Args:
        config: the limits.
        team: the drones.
        log: takes note of troubles.

    Attributes:
        trouble: what ended the flight, the first one; None as long as all is well.
        confirmed: drones whose motors were cut, and whether they confirmed it.
    """

    def __init__(self, config: FlightConfig, team: FlyingTeam, log: FlightLog) -> None:
        self.trouble: Trouble | None = None
        self.confirmed: dict[int, bool] = {}
        self._config = config
        self._team = team
        self._log = log
        self._monitors = Monitors(config, team.names)
        self._tripped = asyncio.Event()
        self._told: set[tuple[Kind, int | None]] = set()
        self._cuts: dict[int, asyncio.Task[None]] = {}
        self._aloft_s: float | None = None

    def trip(self, trouble: Trouble) -> None:
        """Something is wrong: cut whose motors must be cut, and end what is going on."""
        self._cut(trouble.cut)
        if (trouble.kind, trouble.robot) in self._told:
            return
        self._told.add((trouble.kind, trouble.robot))
        self._log.note(trouble.kind.value, trouble.robot, reason=trouble.detail)
        if self.trouble is None:
            self.trouble = trouble
            self._tripped.set()

    def abort(self) -> None:
        """The operator wants everybody on the ground."""
        self.trip(Trouble(kind=Kind.ABORT, detail="the operator lands everybody"))

    def emergency(self) -> None:
        """The operator wants all motors to stop now, wherever the drones are."""
        everybody = frozenset(range(len(self._team.robots)))
        self.trip(Trouble(kind=Kind.EMERGENCY, detail="the operator cuts all motors", cut=everybody))

    async def watch(self) -> None:
        """Look at everybody until cancelled."""
        team = self._team
        while True:
            now = time.monotonic()
            states, motions, airborne = team.states(), team.motions, frozenset(team.airborne)
            self._log.look(now, states, motions, airborne)
            for trouble in self._monitors.look(now, states, motions, airborne):
                # On the way down nothing is done about a drone any more, unless it must be cut.
                if trouble.robot in (team.aloft if trouble.cut else airborne):
                    self.trip(trouble)
            if self._log.failure is not None:
                self.trip(Trouble(kind=Kind.UNWATCHED, detail=str(self._log.failure)))
            if airborne and self._aloft_s is None:
                self._aloft_s = now
            limit = self._config.safety.max_flight_s
            if airborne and self._aloft_s is not None and now - self._aloft_s > limit:
                self.trip(Trouble(kind=Kind.TIME_UP, detail=f"in the air for {limit:g} s"))
            await asyncio.sleep(PERIOD_S)

    async def while_safe(self, work: Coroutine[Any, Any, T]) -> T:
        """Do something that ends as soon as anything is wrong.

        Raises:
            Grounded: it was ended.
        """
        if self.trouble is not None:
            work.close()
            raise Grounded(self.trouble)
        task = asyncio.ensure_future(work)
        tripped = asyncio.ensure_future(self._tripped.wait())
        try:
            await asyncio.wait((task, tripped), return_when=asyncio.FIRST_COMPLETED)
        finally:
            await _ended(tripped)
            if not task.done():
                await _ended(task)
        if self.trouble is not None:
            raise Grounded(self.trouble)
        return task.result()

    @property
    def aloft_s(self) -> float:
        """How long ago the first drone took off [s]; 0 where none did."""
        return 0.0 if self._aloft_s is None else time.monotonic() - self._aloft_s

    async def settled(self) -> None:
        """Wait for the emergency stops that are under way."""
        if self._cuts:
            await asyncio.wait(self._cuts.values())

    def _cut(self, robots: Iterable[int]) -> None:
        for robot in robots:
            if robot not in self._cuts:
                self._team.airborne.discard(robot)
                self._team.aloft.discard(robot)
                self._cuts[robot] = asyncio.create_task(self._cut_one(robot))

    async def _cut_one(self, robot: int) -> None:
        until = time.monotonic() + CUT_FOR_S
        confirmed = False
        while not confirmed and time.monotonic() < until:
            try:
                confirmed = await asyncio.wait_for(self._team.robots[robot].stop_motors(), CUT_TRY_S)
            except (RobotError, TimeoutError):
                await asyncio.sleep(PERIOD_S)
        self.confirmed[robot] = confirmed
        self._log.note("cut", robot, confirmed=confirmed)


async def _ended(task: asyncio.Future[Any]) -> None:
    """Cancel, and wait until it is over; whatever it came to is told elsewhere."""
    task.cancel()
    waited: Awaitable[object] = asyncio.gather(task, return_exceptions=True)
    await waited
