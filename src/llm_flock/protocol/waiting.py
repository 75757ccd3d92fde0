"""Where a robot waits that has no place in the plan: out of the others' way, as near as it can."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.protocol.plan import Plan

CLEARANCE = 2.0
"""Safe distances that a waiting robot keeps from every place of the plan: another robot can pass in between."""

ANGLES = 24
RINGS = 40


def waiting_place(mission: Mission, position: Point, plan: Plan, others: Sequence[Point]) -> Point:
    """The nearest point to `position` that is clear of all places, of other robots, of walls and of obstacles.

    Args:
        mission: limits, arena and obstacles.
        position: own believed position [units].
        plan: the plan in which all places are taken.
        others: positions of the robots that are sensed [units].

    Returns:
        `position` itself where that is clear, or where nothing near is.
    """
    clear = CLEARANCE * mission.safe_distance
    low, high = mission.arena

    def fits(point: Point) -> bool:
        return (
            all(math.dist(point, place) >= clear for place in plan.points)
            and all(math.dist(point, other) >= mission.safe_distance for other in others)
            and all(a <= x <= b for a, x, b in zip(low, point, high, strict=True))
            and clearance(point, mission.obstacles) >= mission.body_radius
        )

    return next((point for point in _rings(position, mission.safe_distance) if fits(point)), position)


def _rings(center: Point, step: float) -> Iterator[Point]:
    """Points around a centre, the nearest first; in the plane of the first two axes."""
    yield center
    for ring in range(1, RINGS + 1):
        for k in range(ANGLES):
            angle = 2.0 * math.pi * k / ANGLES
            offset = (ring * step * math.cos(angle), ring * step * math.sin(angle))
            yield (center[0] + offset[0], center[1] + offset[1], *center[2:])
