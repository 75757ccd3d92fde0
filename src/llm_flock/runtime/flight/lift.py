"""Take-off: a group of drones after the other, each straight up."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Sequence

from llm_flock.robots.base import Position
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.log import FlightLog
from llm_flock.runtime.flight.setpoints import moving
from llm_flock.runtime.flight.team import CLIPPED_M, FlyingTeam

MARGIN_S = 3.0
"""After the time of a take-off, so much longer is waited for a drone to be at its altitude [s]."""

LOOK_S = 0.05
"""Time between two looks at a drone that rises [s]."""

ARM_S = 3.0
"""Longest wait for a drone to arm [s]."""


class NotAloft(Exception):
    """A drone did not reach its altitude."""


async def take_off(config: FlightConfig, team: FlyingTeam, log: FlightLog) -> None:
    """Everybody up, in groups.

    Raises:
        NotAloft: a drone did not reach its altitude in time.
        RobotError: a drone refused.
        TimeoutError: a drone did not answer.
    """
    robots = range(len(team.robots))
    size = config.fleet.take_off_group
    for first in range(0, len(robots), size):
        await _together(config, team, log, robots[first : first + size])


async def _together(config: FlightConfig, team: FlyingTeam, log: FlightLog, group: Sequence[int]) -> None:
    results = await asyncio.gather(*(_lift(config, team, log, robot) for robot in group), return_exceptions=True)
    for result in results:  # all of the group have ended: whoever is up can be landed
        if result is not None:
            raise result


async def _lift(config: FlightConfig, team: FlyingTeam, log: FlightLog, robot: int) -> None:
    safety, altitude = config.safety, config.world.altitude_m
    body = team.robots[robot]
    await asyncio.wait_for(body.arm(), ARM_S)
    here = body.state().position
    log.note("take_off", robot, name=body.name, altitude_m=altitude)
    team.lifts(robot)
    began = time.monotonic()
    order = await asyncio.wait_for(body.take_off(altitude, safety.take_off_s), ARM_S)
    top: Position = (here[0], here[1], order.target[2])
    team.airborne.add(robot)
    team.motions[robot] = moving(here, top, began, order.duration_s)
    if abs(order.target[2] - altitude) > CLIPPED_M:
        raise NotAloft(f"{body.name} was not sent to {altitude:g} m but to {order.target[2]:.2f} m by its driver")
    until = began + order.duration_s + MARGIN_S
    while math.dist(body.state().position, top) > safety.tracking_m or time.monotonic() < began + order.duration_s:
        if time.monotonic() > until:
            x, y, z = body.state().position
            raise NotAloft(f"{body.name} is at ({x:.2f}, {y:.2f}, {z:.2f}) m, not at its altitude")
        await asyncio.sleep(LOOK_S)
    team.rests(robot, top)
    log.note("aloft", robot, seconds=round(time.monotonic() - began, 3))
