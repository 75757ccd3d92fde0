"""Landing: who lands where and when, so that nobody lands on another or under one, until all are down."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from llm_flock.robots.base import PEAK_SPEED, Position, RobotError
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.log import FlightLog
from llm_flock.runtime.flight.setpoints import SetPointCheck, moving
from llm_flock.runtime.flight.team import SEND_S, FlyingTeam

MARGIN_S = 3.0
"""After the time of a landing, so much longer is waited for a drone to say that its motors are off [s]: a Crazyflie
says so two seconds late (docs/reference/firmware.md)."""

LANDED = "landed"
"""How a landing should end."""

STOPPED = "motors stopped, not seen to land"
"""How it ends for a drone that is not heard to have landed, but that its motors were cut when it should have."""

TOLD = "told to land, not confirmed"
"""How it ends for a drone that took the command to land, and was not heard of again."""

LOST = "out of reach"
"""How it ends for a drone that took no command any more: it hovers at its last set-point."""

DOWN_M = 0.12
"""An estimate this near to the floor is of a drone that is down [m]."""

LOOK_S = 0.05
"""Time between two looks at a drone that sinks [s]."""

AGAIN_S = 0.5
"""Time between two calls of a drone that is out of reach [s]."""

CONNECT_S = 3.0
"""Longest wait for one connection to such a drone [s]."""

RINGS, SPOTS = 12, 24
"""A free spot is looked for on so many rings, in so many directions each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Descent:
    """How one drone lands: aside first where `via` says so, then straight down.

    Attributes:
        robot: who.
        spot: where, x and y [m].
        via: set-point above that spot, at the drone's own altitude; None where it is there already.
    """

    robot: int
    spot: tuple[float, float]
    via: Position | None = None


def plan_landing(
    config: FlightConfig, places: Mapping[int, Position], standing: Sequence[Position]
) -> list[list[Descent]]:
    """Groups of drones that land at once, one group after the other.

    Whoever is lowest lands first: so nobody sinks past another, and nobody lands under one who hovers near by. Drones
    side by side, which those of a mission in the plane always are, land straight down and all at once.

    Args:
        config: distances and geofence.
        places: set-points of those in the air, by robot [m].
        standing: where others stand on the floor, or must be thought to be [m].
    """
    apart = config.safety.min_separation_m + 2 * config.safety.tracking_m
    order = sorted(places, key=lambda robot: (places[robot][2], robot))
    taken = [(x, y) for x, y, _ in standing]
    if _free(taken, [_flat(places[robot]) for robot in order], apart):
        return [[Descent(robot=robot, spot=_flat(places[robot])) for robot in order]]
    groups: list[list[Descent]] = []
    for k, robot in enumerate(order):
        hovering = [places[other] for other in order[k + 1 :]]
        descent = _descent(config, robot, places[robot], taken, hovering, apart)
        taken.append(descent.spot)
        groups.append([descent])
    return groups


def _flat(place: Position) -> tuple[float, float]:
    return place[0], place[1]


def _free(taken: Sequence[tuple[float, float]], spots: Sequence[tuple[float, float]], apart: float) -> bool:
    """Whether spots are apart from each other and from those taken."""
    return all(math.dist(spot, other) >= apart - 1e-3 for k, spot in enumerate(spots) for other in (*taken, *spots[:k]))


def _descent(
    config: FlightConfig,
    robot: int,
    place: Position,
    taken: Sequence[tuple[float, float]],
    hovering: Sequence[Position],
    apart: float,
) -> Descent:
    """The nearest spot that is free, with a way to it that is free; straight down where there is none at all."""
    check = SetPointCheck(config)
    low, high = config.inner_fence
    if _free(taken, [_flat(place)], apart):
        return Descent(robot=robot, spot=_flat(place))
    for ring in range(1, RINGS + 1):
        for k in range(SPOTS):
            angle, reach = 2 * math.pi * k / SPOTS, ring * apart / 2
            x, y = place[0] + reach * math.cos(angle), place[1] + reach * math.sin(angle)
            via = (x, y, place[2])
            inside = low[0] <= x <= high[0] and low[1] <= y <= high[1]
            if not inside or not _free(taken, [(x, y)], apart):
                continue
            # Whoever is near now may be nearer than allowed already; the way must not lead nearer.
            allowed = min(apart, check.separation([place, *hovering], [place, *hovering]))
            if check.separation([place, *hovering], [via, *hovering]) >= allowed - 1e-3:
                return Descent(robot=robot, spot=(x, y), via=via)
    return Descent(robot=robot, spot=_flat(place))


