"""Supervises a flight: interrupts it at the first trouble, and cuts motors."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Iterable
from typing import Any, TypeVar

from llm_flock.robots import RobotError
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.lag import LagTracker
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.monitors import PERIOD_S, Monitors, Trouble, TroubleKind
from llm_flock_flight._flight.team import FlyingTeam
from llm_flock_flight._pauses import CATCH_UP_S, PAUSE_S

T = TypeVar("T")


class FlightEnded(Exception):
    """The flight was ended before its mission, by the `trouble` of its supervisor."""


class FlightSupervisor:
    """The one place where a flight is ended before its mission, by its first `trouble`.

    `confirmed` says whether each drone whose motors were cut confirmed it.
    """

    def __init__(self, config: FlightConfig, team: FlyingTeam, log: FlightLog) -> None:
        self.trouble: Trouble | None = None
        self.confirmed: dict[int, bool] = {}
        self._config = config
        self._team = team
        self._log = log
        self._monitors = Monitors(config, team.names)
        self._tracker = LagTracker(config)
        self._tripped = asyncio.Event()
        self._reported: set[tuple[TroubleKind, int | None]] = set()
        self._cuts: dict[int, asyncio.Task[None]] = {}
        self._aloft_s: float | None = None

    def trip(self, trouble: Trouble) -> None:
        """End the flight because of a trouble, and cut motors that must be cut."""
        self._cut(trouble.cut)
        if (trouble.kind, trouble.robot) in self._reported:
            return
        self._reported.add((trouble.kind, trouble.robot))
        self._log.note(trouble.kind.value, trouble.robot, reason=trouble.detail)
        if self.trouble is None:
            self.trouble = trouble
            self._tripped.set()

    async def watch(self) -> None:
        """Monitor all drones until cancelled."""
        team, before = self._team, time.monotonic()
        while True:
            now = time.monotonic()
            if now - before > PAUSE_S:
                await self._catch_up()
                now = time.monotonic()
            before = now
            states, motions, airborne = team.states(), team.motions, frozenset(team.airborne)
            tracking = self._tracker.look(states, motions, airborne)
            self._log.look(now, states, motions, airborne, frozenset(team.aloft), tracking)
            for trouble in self._monitors.look(now, states, tracking, airborne):
                # A drone on the way down is left alone, unless its motors must be cut.
                if trouble.robot in (team.aloft if trouble.cut else airborne):
                    self.trip(trouble)
            if airborne and self._aloft_s is None:
                self._aloft_s = now
            limit = self._config.safety.max_flight_s
            if airborne and self._aloft_s is not None and now - self._aloft_s > limit:
                self.trip(Trouble(TroubleKind.TIME_UP, detail=f"in the air for {limit:g} s"))
            await asyncio.sleep(PERIOD_S)

    async def _catch_up(self) -> None:
        """This process stood still: give its threads time to read what the drones have sent, before blaming those."""
        for _ in range(round(CATCH_UP_S / PERIOD_S)):
            await asyncio.sleep(PERIOD_S)
            now = time.monotonic()
            if all(now - state.stamp_s <= self._config.safety.stall_s for state in self._team.states()):
                return

    async def while_safe(self, work: Coroutine[Any, Any, T]) -> T:
        """Do some work, but cancel it and raise FlightEnded as soon as something is wrong."""
        if self.trouble is not None:
            work.close()
            raise FlightEnded
        task = asyncio.ensure_future(work)
        tripped = asyncio.ensure_future(self._tripped.wait())
        try:
            await asyncio.wait((task, tripped), return_when=asyncio.FIRST_COMPLETED)
        finally:
            for waiting in (tripped, task):
                if not waiting.done():
                    waiting.cancel()
                    await asyncio.gather(waiting, return_exceptions=True)
        if self.trouble is not None:
            raise FlightEnded
        return task.result()

    @property
    def aloft_s(self) -> float:
        """Time since the first drone took off [s]; 0 if none did."""
        return 0.0 if self._aloft_s is None else time.monotonic() - self._aloft_s

    async def cuts_done(self) -> None:
        """Wait for emergency stops under way."""
        if self._cuts:
            await asyncio.wait(self._cuts.values())

    def _cut(self, robots: Iterable[int]) -> None:
        for robot in robots:
            if robot not in self._cuts:
                self._team.airborne.discard(robot)
                self._team.aloft.discard(robot)
                self._cuts[robot] = asyncio.create_task(self._cut_one(robot))

    async def _cut_one(self, robot: int) -> None:
        until = time.monotonic() + 4.0  # until then it is repeated
        confirmed = False
        while not confirmed and time.monotonic() < until:
            try:
                async with asyncio.timeout(1.5):  # for one confirmation
                    confirmed = await self._team.robots[robot].stop_motors()
            except (RobotError, TimeoutError):
                await asyncio.sleep(PERIOD_S)
        self.confirmed[robot] = confirmed
        self._log.note("cut", robot, confirmed=confirmed)
