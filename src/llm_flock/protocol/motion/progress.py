"""Progress towards the goal, and detours round whatever blocks a robot.

The cells of the shield keep robots apart but do not keep them from blocking each other: two robots that meet head-on
would face each other for ever, each on its own side. A robot that has not come nearer to its goal for `PATIENCE`
rounds turns its waypoint to the right, by as little as its cell needs to allow a useful move. All robots turn the same
way, so robots that block each other pass as on a roundabout. At obstacles, the robot keeps its left hand on them until
it is nearer to the goal than when it was blocked, which also leads out of dead ends (Lumelsky, Stepanov 1987: Bug
algorithms). If one side has not helped within a number of rounds, the robot tries the other side for twice as long.
The first number depends on the id, so that two robots do not keep changing sides together.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
from msgspec.structs import replace

from llm_flock.arrays import Point, moved

PATIENCE = 3
"""Rounds without progress after which a robot counts as blocked."""

GAIN_SHARE = 0.05
"""Approaching the goal by this share of `max_step` counts as progress."""

TURN_RAD = math.radians(15.0)
"""Angle between the directions that a detour tries."""

USEFUL_SHARE = 0.3
"""A move is useful if it leads at least this share of a step in the tried direction."""

SIDE_ROUNDS, SIDE_ROUNDS_AT_OBSTACLES = 6, 40
"""Rounds on one side before the other is tried, in missions without and with obstacles."""


class GoalProgress(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's progress towards its goal.

    Attributes:
        goal: the goal [units; frame of the mission].
        nearest: smallest distance to it so far [units].
        idle: rounds since `nearest` last fell.
        side: side to which a detour turns: -1 right, 1 left.
        side_rounds: rounds after which a detour changes sides.
        rounds_on_side: rounds of the detour on this side so far.
        heading_rad: direction of the detour's last move on this side; None before the first.
    """

    goal: Point
    nearest: float
    idle: int = 0
    side: int = -1
    side_rounds: int = SIDE_ROUNDS
    rounds_on_side: int = 0
    heading_rad: float | None = None

    @property
    def blocked(self) -> bool:
        """Whether the robot needs a detour."""
        return self.idle >= PATIENCE


def update_progress(
    progress: GoalProgress | None, position: Point, goal: Point, *, gain: float, within: float, side_rounds: int
) -> GoalProgress:
    """The progress after another round. Call once in each round, before the step.

    `gain` is the smallest approach that counts as progress, and `within` the distance at which the goal counts as
    reached [units; frame of the mission]; after `side_rounds` a detour changes sides for the first time.
    """
    distance = math.dist(position, goal)
    if progress is None or progress.goal != goal or distance <= within or distance <= progress.nearest - gain:
        return GoalProgress(goal=goal, nearest=distance, side_rounds=side_rounds)
    return replace(progress, idle=progress.idle + 1)


def detour(
    progress: GoalProgress, position: Point, project: Callable[[Point], Point], *, length: float, follow: bool
) -> tuple[Point, GoalProgress]:
    """The waypoint round whatever blocks the robot, and the progress for the next round.

    The step is of a given length [units] and turns in the first two dimensions; `project` is the shield's projection of
    a waypoint. With `follow` it keeps a hand on the obstacle, starting from the last heading; otherwise it tries the
    straight line first.
    """
    if progress.rounds_on_side >= progress.side_rounds:
        progress = replace(
            progress, side=-progress.side, side_rounds=2 * progress.side_rounds, rounds_on_side=0, heading_rad=None
        )
    straight = math.atan2(progress.goal[1] - position[1], progress.goal[0] - position[0])
    start = straight
    if follow and progress.heading_rad is not None:
        start = progress.heading_rad - progress.side * math.pi / 2
    best, best_gain, best_heading = position, 0.0, straight
    for k in range(round(2 * math.pi / TURN_RAD)):
        heading = start + progress.side * k * TURN_RAD
        direction = (math.cos(heading), math.sin(heading), *(0.0 for _ in position[2:]))
        waypoint = project(moved(position, direction, length))
        gained = sum((y - x) * u for x, y, u in zip(position, waypoint, direction, strict=True))
        if gained > best_gain:
            best, best_gain, best_heading = waypoint, gained, heading
        if gained >= USEFUL_SHARE * length:
            break
    if best_gain > 0.0:
        best_heading = math.atan2(best[1] - position[1], best[0] - position[0])
    return best, replace(progress, rounds_on_side=progress.rounds_on_side + 1, heading_rad=best_heading)
