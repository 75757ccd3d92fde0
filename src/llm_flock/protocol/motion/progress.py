"""Progress towards the goal, and detours round whatever blocks a robot.

The cells of the shield keep robots apart but do not keep them from blocking each other: two robots that meet head-on
would face each other for ever, each on its own side. A robot that has not come nearer to its goal for `PATIENCE`
rounds turns its waypoint to the right, by as little as its cell needs to allow a useful move. All robots turn the same
way, so robots that block each other pass as on a roundabout. If one side has not helped within a number of rounds, the
robot tries the other side for twice as long. The first number depends on the id, so that two robots do not keep
changing sides together. Ways round obstacles are those of the roadmap (`llm_flock.obstacles.roadmap`).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
from msgspec.structs import replace

from llm_flock.arrays import Point, moved
from llm_flock.mission import Mission

PATIENCE = 3
"""Rounds without progress after which a robot counts as blocked."""

GAIN_SHARE = 0.05
"""Approaching the goal by this share of `max_step`, or of what is left, counts as progress."""

TURN_RAD = math.radians(15.0)
"""Angle between the directions that a detour tries."""

USEFUL_SHARE = 0.3
"""A move is useful if it leads at least this share of a step in the tried direction."""

SIDE_ROUNDS = 6
"""Rounds on one side before the other is tried, for the first time."""


class Leg(msgspec.Struct, frozen=True, kw_only=True):
    """The way to a goal.

    Attributes:
        goal: where it ends [units; frame of the mission].
        stop: its next corner, or the goal [units; frame of the mission].
        left: its length [units].
    """

    goal: Point
    stop: Point
    left: float


def leg_to(mission: Mission, position: Point, goal: Point, drift: Point = (), ahead: Point = ()) -> Leg:
    """The way from a position [units; world frame] to a goal of the mission's frame, round the obstacles of the world.

    The frame is displaced by `drift` now, and by `ahead` at the end of the round; empty if the mission stands still.
    """
    roadmap = mission.roadmap
    if roadmap is None:
        return Leg(goal=goal, stop=goal, left=math.dist(moved(position, drift, -1.0), goal))
    there = moved(goal, ahead)
    stop = roadmap.next_stop(position, there)
    left = roadmap.length(position, moved(goal, drift))
    return Leg(goal=goal, stop=goal if stop == there else moved(stop, ahead, -1.0), left=left)


class GoalProgress(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's progress towards its goal.

    Attributes:
        goal: the goal [units; frame of the mission].
        nearest: smallest length of the way there so far [units].
        idle: rounds since `nearest` last fell.
        side: side to which a detour turns: -1 right, 1 left.
        side_rounds: rounds after which a detour changes sides.
        rounds_on_side: rounds of the detour on this side so far.
    """

    goal: Point
    nearest: float
    idle: int = 0
    side: int = -1
    side_rounds: int = SIDE_ROUNDS
    rounds_on_side: int = 0

    @property
    def blocked(self) -> bool:
        """Whether the robot needs a detour."""
        return self.idle >= PATIENCE


def update_progress(
    progress: GoalProgress | None, leg: Leg, *, gain: float, within: float, side_rounds: int
) -> GoalProgress:
    """The progress after another round. Call once in each round, before the step.

    `gain` is the smallest approach that counts as progress, and `within` the distance at which the goal counts as
    reached [units]; after `side_rounds` a detour changes sides for the first time.
    """
    if progress is None or progress.goal != leg.goal or leg.left <= within or leg.left <= progress.nearest - gain:
        return GoalProgress(goal=leg.goal, nearest=leg.left, side_rounds=side_rounds)
    return replace(progress, idle=progress.idle + 1)


def detour(
    progress: GoalProgress, position: Point, stop: Point, project: Callable[[Point], Point], *, length: float
) -> tuple[Point, GoalProgress]:
    """The waypoint round whatever blocks the robot on the straight line to `stop`, and the progress for the next round.

    The step is of a given length [units] and turns in the first two dimensions; `project` is the shield's projection of
    a waypoint.
    """
    if progress.rounds_on_side >= progress.side_rounds:
        progress = replace(progress, side=-progress.side, side_rounds=2 * progress.side_rounds, rounds_on_side=0)
    straight = math.atan2(stop[1] - position[1], stop[0] - position[0])
    best, best_gain = position, 0.0
    for k in range(round(2 * math.pi / TURN_RAD)):
        heading = straight + progress.side * k * TURN_RAD
        direction = (math.cos(heading), math.sin(heading), *(0.0 for _ in position[2:]))
        # Straight ahead, the goal is far enough: beside another robot it is approached by halves.
        step = length if k else min(length, math.dist(position, stop))
        waypoint = project(moved(position, direction, step))
        gained = sum((y - x) * u for x, y, u in zip(position, waypoint, direction, strict=True))
        if gained > best_gain:
            best, best_gain = waypoint, gained
        if gained >= USEFUL_SHARE * step:
            break
    return best, replace(progress, rounds_on_side=progress.rounds_on_side + 1)