class Landing:
    """Lands drones, and calls those that are out of reach until they answer or the time for it is over.

    Args:
        config: times and distances.
        team: the drones.
        log: takes note.

    Attributes:
        ends: how each drone ended: landed, not seen to land, or out of reach.
    """

    def __init__(self, config: FlightConfig, team: FlyingTeam, log: FlightLog) -> None:
        self.ends: dict[int, str] = {}
        self._told: set[int] = set()
        self._config = config
        self._team = team
        self._log = log

    async def all_down(self) -> None:
        """Land everybody who is in the air."""
        team = self._team
        set_points = team.set_points()
        up = sorted(team.aloft)
        places = {robot: set_points[robot] for robot in up}
        standing = [state.position for robot, state in enumerate(team.states()) if robot not in places]
        async with asyncio.TaskGroup() as group:
            for batch in plan_landing(self._config, places, standing):
                rescues = await asyncio.gather(*(self._land(descent) for descent in batch))
                for descent, reached in zip(batch, rescues, strict=True):
                    if not reached:
                        group.create_task(self._call_down(descent))

    async def _land(self, descent: Descent) -> bool:
        """Land one drone; False if a command did not reach it."""
        safety, robot = self._config.safety, self._team.robots[descent.robot]
        self._team.airborne.discard(descent.robot)
        if descent.robot not in self._team.aloft:
            return True  # it was cut
        try:
            if descent.via is not None:
                here = self._team.set_points()[descent.robot]
                seconds = max(1.0, 1.2 * PEAK_SPEED * math.dist(here, descent.via) / safety.max_speed_m_s)
                await asyncio.wait_for(robot.go_to(descent.via, seconds), SEND_S)
                self._fly(descent.robot, here, descent.via, seconds)
                await asyncio.sleep(seconds)
            self._log.note("landing", descent.robot, spot=list(descent.spot))
            await self._sink(descent.robot)
        except (RobotError, TimeoutError) as error:
            self._log.note("unreachable", descent.robot, reason=str(error) or "no answer in time")
            return False
        return True

    async def _sink(self, robot: int) -> None:
        """Straight down, and motors off."""
        world, safety = self._config.world, self._config.safety
        began = time.monotonic()
        body = self._team.robots[robot]
        await asyncio.wait_for(body.land(world.floor_m, safety.land_s), SEND_S)
        self._told.add(robot)
        x, y, z = self._team.set_points()[robot]
        self._fly(robot, (x, y, z), (x, y, world.floor_m), safety.land_s)
        if await self._down(robot, began + safety.land_s + MARGIN_S):
            self._log.note("landed", robot, seconds=round(time.monotonic() - began, 3))
            self.ends[robot] = LANDED
        else:
            # An emergency stop locks a drone until it is started anew: only for one that did not stop by itself.
            stopped = await asyncio.wait_for(body.stop_motors(), 2 * SEND_S)
            self._log.note("not_down", robot, stopped=stopped)
            if not stopped:
                raise RobotError(body.name, "was told to land, and then to stop, and confirmed neither")
            self.ends[robot] = STOPPED
        self._team.aloft.discard(robot)

    async def _down(self, robot: int, until_s: float) -> bool:
        """Wait until a drone says that its motors have stopped; in the end, low is enough. False if neither comes."""
        told_s = time.monotonic()
        floor = self._config.world.floor_m + DOWN_M
        while True:
            state = self._team.robots[robot].state()
            late = time.monotonic() >= until_s
            fresh = state.stamp_s > told_s and not state.link_lost
            if fresh and (not state.flying or (late and state.position[2] <= floor)):
                return True
            if late:
                return False
            await asyncio.sleep(LOOK_S)

    async def _call_down(self, descent: Descent) -> None:
        """A drone that does not hear hovers where it is; it is called until it hears, and landed then."""
        robot, safety = descent.robot, self._config.safety
        body = self._team.robots[robot]
        until = time.monotonic() + safety.reach_s
        while time.monotonic() < until:
            try:
                await body.close()
                await body.connect(min(self._config.fleet.connect_s, CONNECT_S, max(0.1, until - time.monotonic())))
                self._log.note("landing", robot, spot=list(descent.spot))
                await self._sink(robot)
            except (RobotError, TimeoutError):
                await asyncio.sleep(AGAIN_S)
            else:
                return
        self._log.note("given_up", robot, position=list(self._team.motions[robot].end))
        self.ends[robot] = TOLD if robot in self._told else LOST

    def _fly(self, robot: int, start: Position, end: Position, seconds: float) -> None:
        self._team.motions[robot] = moving(start, end, time.monotonic(), seconds)
