"""Connected regions of the free plane: where a body can get to between obstacles and walls.

Only in the plane: balls in space seal no room off unless they are packed against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

from llm_flock.arrays import Point
from llm_flock.obstacles.obstacle import Obstacle

if TYPE_CHECKING:
    import shapely  # imported where it is used: missions without obstacles start faster without it

ARC = 64
"""Sides of a quarter of a circle. Outlines of grown obstacles lie inside the exact ones, by less than 1e-4 radii: a gap
that is a hair too narrow may count as passable, one that is wide enough always does."""


@lru_cache(maxsize=256)
def free_regions(
    arena: tuple[Point, Point], obstacles: tuple[Obstacle, ...], radius: float
) -> tuple[shapely.Polygon, ...]:
    """The regions in which the centre of a body of this radius can move [units]; there is no way between two of them.

    A centre stays inside the arena, and `radius` away from obstacles.
    """
    import shapely

    grown = [_shape(obstacle, radius) for obstacle in obstacles]
    (left, low), (right, high) = arena
    free = shapely.box(left, low, right, high).difference(shapely.union_all(grown))
    parts = free.geoms if isinstance(free, shapely.MultiPolygon) else [free]
    return tuple(part for part in parts if isinstance(part, shapely.Polygon) and not part.is_empty)


def region_of(point: Point, regions: Sequence[shapely.Polygon]) -> int:
    """Index of the region that a point is in, or nearest to; -1 if there is none."""
    import shapely

    here = shapely.Point(point)
    return min(range(len(regions)), key=lambda k: regions[k].distance(here), default=-1)


def _shape(obstacle: Obstacle, radius: float) -> shapely.Geometry:
    import shapely

    if obstacle.polygon is not None:
        return shapely.buffer(shapely.Polygon(obstacle.polygon), radius, quad_segs=ARC)
    assert obstacle.center is not None and obstacle.radius is not None, "an obstacle is a disc or a polygon"
    return shapely.buffer(shapely.Point(obstacle.center), obstacle.radius + radius, quad_segs=ARC)
