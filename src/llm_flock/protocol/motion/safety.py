"""One robot's safe motion in lockstep: the shield, the way out of too close a start, detours round what blocks."""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec

from llm_flock.arrays import Point, moved
from llm_flock.protocol.events import Note, Origin
from llm_flock.protocol.motion import progress as timing
from llm_flock.protocol.motion import shield
from llm_flock.protocol.motion.limits import Limits
from llm_flock.protocol.motion.surroundings import static_half_spaces

CLOSE = 1e-6
"""Pairs that keep the safe distance to within this count as apart [units]."""


class SafeStep(msgspec.Struct, frozen=True, kw_only=True):
    """What is flown instead of a wish, who made it, and what the record is told."""

    waypoint: Point
    origin: Origin
    notes: tuple[Note, ...] = ()


class Safety:
    """Turns wishes into safe waypoints, and remembers how the robot fares.

    Args:
        robot: own id.
        limits: safe distance, step limit, arena and obstacles.
        noise_bound: largest error of a believed position [units].
    """

    def __init__(self, robot: int, limits: Limits, noise_bound: float) -> None:
        self._robot = robot
        self._limits = limits
        self._noise_bound = noise_bound
        self._progress: timing.GoalProgress | None = None
        self._lap = (timing.LAP_AT_OBSTACLES if limits.obstacles else timing.LAP) + 2 * (robot % 4)

    def stay(self, position: Point, sensed: Mapping[int, Point]) -> SafeStep:
        """Without a wish a robot stays where it is, unless somebody is too near."""
        apart = self._separate(position, sensed)
        return SafeStep(waypoint=position, origin=Origin.HOLD) if apart is None else apart

    def step(
        self,
        position: Point,
        sensed: Mapping[int, Point],
        wish: Point,
        goal: Point,
        tolerance: float,
        drift: Point = (),
    ) -> SafeStep:
        """The safe waypoint for a wish.

        Args:
            position: where the robot believes it is [units; world frame].
            sensed: believed positions of the robots within sensing range, by id.
            wish: where its planner wants to be next.
            goal: where it has to end [units; frame of the mission].
            tolerance: distance from the goal that is near enough [units].
            drift: how far that frame has travelled [units]; empty where it stands still. GoalProgress is made in it.
        """
        apart = self._separate(position, sensed)
        if apart is not None:
            return apart
        limits = self._limits
        here = moved(position, drift, -1.0)
        was_blocked = self._progress is not None and self._progress.blocked
        seen = timing.watch(
            self._progress,
            here,
            goal,
            gain=timing.GAIN_SHARE * limits.max_step,
            within=tolerance + self._noise_bound,
            lap=self._lap,
        )
        self._progress = seen
        others = tuple(sensed.values())
        if not seen.blocked:
            safe = self._project(position, wish, others)
            if safe == wish:
                return SafeStep(waypoint=wish, origin=Origin.MODEL)
            note = Note("shielded", {"proposed": wish, "flown": safe})
            return SafeStep(waypoint=safe, origin=Origin.SHIELD, notes=(note,))
        distance = math.dist(here, goal)
        waypoint, self._progress = timing.detour(
            seen,
            here,
            lambda target: moved(self._project(position, moved(target, drift), others), drift, -1.0),
            length=min(limits.max_step, max(distance, limits.safe_distance)),
            follow=bool(limits.obstacles),
        )
        notes = () if was_blocked else (Note("deadlock", {"goal_distance": distance, "rounds": seen.idle}),)
        return SafeStep(waypoint=moved(waypoint, drift), origin=Origin.DETOUR, notes=notes)

    def _project(self, position: Point, wish: Point, others: tuple[Point, ...]) -> Point:
        limits, noise = self._limits, self._noise_bound
        return shield.project(
            position,
            wish,
            others,
            safe_distance=limits.safe_distance,
            max_step=limits.max_step,
            noise_bound=noise,
            also=lambda longest: static_half_spaces(position, limits, max_step=longest, noise_bound=noise),
        )

    def _separate(self, position: Point, sensed: Mapping[int, Point]) -> SafeStep | None:
        """Away from the middle of a crowd that is too near, as long as there is one; None where there is none.

        Robots that are near such a crowd make way: those inside cannot leave while the others stand around them.
        """
        limits = self._limits
        limit = limits.safe_distance - 2.0 * self._noise_bound - CLOSE
        reach = limits.safe_distance + limits.max_step
        near = {j: x for j, x in sensed.items() if math.dist(x, position) < reach}
        places = {self._robot: position, **near}
        crowd = _too_near(places, limit)
        if not crowd:
            return None
        apart = shield.told_apart(self._robot, position, sensed)
        members = [apart.get(j, position) for j in sorted(crowd)]
        middle = tuple(sum(axis) / len(members) for axis in zip(*members, strict=True))
        away = math.dist(position, middle)
        share = limits.max_step / away if away > 0.0 else 0.0
        wish = tuple(x + share * (x - c) for x, c in zip(position, middle, strict=True))
        flown = self._project(position, wish, tuple(apart.values()))
        nearest = min(math.dist(x, position) for x in near.values())
        note = Note("separating", {"nearest": nearest, "makes_way": self._robot not in crowd})
        return SafeStep(waypoint=flown, origin=Origin.SHIELD, notes=(note,))


def _too_near(places: Mapping[int, Point], limit: float) -> frozenset[int]:
    """Everybody in a pair nearer than `limit`."""
    ids = sorted(places)
    pairs = ((i, j) for k, i in enumerate(ids) for j in ids[:k] if math.dist(places[i], places[j]) < limit)
    return frozenset(robot for pair in pairs for robot in pair)
