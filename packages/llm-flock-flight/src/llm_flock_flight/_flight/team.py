"""The drones of a flight as the bodies of a trial: set-points in mission units, motions in metres."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager

import numpy as np

from llm_flock.arrays import Points
from llm_flock.robots import Position, Robot, RobotError, RobotState, Segment
from llm_flock.simulate import Readings
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.lag import distance_m, lag_bound_s
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.setpoints import SetPointCheck, resting

LOOK_S = 0.02  # time between two checks whether the drones have arrived [s]

CLIPPED_M = 1e-3
"""A driver that sends a point this near to its target did not change it: floats on the wire are short [m]."""

SEND_S = 1.0  # longest wait for a driver to send a command [s]


class SetPointRefused(Exception):
    """A motion would break a limit; it was not sent."""


class NotArrived(Exception):
    """A drone did not arrive where a motion ends."""


@asynccontextmanager
async def answering(robot: Robot, what: str, within_s: float) -> AsyncGenerator[None]:
    """Wait no longer than this for a driver; RobotError names the drone and what it was told."""
    try:
        async with asyncio.timeout(within_s):
            yield
    except TimeoutError as error:
        raise RobotError(robot.name, f"did not {what} within {within_s:g} s") from error


class FlyingTeam:
    """The bodies of a flight: connected drones, by id of the mission's robots.

    Agents read set-points (`readings`), not measurements: a drone begins each motion at its last set-point, not at
    its estimate, so the shield's guarantee holds for set-points at every moment. Drones follow some time later, the
    same time for all, each within the tracking error of its own set-point then. `airborne` are those that were not told
    to land, `aloft` also those on the way down. While `in_motion` is held, no joint motion begins.
    """

    def __init__(self, config: FlightConfig, robots: Sequence[Robot], log: FlightLog) -> None:
        self.robots = robots
        self.names = [robot.name for robot in robots]
        self.airborne: set[int] = set()
        self.aloft: set[int] = set()
        self.in_motion = asyncio.Lock()
        self.on_take_off: Callable[[], None] = lambda: None
        self._config = config
        self._frame = config.frame
        self._check = SetPointCheck(config)
        self._log = log
        places = [state.position for state in self.states()]
        self.motions: list[Segment] = [resting(place) for place in places]
        above = [(x, y, config.world.altitude_m) for x, y, _ in places]  # where the mission begins
        aims = np.array([self._frame.to_mission(place) for place in above])
        self.readings = Readings(config.mission, aims, 0.0, np.random.default_rng(0))

    def states(self) -> list[RobotState]:
        """The newest state of every drone."""
        return [robot.state() for robot in self.robots]

    def set_points(self) -> list[Position]:
        """Set-points of all drones now [m]."""
        now = time.monotonic()
        return [motion.at(now)[0] for motion in self.motions]

    def take_off(self, robot: int) -> None:
        """Count a drone as in the air. Call before its command to take off, so that the deadman knows of it first."""
        self.aloft.add(robot)
        self.on_take_off()

    def rest(self, robot: int, position: Position) -> None:
        """Keep a drone's set-point here. Call for every drone before the first motion."""
        self.motions[robot] = resting(position)
        aims = self.readings.places.copy()
        aims[robot] = self._frame.to_mission(position)
        self.readings.place(aims)

    @property
    def positions(self) -> Points:
        """Estimated positions of all drones, shape (n, d) [units]."""
        return np.array([self._frame.to_mission(state.position) for state in self.states()])

    async def fly(self, displacements: Points) -> None:
        """Fly the motion of a round, as `fly_together`."""
        self._log.round += 1
        await self.fly_together(displacements)

    async def fly_together(self, displacements: Points) -> None:
        """Fly one joint motion from rest to rest; raises SetPointRefused before it, NotArrived, or RobotError."""
        async with self.in_motion:
            await self._fly(displacements)

    async def _fly(self, displacements: Points) -> None:
        safety = self._config.safety
        before = [motion.target for motion in self.motions]
        aims = self.readings.places + displacements
        after = [self._frame.to_world(tuple(row)) for row in aims.tolist()]
        faults = self._check.faults(before, after, safety.round_s)
        if faults:
            raise SetPointRefused("; ".join(faults))
        sent = await self._send(before, after, safety.round_s)
        for robot, (asked, end) in enumerate(zip(after, sent, strict=True)):
            if math.dist(asked, end) > CLIPPED_M:
                self._log.note("clipped", robot, asked=list(asked), sent=list(end))
                aims[robot] = self._frame.to_mission(end)
        self.readings.place(aims)
        await asyncio.sleep(max(0.0, self.motions[0].began_s + safety.round_s - time.monotonic()))
        await self._settle()

    async def _send(self, before: Sequence[Position], after: Sequence[Position], duration_s: float) -> list[Position]:
        """Command all drones at once; returns the targets that the drivers really sent."""
        began = time.monotonic()

        async def one(robot: int) -> Position:
            async with answering(self.robots[robot], "take its next set-point", SEND_S):
                order = await self.robots[robot].go_to(after[robot], duration_s)
            end = order.target if math.dist(order.target, after[robot]) > CLIPPED_M else after[robot]
            self.motions[robot] = Segment(start=before[robot], target=end, duration_s=order.duration_s, began_s=began)
            return end

        results = await asyncio.gather(*map(one, range(len(self.robots))), return_exceptions=True)
        self._log.fan_outs_s.append(time.monotonic() - began)
        for result in results:
            if isinstance(result, BaseException):
                raise result
        return [result for result in results if not isinstance(result, BaseException)]

    async def _settle(self) -> None:
        """Wait until all are within half of `tracking_m`, or all of it after `settle_s`; or raise NotArrived."""
        config, began = self._config, time.monotonic()
        safety = config.safety
        while True:
            states = self.states()
            off_m, late = max(
                (distance_m(config, state.position, motion.target), robot)
                for robot, (state, motion) in enumerate(zip(states, self.motions, strict=True))
            )
            waited_s = time.monotonic() - began
            if off_m <= safety.tracking_m / 2 or (waited_s >= safety.settle_s and off_m <= safety.tracking_m):
                return
            if waited_s > safety.settle_s + lag_bound_s(config, (state.equipment for state in states)):
                raise NotArrived(f"{self.names[late]}: it is {off_m:.2f} m from its target, {waited_s:.1f} s late")
            await asyncio.sleep(LOOK_S)
