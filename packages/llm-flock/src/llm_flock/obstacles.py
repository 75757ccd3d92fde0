"""One obstacle: its description in a mission, and distances and directions to it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from llm_flock.arrays import MAX_COORDINATE, Point, between
from llm_flock.bounds import MAX_POLYGON_CORNERS
from llm_flock.errors import InputError


def cross(a: Point, b: Point, c: Point) -> float:
    """Twice the signed area of the triangle a, b, c: positive for a left turn [units^2]."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def edges(polygon: Sequence[Point]) -> Iterator[tuple[Point, Point]]:
    """The sides of a polygon, including the closing one."""
    return ((a, polygon[(k + 1) % len(polygon)]) for k, a in enumerate(polygon))


def signed_area(polygon: Sequence[Point]) -> float:
    """Area of a polygon [units^2], positive if its corners run counterclockwise."""
    origin = polygon[0]
    return sum(cross(origin, a, b) for a, b in edges(polygon)) / 2.0


def contains(polygon: Sequence[Point], point: Point) -> bool:
    """Whether the point is inside by the even-odd rule; a point on the boundary may count as either."""
    inside = False
    x, y = point[0], point[1]
    for a, b in edges(polygon):
        if (a[1] > y) != (b[1] > y) and x < (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]) + a[0]:
            inside = not inside
    return inside


def nearest_on_segment(point: Point, a: Point, b: Point) -> Point:
    """The point of the segment a .. b nearest to `point`, in any dimension."""
    along = tuple(y - x for x, y in zip(a, b, strict=True))
    squared = sum(x * x for x in along)
    if squared == 0.0:
        return a
    share = sum((p - x) * d for p, x, d in zip(point, a, along, strict=True)) / squared
    share = min(1.0, max(0.0, share))
    return tuple(x + share * d for x, d in zip(a, along, strict=True))


def is_simple(polygon: Sequence[Point]) -> bool:
    """Whether the polygon has an area and no two sides meet, except neighbouring sides at their common corner."""
    import shapely  # here: missions without polygons start faster without it

    size = max(math.dist(polygon[0], p) for p in polygon)
    if len(set(polygon)) < len(polygon) or abs(signed_area(polygon)) <= 1e-12 * size * size:
        return False
    return shapely.Polygon(polygon).is_valid


def convex_pieces(polygon: Sequence[Point]) -> tuple[tuple[Point, ...], ...]:
    """Divide a simple polygon into convex polygons, corners counterclockwise. A convex polygon is one piece.

    Ear clipping (Meisters 1975), then removal of diagonals that convexity does not need (Hertel, Mehlhorn 1983). The
    number of pieces is at most four times the minimum.
    """
    corners = list(polygon) if signed_area(polygon) > 0.0 else list(polygon)[::-1]
    triangles: list[tuple[Point, ...]] = []
    while len(corners) > 3:
        # The sharpest ear. If rounding hides the ears of a needle-thin remainder, its sharpest left turn.
        k = max(range(len(corners)), key=lambda k: (_is_ear(corners, k), cross(*_around(corners, k))))
        triangles.append(_around(corners, k))
        del corners[k]
    triangles.append(tuple(corners))
    return _merge([t for t in triangles if cross(t[0], t[1], t[2]) > 0.0])


def _around(corners: Sequence[Point], k: int) -> tuple[Point, Point, Point]:
    return corners[k - 1], corners[k], corners[(k + 1) % len(corners)]


def _is_ear(corners: Sequence[Point], k: int) -> bool:
    """Whether corner k is convex and its triangle holds no other corner, so that it can be cut off."""
    a, b, c = _around(corners, k)
    if cross(a, b, c) < 0.0:
        return False
    others = (p for p in corners if p not in (a, b, c))
    return not any(cross(a, b, p) >= 0.0 and cross(b, c, p) >= 0.0 and cross(c, a, p) >= 0.0 for p in others)


def _merge(pieces: list[tuple[Point, ...]]) -> tuple[tuple[Point, ...], ...]:
    """Join pieces along common sides as long as the results are convex."""
    while True:
        pairs = ((i, j) for i in range(len(pieces)) for j in range(i))
        pair = next(((i, j, whole) for i, j in pairs if (whole := _join(pieces[i], pieces[j])) is not None), None)
        if pair is None:
            return tuple(pieces)
        i, j, whole = pair
        pieces[j] = whole
        del pieces[i]


def _join(one: tuple[Point, ...], two: tuple[Point, ...]) -> tuple[Point, ...] | None:
    """The union of two pieces with a common side if it is convex, None otherwise."""
    for k, (a, b) in enumerate(edges(one)):
        if b in two and two[(two.index(b) + 1) % len(two)] == a:
            at = two.index(a)
            rest = tuple(two[(at + step) % len(two)] for step in range(1, len(two) - 1))
            whole = one[: k + 1] + rest + one[k + 1 :]
            corners = range(len(whole))
            return whole if all(cross(*_around(whole, m)) >= 0.0 for m in corners) else None
    return None


