"""The drones of a flight as the bodies of a trial: set-points in mission units, motions in metres."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from llm_flock.arrays import Point, Points
from llm_flock.robots.base import Position, Robot, RobotState
from llm_flock.robots.simulated import Sensing, SimulatedTeam
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.log import FlightLog
from llm_flock.runtime.flight.setpoints import Motion, SetPointCheck, moving, resting

LOOK_S = 0.02
"""Time between two looks at whether the drones have arrived [s]."""

CLIPPED_M = 1e-3
"""A driver that sends a point this near to what it was told sent what it was told [m]: floats on the wire."""

SEND_S = 1.0
"""Longest wait for a driver to send a command [s]."""


class SetPointRefused(Exception):
    """A motion that must not be flown was not sent."""


class FlyingTeam:
    """The bodies of a flight.

    The minds are told set-points, not measurements: a drone begins each motion at its last set-point, whatever its
    estimate says, so the shield's guarantee is about set-points, and each drone is within the tracking error of its
    own. The record is told measurements.

    Args:
        config: frame and limits.
        robots: the drones, connected; by id of the mission's robots.
        log: takes note of what the drivers changed.

    Attributes:
        motions: what each drone is flying.
        airborne: drones that have taken off, and were not told to land.
        aloft: those, and whoever is on the way down.
        tell_deadman: called when somebody is about to take off.
    """

    def __init__(self, config: FlightConfig, robots: Sequence[Robot], log: FlightLog) -> None:
        self.robots = robots
        self.names = [robot.name for robot in robots]
        self.airborne: set[int] = set()
        self.aloft: set[int] = set()
        self.tell_deadman: Callable[[], None] = _nobody
        self._config = config
        self._frame = config.frame
        self._check = SetPointCheck(config)
        self._log = log
        places = [state.position for state in self.states()]
        self.motions: list[Motion] = [resting(place) for place in places]
        self._aims = self._seen_from(np.array([self._start(place) for place in places]))

    def _start(self, place: Position) -> Point:
        """Where a mission begins for a drone that stands at a place: above it."""
        return self._frame.to_mission((place[0], place[1], self._config.world.altitude_m))

    def _seen_from(self, aims: Points) -> SimulatedTeam:
        return SimulatedTeam(self._config.mission, aims, 0.0, np.random.default_rng(0))

    def states(self) -> list[RobotState]:
        """The newest state of every drone."""
        return [robot.state() for robot in self.robots]

    def set_points(self) -> list[Position]:
        """Where everybody is meant to be now [m]."""
        now = time.monotonic()
        return [motion.at(now) for motion in self.motions]

    def lifts(self, robot: int) -> None:
        """A drone is about to be told to take off: the deadman knows before the drone does."""
        self.aloft.add(robot)
        self.tell_deadman()

    def rests(self, robot: int, position: Position) -> None:
        """A drone's set-point is, and stays, here; to be called for all before the first motion."""
        self.motions[robot] = resting(position)
        aims = self._aims.positions.copy()
        aims[robot] = self._frame.to_mission(position)
        self._aims = self._seen_from(aims)

    @property
    def set_point_rows(self) -> Points:
        """Where everybody is told to be, shape (n, d) [units]."""
        return self._aims.positions

    @property
    def positions(self) -> Points:
        """Where everybody is by its own estimate, shape (n, d) [units]."""
        return np.array([self._frame.to_mission(state.position) for state in self.states()])

    @property
    def in_radio_range(self) -> Sequence[tuple[int, ...]]:
        """For each robot the others within radio range."""
        return self._aims.in_radio_range

    def connected(self, robots: Sequence[int]) -> bool:
        """Whether the radio graph of these robots is one piece."""
        return self._aims.connected(robots)

    def sense(self, robot: int) -> Sensing:
        """Set-points within sensing range, the own one first."""
        return self._aims.sense(robot)

    def everybody(self, robot: int) -> tuple[Point, ...]:
        """Set-points of all others."""
        return self._aims.everybody(robot)

    async def fly(self, displacements: Points) -> None:
        """One motion of all, from rest to rest.

        Raises:
            SetPointRefused: it would break a limit; nobody was told to move.
            RobotError: a drone was not told to move.
        """
        self._log.round += 1
        safety = self._config.safety
        before = [motion.end for motion in self.motions]
        aims = self._aims.positions + displacements
        after = [self._frame.to_world(tuple(row)) for row in aims.tolist()]
        faults = self._check.faults(before, after, safety.round_s)
        if faults:
            raise SetPointRefused("; ".join(faults))
        sent = await self._send(before, after, safety.round_s)
        for robot, (asked, end) in enumerate(zip(after, sent, strict=True)):
            if math.dist(asked, end) > CLIPPED_M:
                self._log.note("clipped", robot, asked=list(asked), sent=list(end))
                aims[robot] = self._frame.to_mission(end)
        self._aims = self._seen_from(aims)
        await asyncio.sleep(max(0.0, self.motions[0].began_s + safety.round_s - time.monotonic()))
        await self._settle(safety.tracking_m / 2, safety.settle_s)

    async def _send(self, before: Sequence[Position], after: Sequence[Position], duration_s: float) -> list[Position]:
        """Tell everybody at once; returns where they were really sent."""
        began = time.monotonic()

        async def one(robot: int) -> Position:
            order = await asyncio.wait_for(self.robots[robot].go_to(after[robot], duration_s), SEND_S)
            end = order.target if math.dist(order.target, after[robot]) > CLIPPED_M else after[robot]
            self.motions[robot] = moving(before[robot], end, began, order.duration_s)
            return end

        results = await asyncio.gather(*map(one, range(len(self.robots))), return_exceptions=True)
        self._log.figures.fan_outs_s.append(time.monotonic() - began)
        for result in results:
            if isinstance(result, BaseException):
                raise result
        return [result for result in results if not isinstance(result, BaseException)]

    async def _settle(self, within_m: float, longest_s: float) -> None:
        """Wait until everybody is where it was sent, or long enough: whoever is far off is the monitors' business."""
        until = time.monotonic() + longest_s
        while time.monotonic() < until:
            places = [state.position for state in self.states()]
            if all(math.dist(x, motion.end) <= within_m for x, motion in zip(places, self.motions, strict=True)):
                return
            await asyncio.sleep(LOOK_S)


def _nobody() -> None:
    """There is no deadman."""
