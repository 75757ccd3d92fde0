"""One obstacle: its description in a mission, and distances and directions to it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from llm_flock.arrays import MAX_COORDINATE, Point
from llm_flock.bounds import MAX_POLYGON_CORNERS
from llm_flock.errors import InputError
from llm_flock.obstacles import polygons

Finite = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=MAX_COORDINATE, allow_inf_nan=False)]

TOUCHING = 1e-9
"""A point nearer to the boundary than this counts as on it [units]."""


@dataclass(frozen=True, slots=True)
class Nearest:
    """The nearest point of a convex set: its distance [units; negative inside], and the unit vector outward."""

    distance: float
    outward: Point


class Obstacle(BaseModel):
    """A static obstacle: `center` and `radius` of a disc, or the corners of a `polygon`.

    A disc in three dimensions is a ball; polygons exist in the plane only. Lengths are in mission units, positions in
    the world frame.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    center: tuple[Finite, ...] | None = Field(default=None, description="Centre of a disc [units]")
    radius: Positive | None = Field(default=None, description="Radius of a disc [units]")
    polygon: tuple[tuple[Finite, Finite], ...] | None = Field(
        default=None, description="Corners of a polygon, convex or not, in order [units]"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        given: dict[str, Any] = self.model_dump(exclude_none=True)
        if set(given) not in ({"center", "radius"}, {"polygon"}):
            raise InputError("obstacles", given, "either center and radius, or polygon, for each obstacle")
        if self.polygon is not None and len(self.polygon) > MAX_POLYGON_CORNERS:
            raise InputError(
                "obstacles", f"a polygon of {len(self.polygon)} corners", f"at most {MAX_POLYGON_CORNERS} corners"
            )
        if self.polygon is not None and (len(self.polygon) < 3 or not polygons.is_simple(self.polygon)):
            allowed = "polygons of 3 or more corners that enclose an area and do not cross themselves"
            raise InputError("obstacles", given, allowed)
        return self

    @property
    def dim(self) -> int:
        """Dimension d of space, 2 or 3."""
        return 2 if self.center is None else len(self.center)

    @cached_property
    def pieces(self) -> tuple[tuple[Point, ...], ...]:
        """The polygon divided into convex pieces; empty for a disc."""
        return () if self.polygon is None else polygons.convex_pieces(self.polygon)

    def distance(self, point: Point) -> float:
        """Distance of `point` from the obstacle's surface [units]; negative inside."""
        if self.polygon is None:
            center, radius = self._disc()
            return math.dist(point, center) - radius
        gap = min(math.dist(point, polygons.nearest_on_segment(point, a, b)) for a, b in polygons.edges(self.polygon))
        return -gap if polygons.contains(self.polygon, point) else gap

    def nearest(self, point: Point) -> list[Nearest]:
        """The nearest point of each convex piece; for a point inside, the nearest point of the outline only.

        A robot that stays on its own side of the plane through each of these points, normal to `outward`, cannot
        touch the obstacle: a convex set lies entirely beyond the plane through its nearest point.
        """
        if self.polygon is None:
            return [Nearest(self.distance(point), _direction(self._disc()[0], point))]
        if polygons.contains(self.polygon, point):
            corners = self.polygon if polygons.signed_area(self.polygon) > 0.0 else self.polygon[::-1]
            return [_nearest_on_outline(corners, point, inside=True)]
        return [_nearest_on_outline(piece, point, inside=False) for piece in self.pieces]

    def segment_distance(self, start: Point, end: Point) -> float:
        """Smallest distance along the segment from `start` to `end` [units]; 0 or less if the segment touches."""
        if self.polygon is None:
            return self.distance(polygons.nearest_on_segment(self._disc()[0], start, end))
        if polygons.contains(self.polygon, start) or polygons.contains(self.polygon, end):
            return min(0.0, self.distance(start), self.distance(end))
        return min(polygons.segment_distance(start, end, a, b) for a, b in polygons.edges(self.polygon))

    def _disc(self) -> tuple[Point, float]:
        assert self.center is not None and self.radius is not None, "an obstacle is a disc or a polygon"
        return self.center, self.radius


def _nearest_on_outline(corners: tuple[Point, ...], point: Point, *, inside: bool) -> Nearest:
    """The nearest point of a polygon's boundary; `corners` run counterclockwise."""
    foot, a, b = min(
        ((polygons.nearest_on_segment(point, a, b), a, b) for a, b in polygons.edges(corners)),
        key=lambda found: math.dist(found[0], point),
    )
    gap = math.dist(point, foot)
    if gap > TOUCHING:
        return Nearest(-gap, _direction(point, foot)) if inside else Nearest(gap, _direction(foot, point))
    # On the boundary, the outward direction is the normal of the side.
    length = math.dist(a, b)
    return Nearest(0.0, ((b[1] - a[1]) / length, (a[0] - b[0]) / length))


def _direction(start: Point, end: Point) -> Point:
    """Unit vector from `start` to `end`; along the first axis if they coincide."""
    gap = math.dist(start, end)
    if gap == 0.0:
        return tuple(float(k == 0) for k in range(len(end)))
    return tuple((x - y) / gap for x, y in zip(end, start, strict=True))


def clearance(point: Point, obstacles: Iterable[Obstacle]) -> float:
    """Distance from `point` to the nearest obstacle [units]; negative inside one, infinite without obstacles."""
    return min((obstacle.distance(point) for obstacle in obstacles), default=math.inf)


def segment_clearance(start: Point, end: Point, obstacles: Iterable[Obstacle]) -> float:
    """Smallest distance to any obstacle along a segment [units]; 0 or less if it touches one."""
    return min((obstacle.segment_distance(start, end) for obstacle in obstacles), default=math.inf)
