"""Flies a robot's body to waypoints by commands of one control period, each projected on what is safe."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence

from llm_flock.arrays import Point, towards
from llm_flock.protocol import Sighting, project_async, static_half_spaces
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.wire import Body, Command

STILL = 1e-6  # shorter moves count as none [units]
ANSWER_S = 0.25  # a command without an answer for this long was lost [s]


class BodyControl:
    """Steers one body; with the shield on, every move is projected on what is safe. Call `control` in every period."""

    def __init__(self, config: SwarmConfig) -> None:
        self.waypoint: Point | None = None  # where to fly; None to stand still [units; world frame]
        self.news = asyncio.Event()  # set with everything after which another command may be possible
        self._mission = config.mission
        self._speed, self._period_s, self._lag_s = config.speed, config.network.control_s, config.network.lag_s
        self._shield_on = bool(config.protocol.shield)
        self._body: Body | None = None
        self._number = 0
        self._given = -math.inf

    @property
    def end(self) -> Point | None:
        """The place where the body will stop [units; world frame]."""
        return None if self._body is None else self._body.end

    def fly_to(self, waypoint: Point) -> None:
        self.waypoint = waypoint
        self.news.set()

    def update(self, body: Body) -> None:
        self._body = body
        self.news.set()
        self._number = max(self._number, body.command)

    @property
    def arrived(self) -> bool:
        body, target = self._body, self.waypoint
        return body is not None and target is not None and math.dist(body.position, target) <= STILL

    def is_free(self, now: float) -> bool:
        """Whether there is a waypoint to fly to, and no command under way to the body at this time [s]."""
        body = self._body
        if body is None or self.waypoint is None:
            return False
        return body.command >= self._number or now - self._given >= ANSWER_S

    def control(self, now: float, sightings: Sequence[Sighting], unseen_s: float) -> Command | None:
        """The next command at `now`, by the wall clock [s]; None with nothing to fly, no safe move, or one given."""
        body, waypoint = self._body, self.waypoint
        if body is None or waypoint is None or not self.is_free(now):
            return None
        target = self._safe(body.end, waypoint, sightings, unseen_s)
        if math.dist(target, body.end) <= STILL:
            return None
        self._number += 1
        self._given = now
        return Command(number=self._number, stamp=now, origin=body.end, target=target)

    def _safe(self, here: Point, waypoint: Point, sightings: Sequence[Sighting], unseen_s: float) -> Point:
        longest = self._speed * self._period_s
        if not self._shield_on:
            return towards(here, waypoint, longest)
        # The body may obey a little later than commanded; until then the others may fly on.
        lasts_s = self._period_s + self._lag_s
        # A robot out of sight was outside the sensing range at the last reading, and may have approached since.
        room = self._mission.sensing - self._mission.height_apart - self._speed * (unseen_s + lasts_s)
        longest = min(longest, max(room, 0.0))
        target = project_async(
            here,
            towards(here, waypoint, longest),
            sightings,
            safe_distance=self._mission.safe_distance,
            speed=self._speed,
            period_s=lasts_s,
            downwash=self._mission.downwash,
            also=static_half_spaces(here, self._mission, max_step=self._speed * lasts_s),
        )
        # The cell is convex, and contains the robot or only lets it move away: a shorter move that way is safe too.
        return towards(here, target, longest)
