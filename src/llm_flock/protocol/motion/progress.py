"""Does a robot get anywhere? A timer that notices when it does not, and a detour round what is in the way.

The cells of the shield keep robots apart, and cannot keep them from blocking each other: two that meet head-on stand
still for ever, each on its own side. A robot that has not come nearer to its goal for `PATIENCE` rounds turns its wish
to the right, as little as it must to get a real move out of its cell. All turn the same way, so robots that block each
other pass each other as on a roundabout. Round obstacles it keeps its left hand on them until it is nearer to the goal
than when it was blocked, which leads out of a dead end as well (Lumelsky, Stepanov 1987: Bug algorithms). A side that
has not helped for `lap` rounds is changed for the other, and the next try gets twice the time; laps differ by id, so
that robots do not change sides together for ever.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
from msgspec.structs import replace

from llm_flock.arrays import Point

PATIENCE = 3
"""Rounds without progress after which a robot counts as blocked."""

GAIN_SHARE = 0.05
"""Coming nearer by this share of `max_step` in one go counts as progress."""

TURN_RAD = math.radians(15.0)
"""Directions are tried in steps of this angle."""

REAL_SHARE = 0.3
"""A move is real if it leads at least this share of a step in the direction that was tried."""

LAP, LAP_AT_OBSTACLES = 6, 40
"""Rounds on one side before the other is tried, in the open and where there are obstacles."""


class GoalProgress(msgspec.Struct, frozen=True, kw_only=True):
    """How a robot has fared on the way to its goal.

    Attributes:
        goal: the goal that is watched [units; world frame].
        nearest: smallest distance to it so far [units].
        idle: rounds since that last fell.
        side: -1 while it turns to the right, 1 to the left.
        lap: rounds that this side is given.
        on_lap: rounds that it has had.
        heading_rad: direction of the last move of a detour round an obstacle, None in the open.
    """

    goal: Point
    nearest: float
    idle: int = 0
    side: int = -1
    lap: int = LAP
    on_lap: int = 0
    heading_rad: float | None = None

    @property
    def blocked(self) -> bool:
        """Whether a detour is due."""
        return self.idle >= PATIENCE


def watch(
    progress: GoalProgress | None, position: Point, goal: Point, *, gain: float, within: float, lap: int
) -> GoalProgress:
    """What a round at `position` means for the progress.

    Args:
        progress: that of the round before, None in the first.
        position: where the robot believes it is [units].
        goal: where it has to go.
        gain: how much nearer counts as progress [units].
        within: distance from the goal that is near enough [units].
        lap: rounds to give to the first side.
    """
    distance = math.dist(position, goal)
    if progress is None or progress.goal != goal or distance <= within or distance <= progress.nearest - gain:
        return GoalProgress(goal=goal, nearest=distance, lap=lap)
    return replace(progress, idle=progress.idle + 1)


def detour(
    progress: GoalProgress, position: Point, fly: Callable[[Point], Point], *, length: float, follow: bool
) -> tuple[Point, GoalProgress]:
    """The next step round what is in the way.

    Args:
        progress: of a blocked robot.
        position: where it believes it is [units].
        fly: the safe waypoint for a wished one.
        length: of the step [units].
        follow: keep a hand on what is in the way, as obstacles need it; otherwise the straight way is tried first.

    Returns:
        The waypoint, and the progress to carry on with. Turns are made in the first two dimensions.
    """
    if progress.on_lap >= progress.lap:
        progress = replace(progress, side=-progress.side, lap=2 * progress.lap, on_lap=0, heading_rad=None)
    straight = math.atan2(progress.goal[1] - position[1], progress.goal[0] - position[0])
    start = straight
    if follow and progress.heading_rad is not None:
        start = progress.heading_rad - progress.side * math.pi / 2
    best, best_gain, best_heading = position, 0.0, straight
    for k in range(round(2 * math.pi / TURN_RAD)):
        heading = start + progress.side * k * TURN_RAD
        along = (math.cos(heading), math.sin(heading), *(0.0 for _ in position[2:]))
        flown = fly(tuple(x + length * u for x, u in zip(position, along, strict=True)))
        gained = sum((y - x) * u for x, y, u in zip(position, flown, along, strict=True))
        if gained > best_gain:
            best, best_gain, best_heading = flown, gained, heading
        if gained >= REAL_SHARE * length:
            break
    if best_gain > 0.0:
        best_heading = math.atan2(best[1] - position[1], best[0] - position[0])
    return best, replace(progress, on_lap=progress.on_lap + 1, heading_rad=best_heading)
