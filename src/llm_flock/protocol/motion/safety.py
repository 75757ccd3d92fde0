"""One robot's safe motion in lockstep: shielded steps, separation of crowds, and detours."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations

import msgspec

from llm_flock.arrays import Point, moved
from llm_flock.mission import Mission
from llm_flock.protocol.events import Note, Origin
from llm_flock.protocol.motion import shield
from llm_flock.protocol.motion.progress import (
    GAIN_SHARE,
    SIDE_ROUNDS,
    GoalProgress,
    Leg,
    detour,
    update_progress,
)
from llm_flock.protocol.motion.surroundings import static_half_spaces

SHORTER = (0.5, 0.25, 0.125, 0.0625)
"""Shares of a step that are tried where the whole one slides off the way."""

SEPARATION_TOLERANCE = 1e-6
"""Pairs that keep the safe distance to within this count as separated [units]."""


class SafeStep(msgspec.Struct, frozen=True, kw_only=True):
    """A safe waypoint, its origin, and notes for the record."""

    waypoint: Point
    origin: Origin
    notes: tuple[Note, ...] = ()


class Safety:
    """Turns the planner's waypoints into safe ones, and follows the robot's progress.

    Call `step` or `stay` once in each round. `limits` is the mission at the start: no message changes safe distance,
    step limit, arena and obstacles. `noise_bound` is the largest error of a believed position [units].
    """

    def __init__(self, robot: int, limits: Mission, noise_bound: float) -> None:
        self._robot, self._limits, self._noise_bound = robot, limits, noise_bound
        self._progress: GoalProgress | None = None
        self._side_rounds = SIDE_ROUNDS + 2 * (robot % 4)

    def stay(self, position: Point, sensed: Mapping[int, Point]) -> SafeStep:
        """The step of a robot without a waypoint: hold the position, unless another robot is too near."""
        separating = self._separate(position, sensed)
        return SafeStep(waypoint=position, origin=Origin.HOLD) if separating is None else separating

    def step(
        self,
        position: Point,
        sensed: Mapping[int, Point],
        wish: Point,
        leg: Leg,
        tolerance: float,
        drift: Point = (),
    ) -> SafeStep:
        """The safe waypoint for the planner's waypoint `wish` [units; world frame].

        The mission's frame is displaced by `drift` (empty if the mission stands still), and the goal of the leg counts
        as reached within `tolerance` [units].
        """
        separating = self._separate(position, sensed)
        if separating is not None:
            return separating
        limits = self._limits
        here = moved(position, drift, -1.0)
        was_blocked = self._progress is not None and self._progress.blocked
        progress = self._progress = update_progress(
            self._progress,
            leg,
            gain=GAIN_SHARE * min(limits.max_step, leg.left),
            within=tolerance + self._noise_bound,
            side_rounds=self._side_rounds,
        )
        others = tuple(sensed.values())
        stop = moved(leg.stop, drift)
        safe = self._on_its_way(position, stop, wish, self._project(position, wish, others), others)
        if not progress.blocked or self._in_nobodys_way(position, stop, wish, safe):
            if safe == wish:
                return SafeStep(waypoint=wish, origin=Origin.MODEL)
            note = Note("shielded", {"proposed": wish, "flown": safe})
            return SafeStep(waypoint=safe, origin=Origin.SHIELD, notes=(note,))
        waypoint, self._progress = detour(
            progress,
            here,
            leg.stop,
            lambda target: moved(self._project(position, moved(target, drift), others), drift, -1.0),
            length=min(limits.max_step, max(math.dist(here, leg.stop), limits.safe_distance)),
        )
        blocked = Note("deadlock", {"goal_distance": math.dist(here, leg.goal), "rounds": progress.idle})
        notes = () if was_blocked else (blocked,)
        return SafeStep(waypoint=moved(waypoint, drift), origin=Origin.DETOUR, notes=notes)

    def _on_its_way(self, position: Point, stop: Point, wish: Point, safe: Point, others: tuple[Point, ...]) -> Point:
        """The safe waypoint, or a shorter step of the wish if that slides off the way between two obstacles.

        From where it slides to, the robot would be sent back to the last corner, for ever.
        """
        roadmap = self._limits.roadmap
        if roadmap is None or safe == wish or roadmap.straight(safe, stop):
            return safe
        for share in SHORTER:
            shorter = tuple(x + share * (w - x) for x, w in zip(position, wish, strict=True))
            if roadmap.straight(shorter, stop) and self._project(position, shorter, others) == shorter:
                return shorter
        return safe

    def _in_nobodys_way(self, position: Point, stop: Point, wish: Point, safe: Point) -> bool:
        """Whether obstacles alone slow a robot that heads for its next stop: its way leads past them."""
        if not self._limits.obstacles or math.dist(safe, stop) >= math.dist(position, stop):
            return False
        return safe == self._on_its_way(position, stop, wish, self._project(position, wish, ()), ())

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
        """A step away from the middle of a crowd that is too close, None without one nearby.

        Robots near such a crowd make way: those inside cannot leave while others stand around them.
        """
        limits = self._limits
        limit = limits.safe_distance - 2.0 * self._noise_bound - SEPARATION_TOLERANCE
        reach = limits.safe_distance + limits.max_step
        near = {j: x for j, x in sensed.items() if math.dist(x, position) < reach}
        crowd = _crowd({self._robot: position, **near}, limit)
        if not crowd:
            return None
        apart = shield.spread_coincident(self._robot, position, sensed)
        members = [apart.get(j, position) for j in sorted(crowd)]
        middle = tuple(sum(axis) / len(members) for axis in zip(*members, strict=True))
        away = math.dist(position, middle)
        share = limits.max_step / away if away > 0.0 else 0.0
        wish = tuple(x + share * (x - c) for x, c in zip(position, middle, strict=True))
        flown = self._project(position, wish, tuple(apart.values()))
        nearest = min(math.dist(x, position) for x in near.values())
        note = Note("separating", {"nearest": nearest, "makes_way": self._robot not in crowd})
        return SafeStep(waypoint=flown, origin=Origin.SHIELD, notes=(note,))


def _crowd(positions: Mapping[int, Point], limit: float) -> frozenset[int]:
    """All robots of pairs nearer than `limit`."""
    pairs = combinations(positions.items(), 2)
    return frozenset(robot for (i, x), (j, y) in pairs if math.dist(x, y) < limit for robot in (i, j))
