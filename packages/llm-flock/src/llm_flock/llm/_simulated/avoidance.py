"""How a careful simulated model keeps away from the robots that a prompt names: a step aside, an orientation."""

from __future__ import annotations

import math
from collections.abc import Sequence

from llm_flock.arrays import Point, Points

TURNS_DEG = (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75)
SHARES = (1.0, 0.75, 0.5, 0.25)
"""Directions beside the way to the goal, and parts of the longest step, in the order in which they are tried."""


def keeps_away(here: Point, there: Point, others: Sequence[Point], safe_distance: float) -> bool:
    """Whether a step ends far enough from all others; from one that is too near already, it has to lead away."""
    return all(math.dist(there, other) >= min(safe_distance, math.dist(here, other)) for other in others)


def step_aside(
    here: Point, goal: Point, others: Sequence[Point], *, reach: float, safe_distance: float, decimals: int
) -> Point | None:
    """A step that gets nearer to the goal and keeps away from the others, rounded; None if none is found.

    Args:
        here: own position.
        goal: where to go, somewhere else.
        others: positions of the other robots.
        reach: longest step [units].
        safe_distance: to keep from others [units].
        decimals: of the step.
    """
    way = math.dist(here, goal)
    angle = math.atan2(goal[1] - here[1], goal[0] - here[0])
    longest, half = min(reach, way), 0.5 * 10.0**-decimals
    for turn in TURNS_DEG:
        for share in SHARES:
            # Shorter by what rounding may add.
            length, at = share * longest - 2 * half, angle + math.radians(turn)
            aside = (length * math.cos(at), length * math.sin(at), *(0.0,) * (len(here) - 2))
            there = tuple(round(x + d, decimals) for x, d in zip(here, aside, strict=True))
            if math.dist(there, goal) < way - half and keeps_away(here, there, others, safe_distance):
                return there
    return None


def clear_of_robots(points: Points, still: Sequence[Point], safe_distance: float) -> bool:
    """Whether all places, shape (n, d) [units], keep the safe distance from robots that stand still."""
    return all(math.dist(row, body) >= safe_distance for row in points.tolist() for body in still)
