"""Take-off: one group of drones after another, each drone straight up."""

from __future__ import annotations

import asyncio
import time

from llm_flock.robots import Position, Segment
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.lag import distance_m
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.team import CLIPPED_M, FlyingTeam, answering

MARGIN_S = 3.0  # wait this much longer than the duration of a take-off for a drone to reach its altitude [s]
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
    top: Position = (here[0], here[1], order.target[2])
    team.airborne.add(robot)
    team.motions[robot] = Segment(start=here, target=top, duration_s=order.duration_s, began_s=began)
    if abs(order.target[2] - altitude) > CLIPPED_M:
        raise TakeOffFailed(f"{body.name} was not sent to {altitude:g} m but to {order.target[2]:.2f} m by its driver")
    until = began + order.duration_s + MARGIN_S
    while (
        distance_m(config, body.state().position, top) > safety.tracking_m
        or time.monotonic() < began + order.duration_s
    ):
        if time.monotonic() > until:
            x, y, z = body.state().position
            raise TakeOffFailed(f"{body.name} is at ({x:.2f}, {y:.2f}, {z:.2f}) m, not at its altitude")
        await asyncio.sleep(LOOK_S)
    team.rest(robot, top)
    log.note("aloft", robot, seconds=round(time.monotonic() - began, 3))