Finite = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=MAX_COORDINATE, allow_inf_nan=False)]


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
            found = f"a polygon of {len(self.polygon)} corners"
            raise InputError("obstacles", found, f"at most {MAX_POLYGON_CORNERS} corners")
        if self.polygon is not None and (len(self.polygon) < 3 or not is_simple(self.polygon)):
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
        return () if self.polygon is None else convex_pieces(self.polygon)

    def distance(self, point: Point) -> float:
        """Distance of `point` from the obstacle's surface [units]; negative inside."""
        if self.polygon is None:
            center, radius = self._disc()
            return math.dist(point, center) - radius
        gap = min(math.dist(point, nearest_on_segment(point, a, b)) for a, b in edges(self.polygon))
        return -gap if contains(self.polygon, point) else gap

    def nearest(self, point: Point) -> list[Nearest]:
        """The nearest point of each convex piece; for a point inside, the nearest point of the outline only.

        A robot that stays on its own side of the plane through each of these points, normal to `outward`, cannot
        touch the obstacle: a convex set lies entirely beyond the plane through its nearest point.
        """
        if self.polygon is None:
            return [Nearest(self.distance(point), _direction(self._disc()[0], point))]
        if contains(self.polygon, point):
            corners = self.polygon if signed_area(self.polygon) > 0.0 else self.polygon[::-1]
            return [_nearest_on_outline(corners, point, inside=True)]
        return [_nearest_on_outline(piece, point, inside=False) for piece in self.pieces]

    def segment_distance(self, start: Point, end: Point) -> float:
        """Smallest distance along the segment from `start` to `end` [units]; 0 or less if the segment touches."""
        if self.polygon is None:
            return self.distance(nearest_on_segment(self._disc()[0], start, end))
        if contains(self.polygon, start) or contains(self.polygon, end):
            return min(0.0, self.distance(start), self.distance(end))
        import shapely

        return shapely.Polygon(self.polygon).distance(shapely.LineString((start, end)))

    def _disc(self) -> tuple[Point, float]:
        assert self.center is not None and self.radius is not None, "an obstacle is a disc or a polygon"
        return self.center, self.radius


class MovingObstacle(BaseModel):
    """A disc, in space a ball, that flies along a path. Robots know where they see it, its radius and largest speed.

    Where it flies next, they do not know. Lengths are in mission units, positions in the world frame.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    center: tuple[Finite, ...] = Field(description="Centre at the start [units]")
    radius: Positive = Field(description="Radius [units]")
    speed: Positive = Field(description="Speed, which it never exceeds [units per round]")
    path: tuple[tuple[Finite, ...], ...] = Field(
        min_length=1, max_length=MAX_POLYGON_CORNERS, description="Points that it flies to, one after the other [units]"
    )
    since: int = Field(default=0, ge=0, description="Round after which it sets out")

    @cached_property
    def end(self) -> float:
        """The time at which it is at the last point of its path, and stays there [rounds]."""
        return self.since + sum(math.dist(a, b) for a, b in pairwise((self.center, *self.path))) / self.speed

    def at(self, time: float) -> Point:
        """The centre at a time, which is 0 when the first round begins [rounds]. Within a round it flies straight."""
        whole = math.floor(time)
        return between(self._after(whole), self._after(whole + 1), time - whole)

    def _after(self, round_: int) -> Point:
        """The centre at the end of a round."""
        left, here = max(0, round_ - self.since) * self.speed, self.center
        for stop in self.path:
            far = math.dist(here, stop)
            if left < far:
                return between(here, stop, left / far)
            left, here = left - far, stop
        return here


@dataclass(frozen=True, slots=True, kw_only=True)
class Mover:
    """A moving obstacle as a robot senses it [units, units per round]; a `number` tells it from others."""

    number: int
    position: Point
    radius: float
    speed: float


def _nearest_on_outline(corners: tuple[Point, ...], point: Point, *, inside: bool) -> Nearest:
    """The nearest point of a polygon's boundary; `corners` run counterclockwise."""
    foot, a, b = min(
        ((nearest_on_segment(point, a, b), a, b) for a, b in edges(corners)),
        key=lambda side: math.dist(side[0], point),
    )
    gap = math.dist(point, foot)
    if gap > 1e-9:  # nearer counts as on the boundary
        return Nearest(-gap, _direction(point, foot)) if inside else Nearest(gap, _direction(foot, point))
    # There the outward direction is the normal of the side.
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
