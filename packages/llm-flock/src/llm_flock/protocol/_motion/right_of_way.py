"""Right of way: a blocked robot broadcasts its course, and robots in that way step aside.

Priority inheritance, as in PIBT (Okumura, Machida, Défago, Tamura 2022), in continuous space and from messages only;
docs/explanation/safe-motion.md describes it. Ranks rise with waiting, and with them the width of the way that is given.
Courses are requests only: the shield's cells keep robots apart, even if a course is a lie.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import TypeAlias

import msgspec
import numpy as np

from llm_flock.arrays import Point, Points, Vector, flattened
from llm_flock.message import MAX_LEVEL, Course
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.roadmap import on_sphere
from llm_flock.shapes import ring

STALLED = 3  # rounds without progress towards the goal after which a blocked robot asks for its way
KEPT = 2  # rounds for which a robot that was blocked keeps its course
RISES = 8  # rounds of waiting for the first rank above the lowest; each further one takes twice as long
WIDTH, WIDER, WIDEST = 0.95, 0.05, 1.5  # half the width of a way: lowest rank, more per rank, limit [safe distances]

HEEDED_ROUNDS = 32
"""Rounds in a mission for which a robot gives way to one that asks. For twice as long it then ignores that robot."""

BETWEEN = 4
"""Most rounds between two requests that count as rounds of asking: a robot that gives way may lose sight of one."""

Rank: TypeAlias = tuple[int, int, bool, int]
"""Level, then the lower id of the robot whose right it is, then that robot itself before those that make way for it."""


def rank(sender: int, level: int, of: int) -> Rank:
    """The rank of a robot that asks by the right of `of`. Higher ranks compare greater."""
    return level, -of, sender == of, -sender


class Way(msgspec.Struct, frozen=True, kw_only=True):
    """A way that a robot asks for: its corners from there, shape (k, d), and half its width [units; world frame].

    Others pass its robot at a distance of `apart`, or the usual one if that is larger [units]. All these distances are
    those of `arrays.flattened`.
    """

    rank: Rank
    robot: int
    line: Points
    width: float
    apart: float = 0.0
    downwash: float = 1.0

    def distances(self, points: Points) -> Vector:
        """The distance of each of some points, shape (m, d), from the middle of the way, shape (m,) [units]."""
        line, points = flattened(self.line, self.downwash), flattened(points, self.downwash)
        legs = [_distances(points, a, b) for a, b in pairwise(line)]
        return np.min(legs, axis=0)

    def covers(self, point: Point) -> bool:
        """Whether a body at a point is in the way."""
        return float(self.distances(np.array([point]))[0]) < self.width - 1e-6


class RightOfWay:
    """The ways that a robot asks for, and those that it gives. Call `count` once in each round, then other methods.

    Bodies pass each other at `passing_distance`, by default the safe distance [units]. `waited` counts rounds
    without progress since the robot was at its goal, or had none.
    """

    def __init__(self, robot: int, limits: Mission, passing_distance: float | None = None) -> None:
        self.course: Course | None = None
        self._robot, self._limits = robot, limits
        self.passing_distance = limits.safe_distance if passing_distance is None else passing_distance
        self._period: int | None = None
        self._counts = True
        self.waited = self._kept = self._idle = 0
        self._nearest: tuple[Point, float] = (), math.inf
        self._round = 0
        # By asking robot: rounds, next pause, and the last round, or the first one after a pause.
        self._asked: dict[int, tuple[int, int, int]] = {}

    @property
    def stalled(self) -> bool:
        """Whether the robot has come no nearer to its goal for some rounds."""
        return self._idle >= STALLED

    @property
    def _level(self) -> int:
        return min((self.waited // RISES).bit_length(), MAX_LEVEL)

    def count(self, goal: Point, left: float, within: float, period: int | None = None) -> None:
        """Begin a round, with the length of the way to a goal that counts as reached within a distance [units].

        Only the first round within a heartbeat `period` counts: otherwise robots that a body stops after a moment would
        lose patience faster than those that fly.
        """
        self._counts, self._period = period is None or period != self._period, period
        at_goal = left <= within
        before, nearest = self._nearest
        # A share of the way left counts too: beside another robot, a place is approached by halves.
        nearer = left <= nearest - 0.05 * min(self._limits.max_step, left)
        if at_goal or goal != before or nearer:
            self._nearest, self._idle = (goal, left), 0
        else:
            self._idle += self._counts
        self.waited = 0 if at_goal else self.waited + (self._counts and self._idle > 0)
        self.course = None
        self._round += self._counts

    def ways(self, sensed: Mapping[int, Point], courses: Mapping[int, Course]) -> list[Way]:
        """The ways that this robot has to give, to robots in sight, the highest rank first.

        A robot that has asked for `HEEDED_ROUNDS` in all is not heeded for twice as long, then for four times, and so
        on, independent of its position and request: otherwise a moving liar could keep others away without end.
        """
        own, asked = rank(self._robot, self._level, self._robot), list[Way]()
        for j, course in courses.items():
            if j not in sensed or (theirs := rank(j, course.level, course.of)) <= own:
                continue
            width = self.passing_distance * min(WIDEST, WIDTH + WIDER * course.level)
            line = np.array([sensed[j], *course.path])
            asked.append(Way(rank=theirs, robot=j, line=line, width=width, downwash=self._limits.downwash))
        heeded = [way for way in asked if self._heeds(way.robot)]
        return sorted(heeded, key=lambda way: way.rank, reverse=True)

    def _heeds(self, robot: int) -> bool:
        """Whether a robot that asks in this round is heeded; counts those rounds, and short times between them."""
        asked, pause, last = self._asked.get(robot, (0, 2 * HEEDED_ROUNDS, self._round - 1))
        if self._round < last:
            return False
        asked += min(self._round - last, BETWEEN)
        if asked <= HEEDED_ROUNDS:
            self._asked[robot] = asked, pause, self._round
            return True
        self._asked[robot] = 1, 2 * pause, self._round + pause
        return False

    def begin_mission(self) -> None:
        """Begin another mission: heed all requests again."""
        self._asked.clear()

    def ask(self, path: Sequence[Point]) -> None:
        """Ask for the way along a path [units; world frame] by the own right: bodies block it."""
        self._kept = KEPT
        self._ask(path, self._level, self._robot)

    def go_on_asking(self, path: Sequence[Point]) -> None:
        """Keep asking for a while after the way has become free, so that no robot closes it again at once."""
        self._kept = max(0, self._kept - self._counts)
        if self._kept:
            self._ask(path, self._level, self._robot)

    def pass_on(self, path: Sequence[Point], way: Way) -> None:
        """Ask for the own way, or the way to a refuge, by the right of the robot to which this one gives way."""
        self._ask(path, way.rank[0], -way.rank[1])

    def _ask(self, path: Sequence[Point], level: int, of: int) -> None:
        self.course = Course(level=level, of=of, path=tuple(path)) if path else None

    def leads_out(self, here: Point, path: Sequence[Point], goal: Point, ways: Sequence[Way]) -> bool:
        """Whether a path to the goal leads out of these ways, and past none of their robots."""
        if any(way.covers(goal) for way in ways):
            return False
        return all(self._leads_away(a, b, ways) for a, b in pairwise((here, *path)))

    def refuge(
        self, here: Point, goal: Point, ways: Sequence[Way], pressing: Sequence[Way], others: Iterable[Point]
    ) -> Point | None:
        """A place to wait until other robots have passed [units; world frame]; None if there is no such place.

        It is outside all ways if possible; otherwise outside those that the robot is in (`pressing`); otherwise outside
        the one of highest rank. The place with the smallest detour is chosen. `others` are the bodies in sight.
        """
        for avoided in (ways, pressing, pressing[:1]):
            refuge = self._nearest_refuge(here, goal, avoided, np.array([*others]).reshape(-1, len(here)))
            if refuge is not None:
                return refuge
        return None

    def _nearest_refuge(self, here: Point, goal: Point, ways: Sequence[Way], others: Points) -> Point | None:
        limits, margin = self._limits, 0.05 * self.passing_distance  # a refuge is farther from a way than it has to be
        too_near_cost = 6.0  # for each unit of distance that another body lacks
        spots = np.array(here) + limits.max_step * _around(len(here))
        low, high = np.array(limits.arena)
        free = ((spots >= low) & (spots <= high)).all(axis=1)
        for way in ways:
            free &= way.distances(spots) >= way.width + margin
        spots = spots[free]
        roadmap = limits.roadmap
        if roadmap is not None:
            spots = spots[[clearance(tuple(spot), limits.obstacles) >= limits.body_radius for spot in spots.tolist()]]
        if roadmap is None:
            to, on = (np.linalg.norm(spots - np.array(end), axis=1) for end in (here, goal))
        else:
            to, on = (roadmap.lengths_to(spots, end) for end in (here, goal))
        away = np.linalg.norm(flattened(spots[:, None] - others, limits.downwash), axis=2)
        crowd = np.maximum(0.0, self.passing_distance - away).sum(axis=1)
        cost = 2.0 * to + on + too_near_cost * crowd
        for k in cost.argsort(kind="stable")[: int(np.isfinite(cost).sum())]:
            spot = tuple(spots[k].tolist())
            stop = spot if roadmap is None else roadmap.next_stop(here, spot)
            if self._leads_away(here, stop, ways):
                return spot
        return None

    def _leads_away(self, here: Point, stop: Point, ways: Sequence[Way]) -> bool:
        """Whether a straight flight to a stop leads past none of the robots of these ways."""
        for way in ways:
            comes, start, end = flattened([way.line[0], here, stop], way.downwash)[:, None]
            room = min(float(np.linalg.norm(start - comes)), max(self.passing_distance, way.apart))
            if float(_distances(comes, start[0], end[0])[0]) < room - 1e-6:
                return False
        return True


def outside(ways: Iterable[Way], here: Point, there: Point) -> bool:
    """Whether a step leads no deeper into any way."""
    return all(
        float(after) >= min(way.width, float(before)) - 1e-6
        for way in ways
        for before, after in [way.distances(np.array([here, there]))]
    )


@lru_cache
def _around(dim: int) -> Points:
    """Candidate refuges: points on circles or spheres, relative to the robot, shape (m, d) [steps]."""
    rings = np.array((0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0))  # the farthest is beyond the end of any course
    return (rings[:, None, None] * (ring(24, 1.0) if dim == 2 else on_sphere(40))).reshape(-1, dim)


def _distances(points: Points, start: Vector, end: Vector) -> Vector:
    """The distance of each point, shape (m, d), from a segment, shape (m,) [units]."""
    along = end - start
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-18), 0.0, 1.0)
    return np.linalg.norm(points - (start + share[:, None] * along), axis=1)
