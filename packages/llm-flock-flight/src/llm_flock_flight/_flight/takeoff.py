"""Take-off: one group of drones after another, each drone straight up."""

from __future__ import annotations

import asyncio
import math
import time
from dataclasses import replace
from typing import Protocol, runtime_checkable

from llm_flock.robots import Position, Robot, Segment
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.lag import distance_m, lag_bound_s
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.setpoints import resting
from llm_flock_flight._flight.team import CLIPPED_M, FlyingTeam, answering

MARGIN_S = 3.0  # wait this much longer than the duration of a take-off for a drone to reach its altitude [s]
LIFT_S = 10.0  # longest wait from the order for a drone to lift [s]
SEEN_M = 0.03  # a drone that is this much higher than before has lifted [m]
LOOK_S = 0.05  # time between two checks of a rising drone [s]
ARM_S = 6.0  # longest wait for a drone to arm [s]: longer than the waits within a driver, whose own errors say more


class TakeOffFailed(Exception):
    """A drone did not reach its altitude."""


async def take_off(config: FlightConfig, team: FlyingTeam, log: FlightLog) -> None:
    """Take off with all drones, in groups; raises TakeOffFailed, or RobotError as drivers do."""
    robots, size = range(len(team.robots)), config.fleet.take_off_group
    for first in robots[::size]:
        group = robots[first : first + size]
        results = await asyncio.gather(*(_lift(config, team, log, robot) for robot in group), return_exceptions=True)
        for result in results:  # the whole group has ended, so drones in the air can be landed
            if result is not None:
                raise result


async def _lift(config: FlightConfig, team: FlyingTeam, log: FlightLog, robot: int) -> None:
    safety, altitude = config.safety, config.world.altitude_m
    body = team.robots[robot]
    async with answering(body, "arm", ARM_S):
        await body.arm()
    here = body.state().position
    log.note("take_off", robot, name=body.name, altitude_m=altitude)
    team.take_off(robot)
    began = time.monotonic()
    async with answering(body, "take off", ARM_S):
        order = await body.take_off(altitude, safety.take_off_s)
    team.airborne.add(robot)
    top: Position = (here[0], here[1], order.target[2])
    if abs(order.target[2] - altitude) > CLIPPED_M:
        team.motions[robot] = Segment(start=here, target=top, duration_s=order.duration_s, began_s=began)
        raise TakeOffFailed(f"{body.name} was not sent to {altitude:g} m but to {order.target[2]:.2f} m by its driver")
    rise = Rise(config, body, Segment(start=here, target=top, duration_s=order.duration_s, began_s=began))
    while not rise.done(time.monotonic()):
        team.motions[robot] = rise.motion
        await asyncio.sleep(LOOK_S)
    team.rest(robot, top)
    log.note("aloft", robot, seconds=round(time.monotonic() - began, 3))


@runtime_checkable
class TellsReference(Protocol):
    """A robot whose driver sends the set-points of its trajectory itself, and begins a rise once it is seen to lift."""

    @property
    def reference(self) -> Segment | None:
        """The trajectory that it follows; None until it is seen to lift."""
        ...


class Rise:
    """The trajectory of a rising drone: its driver's own, or as `ordered`, begun later if it lifts late.

    `motion` rests until then. A drone that plans on board begins as it gets the order: on time it is seen to lift after
    the longest delay of a healthy team, and the part of the rise in which it flies `SEEN_M`.
    """

    def __init__(self, config: FlightConfig, body: Robot, ordered: Segment) -> None:
        self.motion = resting(ordered.start)
        self._config = config
        self._body = body
        self._ordered = ordered
        self._lifted = False
        part = (SEEN_M / (35.0 * max(SEEN_M, math.dist(ordered.start, ordered.target)))) ** 0.25  # of a segment's share
        self._seen_s = lag_bound_s(config, [body.state().equipment]) + part * ordered.duration_s

    def done(self, now: float) -> bool:
        """Look at the drone: whether it is at the top; raises TakeOffFailed if it does not lift, or not get there."""
        body, ordered = self._body, self._ordered
        x, y, z = body.state().position
        if isinstance(body, TellsReference):
            own = body.reference
            self._lifted = own is not None
            self.motion = own or resting(ordered.start)
        elif not self._lifted:
            self._lifted = z >= ordered.start[2] + SEEN_M
            self.motion = replace(ordered, began_s=max(ordered.began_s, now - self._seen_s))
        if not self._lifted and now - ordered.began_s > LIFT_S:
            raise TakeOffFailed(f"{body.name} was told to take off, and is not seen to lift after {LIFT_S:g} s")
        end_s = self.motion.began_s + self.motion.duration_s
        if not self._lifted or now < end_s:
            return False
        off_m = distance_m(self._config, (x, y, z), self.motion.target)
        if off_m > self._config.safety.tracking_m and now > end_s + MARGIN_S:
            raise TakeOffFailed(f"{body.name} is at ({x:.2f}, {y:.2f}, {z:.2f}) m, not at its altitude")
        return off_m <= self._config.safety.tracking_m
