"""Where a spare robot waits: near its position, and out of the way of the others."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from itertools import chain

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.plan import Plan
from llm_flock.protocol._membership.occupancy import sight

CLEARANCE = 2.0
"""Safe distances between a waiting robot and every place of the plan, so that another robot can pass between."""

ANGLES = 24
RINGS = 40


def waiting_place(
    mission: Mission, position: Point, plan: Plan, others: Sequence[Point], blocked: Collection[int] = ()
) -> Point:
    """The nearest point to `position` that is clear of all places, other robots, walls and obstacles.

    If slots are blocked by bodies, the point is in sight of the nearest of them where possible, because no other robot
    may be near enough to see it come free. Positions, of sensed robots in `others`, are in the frame of the mission
    [units].

    Returns:
        `position` itself where that is clear, or where no near point is.
    """
    clear = CLEARANCE * mission.safe_distance
    watched = min((plan.points[a] for a in blocked), key=lambda place: math.dist(position, place), default=position)
    reach = sight(mission)
    low, high = mission.arena

    def fits(point: Point) -> bool:
        return (
            all(math.dist(point, place) >= clear for place in plan.points)
            and all(math.dist(point, other) >= mission.safe_distance for other in others)
            and all(a <= x <= b for a, x, b in zip(low, point, high, strict=True))
            and clearance(point, mission.obstacles) >= mission.body_radius
        )

    around = _rings(watched, mission.safe_distance) if blocked else ()
    for point in chain(_rings(position, mission.safe_distance), around):
        if math.dist(point, watched) <= reach and fits(point):
            return point
    return next(filter(fits, _rings(position, mission.safe_distance)), position)


def _rings(center: Point, step: float) -> Iterator[Point]:
    """Points around a centre, the nearest first, in the plane of the first two axes."""
    yield center
    for ring in range(1, RINGS + 1):
        for k in range(ANGLES):
            angle = 2.0 * math.pi * k / ANGLES
            offset = (ring * step * math.cos(angle), ring * step * math.sin(angle))
            yield (center[0] + offset[0], center[1] + offset[1], *center[2:])
