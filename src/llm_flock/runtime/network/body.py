"""A robot's own body, as its mind knows it: where it is, how it is flown, what the shield lets it do."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.motion.limits import Limits
from llm_flock.protocol.motion.projection import clip
from llm_flock.protocol.motion.shield_async import Sighting, project_async
from llm_flock.protocol.motion.surroundings import static_half_spaces
from llm_flock.runtime.network.wire import Body, Command

STILL = 1e-6
"""Moves this short are none [units]."""

ANSWER_S = 0.25
"""A command that was not answered for so long was lost [s]."""


class Pilotage:
    """Flies a body to waypoints, one control period at a time.

    Args:
        mission: its limits and surroundings.
        speed: largest speed of any body [units/s].
        period_s: control period [s].
        lag_s: longest way of a command to the body [s].
        shield_on: project every move on what is safe.

    Attributes:
        waypoint: where it is to fly; None where it is to stand still [units; world frame].
        news: set with everything that another command may follow from.
    """

    def __init__(self, mission: Mission, *, speed: float, period_s: float, lag_s: float, shield_on: bool) -> None:
        self.waypoint: Point | None = None
        self.news = asyncio.Event()
        self._mission, self._limits = mission, Limits.of(mission)
        self._speed, self._period_s, self._lag_s = speed, period_s, lag_s
        self._shield_on = shield_on
        self._body: Body | None = None
        self._number = 0
        self._given = -math.inf

    @property
    def position(self) -> Point | None:
        """Where the body was last seen [units; world frame]."""
        return None if self._body is None else self._body.position

    @property
    def end(self) -> Point | None:
        """Where it will stop [units; world frame]."""
        return None if self._body is None else self._body.end

    def fly_to(self, waypoint: Point) -> None:
        """Set out for a place [units; world frame]."""
        self.waypoint = waypoint
        self.news.set()

    def felt(self, body: Body) -> None:
        """What the own body says of itself."""
        self._body = body
        self.news.set()
        self._number = max(self._number, body.command)

    @property
    def arrived(self) -> bool:
        """Whether the body stands at the waypoint."""
        body, target = self._body, self.waypoint
        return body is not None and target is not None and math.dist(body.position, target) <= STILL

    def is_free(self, now: float) -> bool:
        """Whether there is a waypoint to fly to, and no command under way to the body at this time [s]."""
        body = self._body
        if body is None or self.waypoint is None:
            return False
        return body.command >= self._number or now - self._given >= ANSWER_S

    def control(self, now: float, sightings: Sequence[Sighting], unseen_s: float) -> Command | None:
        """The next command; None where there is nothing to fly, nothing that is safe, or one under way.

        Args:
            now: by the wall clock [s].
            sightings: of everybody who is in sight.
            unseen_s: how long ago all others were out of sight [s].
        """
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
            move = clip(tuple(w - x for w, x in zip(waypoint, here, strict=True)), longest)
            return tuple(x + u for x, u in zip(here, move, strict=True))
        # The body may obey a little later than told: until it has done, the others may fly on.
        lasts_s = self._period_s + self._lag_s
        # Whoever is not in sight was outside the sensing range when the robot looked, and may have come since.
        room = self._mission.sensing - self._mission.safe_distance - self._speed * (unseen_s + lasts_s)
        longest = min(longest, max(room, 0.0))
        reach = min(1.0, longest / max(math.dist(here, waypoint), STILL))
        wish = tuple(x + reach * (w - x) for x, w in zip(here, waypoint, strict=True))
        target = project_async(
            here,
            wish,
            sightings,
            safe_distance=self._mission.safe_distance,
            speed=self._speed,
            period_s=lasts_s,
            also=static_half_spaces(here, self._limits, max_step=self._speed * lasts_s),
        )
        # A cell is convex and holds its robot, or lets it move away only: a shorter move the same way is safe as well.
        return _towards(here, target, longest)


def _towards(here: Point, target: Point, longest: float) -> Point:
    move = clip(tuple(t - x for t, x in zip(target, here, strict=True)), longest)
    return tuple(x + u for x, u in zip(here, move, strict=True))
