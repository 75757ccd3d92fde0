"""One obstacle: what a mission says about it, and what a robot near it needs to know."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.obstacles import polygons

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]

TOUCHING = 1e-9
"""Nearer than this a point is on the boundary [units]."""


@dataclass(frozen=True, slots=True)
class Nearest:
    """The nearest part of something convex.

    Attributes:
        distance: how far away its surface is [units]; negative inside.
        outward: unit vector along which the distance grows.
    """

    distance: float
    outward: Point


class Obstacle(BaseModel):
    """Something that stands in the flight space: `center` and `radius`, or the corners of a `polygon`.

    A disc in three dimensions is a ball; polygons are for the plane. Lengths in mission units, world frame.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    center: tuple[Finite, ...] | None = Field(default=None, description="Centre of a disc [units]")
    radius: Positive | None = Field(default=None, description="Radius of a disc [units]")
    polygon: tuple[tuple[Finite, Finite], ...] | None = Field(
        default=None, description="Corners of a polygon in their order, convex or not [units]"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        given: dict[str, Any] = self.model_dump(exclude_none=True)
        if set(given) not in ({"center", "radius"}, {"polygon"}):
            raise InputError("obstacles", given, "either center and radius, or polygon, for each obstacle")
        if self.polygon is not None and (len(self.polygon) < 3 or not polygons.is_simple(self.polygon)):
            allowed = "polygons of 3 or more corners, with an area, that do not cross themselves"
            raise InputError("obstacles", given, allowed)
        return self

    @property
    def dim(self) -> int:
        """Dimension d of the space that it stands in."""
        return 2 if self.center is None else len(self.center)

    @cached_property
    def pieces(self) -> tuple[tuple[Point, ...], ...]:
        """A polygon as convex pieces; none for a disc."""
        return () if self.polygon is None else polygons.convex_pieces(self.polygon)

    def distance(self, point: Point) -> float:
        """How far `point` is from its surface [units]; negative inside."""
        if self.polygon is None:
            return self._from_disc(point).distance
        gap = math.dist(point, polygons.nearest_on_boundary(self.polygon, point))
        return -gap if polygons.contains(self.polygon, point) else gap

    def nearest(self, point: Point) -> list[Nearest]:
        """The nearest point of each convex piece; from inside, only the way out.

        Whoever stays on his own side of the plane through each of these points, square to `outward`, cannot touch
        the obstacle: a convex set lies wholly beyond the plane through its nearest point.
        """
        if self.polygon is None:
            return [self._from_disc(point)]
        if polygons.contains(self.polygon, point):
            corners = self.polygon if polygons.signed_area(self.polygon) > 0.0 else self.polygon[::-1]
            return [_from_sides(corners, point, inside=True)]
        return [_from_sides(piece, point, inside=False) for piece in self.pieces]

    def segment_distance(self, start: Point, end: Point) -> float:
        """Smallest distance along the straight way from `start` to `end` [units]; 0 or less where it touches."""
        if self.polygon is None:
            center, radius = self._disc()
            return math.dist(center, polygons.nearest_on_segment(center, start, end)) - radius
        if polygons.contains(self.polygon, start) or polygons.contains(self.polygon, end):
            return min(0.0, self.distance(start), self.distance(end))
        return min(polygons.segment_distance(start, end, a, b) for a, b in polygons.edges(self.polygon))

    def _disc(self) -> tuple[Point, float]:
        assert self.center is not None and self.radius is not None, "an obstacle is a disc or a polygon"
        return self.center, self.radius

    def _from_disc(self, point: Point) -> Nearest:
        center, radius = self._disc()
        return _apart(point, center, math.dist(point, center) - radius)


def _from_sides(corners: tuple[Point, ...], point: Point, *, inside: bool) -> Nearest:
    """The nearest point of a polygon's boundary; `corners` run counterclockwise."""
    there, a, b = min(
        ((polygons.nearest_on_segment(point, a, b), a, b) for a, b in polygons.edges(corners)),
        key=lambda found: math.dist(found[0], point),
    )
    gap = math.dist(point, there)
    if gap > TOUCHING:
        return _apart(there, point, -gap) if inside else _apart(point, there, gap)
    # On the boundary the side itself says where outside is.
    length = math.dist(a, b)
    return Nearest(0.0, ((b[1] - a[1]) / length, (a[0] - b[0]) / length))


def _apart(to: Point, away_from: Point, distance: float) -> Nearest:
    """The direction from one point to another; along the first axis where they are the same."""
    gap = math.dist(to, away_from)
    if gap == 0.0:
        return Nearest(distance, tuple(float(k == 0) for k in range(len(to))))
    return Nearest(distance, tuple((x - y) / gap for x, y in zip(to, away_from, strict=True)))


def clearance(point: Point, obstacles: Iterable[Obstacle]) -> float:
    """Distance from `point` to the nearest obstacle [units]; negative inside one, infinite where there is none."""
    return min((obstacle.distance(point) for obstacle in obstacles), default=math.inf)


def segment_clearance(start: Point, end: Point, obstacles: Iterable[Obstacle]) -> float:
    """Smallest distance to any obstacle along a straight way [units]; 0 or less where it touches one."""
    return min((obstacle.segment_distance(start, end) for obstacle in obstacles), default=math.inf)
