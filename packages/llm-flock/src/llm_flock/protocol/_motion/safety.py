"""One robot's safe motion in lockstep: shielded steps, separation of crowds, and right of way."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import combinations

import numpy as np

from llm_flock import shield
from llm_flock.arrays import Point, between, moved, towards
from llm_flock.events import Note, Origin
from llm_flock.message import MAX_LEVEL, MAX_STOPS, Course
from llm_flock.mission import Mission
from llm_flock.obstacles import Mover, Obstacle
from llm_flock.protocol._motion.leg import STEP, Leg, map_of
from llm_flock.protocol._motion.projection import moving_half_spaces, static_half_spaces
from llm_flock.protocol._motion.right_of_way import RightOfWay, Way, outside, rank
from llm_flock.protocol._parts import Observation, SafeStep, Safety


class ShieldedSafety(Safety):
    """Turns waypoints into safe ones, gives way to others, and asks them to give way: `step` or `stay` in each round.

    `limits` is the mission at the start: no message changes safe distance, step limit, arena and obstacles.
    `noise_bound` is the largest error of a believed position [units], `delay` the age of sensed positions of others
    [rounds]. After each round in which it may fly, all robots stand still for `rests` rounds, so that they are seen.
    Unless it `asks`, it claims no right of way.
    """

    def __init__(
        self,
        robot: int,
        limits: Mission,
        noise_bound: float,
        passing_distance: float | None = None,
        *,
        delay: float = 0.0,
        rests: int = 0,
    ) -> None:
        self._robot, self._limits, self._noise_bound = robot, limits, noise_bound
        self._rests, self._horizon = rests, 1.0 + rests + delay
        self._moving: tuple[Mover, ...] = ()
        self._met: dict[int, Point] = {}  # where obstacles were in the last round of flight
        # With uncertain positions the sides of cells move inwards: bodies need more room to pass each other.
        margin = 2.0 * noise_bound * (1.0 + 4.0 * STEP * limits.max_step / limits.safe_distance)
        passing_distance = limits.safe_distance if passing_distance is None else passing_distance
        self._right_of_way = RightOfWay(robot, limits, passing_distance + margin)
        self._gave_way: int | None = None
        self.asks, self._asked = True, False

    @property
    def course(self) -> Course | None:
        """The way that this robot asks others to leave free; None if nothing is in its way."""
        return self._right_of_way.course

    def rests(self, round_: int) -> bool:
        """As `Safety.rests`: in all rounds but the first of each turn."""
        return (round_ - 1) % (1 + self._rests) > 0

    def begin_mission(self) -> None:
        """Begin another mission: heed all requests for a way again."""
        self._right_of_way.begin_mission()

    def stay(self, scene: Observation) -> SafeStep:
        """The step of a robot without a waypoint: holds the position, unless another is too near or has to pass."""
        here, self._moving = scene.position, scene.moving
        self._right_of_way.count(here, 0.0, 0.0, scene.period)
        separating = self._separate(scene)
        if separating is not None:
            return separating
        ways = [*self._obstacle_ways(scene), *self._right_of_way.ways(scene.sensed, scene.courses)]
        pressing = [way for way in ways if way.covers(here)]
        aside = self._aside(scene, here, ways, pressing, ()) if pressing else None
        return SafeStep(waypoint=here, origin=Origin.HOLD) if aside is None else aside

    def resting(self, scene: Observation) -> tuple[Obstacle, ...]:
        """As `Safety.resting`: those that are where they were in the last round, by sensors that err."""
        error, met = 2.0 * self._noise_bound, self._met
        return tuple(
            Obstacle(
                center=tuple(round(x, 1) for x in one.position), radius=one.radius + one.speed * self._horizon + error
            )
            for one in scene.moving
            if one.number in met and math.dist(met[one.number], one.position) <= error
        )

    def room(self, scene: Observation, leg: Leg) -> float:
        """As `Safety.room`; none for a robot that gives way to another."""
        if self._gave_way is not None:
            return 0.0
        self._moving = scene.moving
        here, stop = scene.position, moved(leg.stop, scene.drift)
        straight = self._project(here, towards(here, stop, self._limits.max_step), scene.others)
        return math.dist(here, stop) - math.dist(straight, stop)

    def step(self, scene: Observation, wish: Point, leg: Leg, tolerance: float) -> SafeStep:
        """The safe waypoint for `wish` [units; world frame]. The leg's goal is reached within `tolerance` [units]."""
        right, here, within = self._right_of_way, scene.position, tolerance + self._noise_bound
        self._moving = scene.moving
        right.count(leg.goal, leg.left, within, scene.period)
        separating = self._separate(scene)
        if separating is not None:
            return separating
        goal, stop = moved(leg.goal, scene.drift), moved(leg.stop, scene.drift)
        path = partial(self._path, here, stop, goal, scene.still)
        ways = [*self._obstacle_ways(scene), *right.ways(scene.sensed, scene.courses)]
        pressing = [way for way in ways if way.covers(here)]
        if pressing and not right.leads_out(here, path(), goal, pressing):
            aside = self._aside(scene, goal, ways, pressing, scene.still)
            if aside is not None:
                return aside
        safe = self._on_its_way(scene, stop, wish, self._project(here, wish, scene.others))
        free = [way for way in ways if not way.covers(here)]
        if not outside(free, here, safe):
            return self._wait(scene, wish, free)
        self._gave_way = None
        notes: tuple[Note, ...] = ()
        if pressing:
            right.pass_on(path(), pressing[0])
        elif self.asks and right.stalled and self._is_blocked(scene, stop, safe):
            right.ask(path())
            if not self._asked:
                notes = (Note("deadlock", {"goal_distance": math.dist(scene.here, leg.goal), "rounds": right.waited}),)
            self._asked = True
        else:
            self._asked = False
            right.go_on_asking(() if leg.left <= within else path())
        if safe == wish:
            return SafeStep(waypoint=wish, origin=Origin.MODEL, notes=notes)
        note = Note("shielded", {"proposed": wish, "flown": safe})
        return SafeStep(waypoint=safe, origin=Origin.SHIELD, notes=(*notes, note))

    def _aside(
        self, scene: Observation, goal: Point, ways: Sequence[Way], pressing: Sequence[Way], still: Sequence[Point]
    ) -> SafeStep | None:
        """A step out of the ways that this robot is in (`pressing`), None if it has nowhere to go."""
        here = scene.position
        refuge = self._right_of_way.refuge(here, goal, ways, pressing, scene.others)
        if refuge is None:
            return None
        path = self._path(here, self._next_stop(here, refuge, still), refuge, still)
        self._right_of_way.pass_on(path, pressing[0])
        to = self._project(here, towards(here, path[0], self._limits.max_step), scene.others)
        return SafeStep(waypoint=to, origin=Origin.YIELD, notes=self._note_way(pressing[0]))

    def _wait(self, scene: Observation, wish: Point, ways: Sequence[Way]) -> SafeStep:
        """The largest part of a step that leads into no other robot's way."""
        here = scene.position
        tried = (self._project(here, between(here, wish, share), scene.others) for share in (0.75, 0.5, 0.25, 0.125))
        to = next((safe for safe in tried if outside(ways, here, safe)), here)
        return SafeStep(waypoint=to, origin=Origin.YIELD, notes=self._note_way(ways[0]))

    def _note_way(self, way: Way) -> tuple[Note, ...]:
        """A note when this robot begins to give way to another."""
        before, self._gave_way = self._gave_way, way.robot
        if before == way.robot:
            return ()
        return (Note("evades", {"obstacle": ~way.robot}) if way.robot < 0 else Note("gives_way", {"to": way.robot}),)

    def _is_blocked(self, scene: Observation, stop: Point, safe: Point) -> bool:
        """Whether bodies cost the robot over half of the gain that planner and obstacles would allow."""
        here, others, passing = scene.position, scene.others, self._right_of_way.passing_distance
        straight, far = towards(here, stop, self._limits.max_step), math.dist(here, stop)
        alone = far - math.dist(self._project(here, straight, ()), stop)
        if passing > self._limits.safe_distance:
            safe = self._project(here, safe, others, passing)
        gained = max(far - math.dist(to, stop) for to in (safe, self._project(here, straight, others, passing)))
        return gained < 0.5 * alone

    def _path(self, here: Point, stop: Point, goal: Point, still: Sequence[Point]) -> list[Point]:
        """The next corners of the way, first `stop`, for a course of three steps [units; world frame]."""
        path, left = list[Point](), 3.0 * self._limits.max_step
        while left > 0.0 and len(path) < MAX_STOPS and (here != goal or not path):
            path.append(towards(here, stop, left))
            left -= math.dist(here, stop)
            here, stop = stop, self._next_stop(stop, goal, still)
        return path

    def _next_stop(self, here: Point, goal: Point, still: Sequence[Point]) -> Point:
        roadmap = map_of(self._limits, here, still, self._noise_bound)
        return goal if roadmap is None else roadmap.next_stop(here, goal)

    def _on_its_way(self, scene: Observation, stop: Point, wish: Point, safe: Point) -> Point:
        """The safe waypoint, or a shorter step if that one slides off the way, which would lead back to a corner."""
        here = scene.position
        roadmap = map_of(self._limits, here, (), self._noise_bound)
        if roadmap is None or safe == wish or roadmap.straight(safe, stop):
            return safe
        for shorter in (between(here, wish, share) for share in (0.5, 0.25, 0.125, 0.0625)):
            if roadmap.straight(shorter, stop) and self._project(here, shorter, scene.others) == shorter:
                return shorter
        return safe

    def _project(self, position: Point, wish: Point, others: tuple[Point, ...], distance: float | None = None) -> Point:
        """The point of the cell nearest to a wish, at the safe distance or another `distance` from other bodies."""
        limits, noise = self._limits, self._noise_bound
        return shield.project(
            position,
            wish,
            others,
            safe_distance=limits.safe_distance if distance is None else distance,
            max_step=limits.max_step,
            noise_bound=noise,
            downwash=limits.downwash,
            also=lambda longest: [
                *static_half_spaces(position, limits, max_step=longest, noise_bound=noise),
                *moving_half_spaces(
                    position, self._moving, limits, max_step=longest, horizon=self._horizon, noise_bound=noise
                ),
            ],
        )

    def _obstacle_ways(self, scene: Observation) -> list[Way]:
        """The ways of moving obstacles, as far as they fly in the direction of their last round until they are left."""
        limits, met, ways = self._limits, self._met, list[Way]()
        self._met = {mover.number: mover.position for mover in scene.moving}
        error = 2.0 * self._noise_bound
        # Robots that stand in the way pass on the right to leave it, by their own name: obstacles make no requests.
        highest = rank(self._robot, MAX_LEVEL, self._robot)
        for mover in scene.moving:
            apart = mover.radius + limits.body_radius + error
            width = apart + mover.speed * self._horizon
            before, here = met.get(mover.number, mover.position), mover.position
            flown, far = math.dist(before, here), mover.speed * (1 + self._rests) * (2.0 + width / limits.max_step)
            known = flown > 2.0 * error  # else it may be flying anywhere
            # Who is in the way has to leave it to a side, not along it.
            for length in (far, far + 4.0 * limits.max_step):
                line = np.array([here, between(before, here, 1.0 + length / flown) if known else here])
                way = Way(rank=highest, robot=~mover.number, line=line, width=width, apart=apart)
                if not way.covers(scene.position):
                    break
            ways.append(way)
        return ways

    def _separate(self, scene: Observation) -> SafeStep | None:
        """A step away from the middle of a crowd that is too close, if there is one: also for robots beside it."""
        limits, position, sensed = self._limits, scene.position, scene.sensed
        limit = limits.safe_distance - 2.0 * self._noise_bound - 1e-6  # rounding does not make a crowd
        reach = limits.safe_distance + limits.max_step
        near = {j: x for j, x in sensed.items() if limits.separation(x, position) < reach}
        crowd = _crowd({self._robot: position, **near}, limit, limits)
        if not crowd:
            return None
        spread = shield.spread_coincident(self._robot, position, sensed)
        members = [spread.get(j, position) for j in sorted(crowd)]
        middle = tuple(sum(axis) / len(members) for axis in zip(*members, strict=True))
        away = math.dist(position, middle)
        share = limits.max_step / away if away > 0.0 else 0.0
        wish = between(position, middle, -share)
        flown = self._project(position, wish, tuple(spread.values()))
        nearest = min(limits.separation(x, position) for x in near.values())
        note = Note("separating", {"nearest": nearest, "makes_way": self._robot not in crowd})
        return SafeStep(waypoint=flown, origin=Origin.SHIELD, notes=(note,))


def _crowd(positions: Mapping[int, Point], limit: float, mission: Mission) -> frozenset[int]:
    """All robots of pairs nearer than `limit`."""
    pairs = combinations(positions.items(), 2)
    return frozenset(robot for (i, x), (j, y) in pairs if mission.separation(x, y) < limit for robot in (i, j))
