"""Shortest ways round obstacles, in the plane and in space.

A roadmap has corners round every obstacle, far enough away for a body, and connects those that see each other. In the
plane only edges that touch no obstacle's outline at a slant can be part of a shortest way (Latombe: Robot Motion
Planning, 1991, ch. 4: reduced visibility graph); in space, where shortest ways bend on edges, points all round each
ball are an approximation. Shortest ways to a goal come from Dijkstra's algorithm over all corners at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from llm_flock.arrays import Pairwise, Point, Points, Vector
from llm_flock.obstacles import Obstacle, clearance, cross, segment_clearance, signed_area

if TYPE_CHECKING:
    import shapely  # imported where it is used: missions without obstacles start faster without it

ARC = 64
"""Sides of a quarter of a circle. Outlines of grown obstacles lie inside the exact ones, by less than 1e-4 radii. A gap
that is wide enough always counts as passable, and one that is slightly too narrow may."""


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


AROUND = 48
"""Corners round a ball in space."""

MARGIN = 0.02
"""Corners lie farther away from obstacles than bodies have to by this share of a body's radius."""

SLACK = 1e-9
"""Ways count as clear that come nearer to an obstacle than allowed by less than this [units]."""

HOP = 0.25
"""Extra length for each corner, as a share of a body's diameter: of two similar ways, prefer the straighter one."""

MEETING = 1e-6
"""Points nearer to each other than this count as one [units]."""


class Roadmap:
    """Ways between obstacles for bodies of one radius. Get it from `roadmap_of`: building it takes a while.

    Args:
        arena: two opposite corners of the flight space [units].
        obstacles: the obstacles in it, all of the same dimension.
        radius: smallest distance of a body's centre from obstacles [units].
        exact: in the plane, give lengths to within 0.4 % of the part that leads round obstacles, at the price of ways
            with many corners; for lower bounds.
    """

    def __init__(
        self, arena: tuple[Point, Point], obstacles: Sequence[Obstacle], radius: float, *, exact: bool = False
    ) -> None:
        self._obstacles, self._radius = tuple(obstacles), radius
        self._exact = exact
        self._reach = radius if exact else radius * (1.0 + MARGIN)
        self._hop = 0.0 if exact else 2.0 * HOP * radius
        discs = [o for o in self._obstacles if o.polygon is None]
        dim = len(arena[0])
        self._centers = np.array([o.center for o in discs]).reshape(len(discs), dim)
        self._radii = np.array([o.radius or 0.0 for o in discs])
        self._angular = [o for o in self._obstacles if o.polygon is not None]
        self._polygons: shapely.Geometry | None = None
        if self._angular:
            import shapely

            self._polygons = shapely.union_all([shapely.Polygon(o.polygon) for o in self._angular])
            shapely.prepare(self._polygons)
        # Distances of corners from their discs' centres, and the largest from a polygon.
        self._out: list[float] = []
        self._out_angular = 0.0
        corners, normals, bends = self._corners(dim, arena)
        low, high = np.array(arena)
        inside = ((corners >= low - SLACK) & (corners <= high + SLACK)).all(axis=1)
        free = inside & self._clear(corners, corners, radius)
        self._nodes, self._normals, self._bends = corners[free], normals[free], bends[free]
        self._links = self._connect()
        self._left = lru_cache(maxsize=1024)(self._left_to)

    def _corners(self, dim: int, arena: tuple[Point, Point]) -> tuple[Points, Points, Vector]:
        """Points round every obstacle, the directions away from it, and the sines of the angles that they cover."""
        rings: list[tuple[Points, Points, Vector]] = [(np.empty((0, dim)), np.empty((0, dim)), np.empty(0))]
        for obstacle in self._obstacles:
            if obstacle.polygon is not None:
                sector = self._sector(self._reach)
                for at in _turns(obstacle.polygon):
                    rings.append(_round_corner(at, self._reach, sector))
                    self._out_angular = max(self._out_angular, math.dist(rings[-1][0][0], at[0]))
                    rings.append(_at_walls(at, self._reach, sector, arena))
                continue
            assert obstacle.center is not None and obstacle.radius is not None, "an obstacle is a disc or a polygon"
            out = obstacle.radius + self._reach
            if dim == 2:
                whole = (obstacle.center, 0.0, 2.0 * math.pi)
                rings.append(_round_corner(whole, out, self._sector(out)))
                self._out.append(math.dist(rings[-1][0][0], obstacle.center))
                rings.append(_at_walls(whole, out, self._sector(out), arena))
            else:
                rings.append(_round_ball(obstacle.center, out))
                self._out.append(math.dist(rings[-1][0][0], obstacle.center))
        corners, normals, bends = zip(*rings, strict=True)
        return np.concatenate(corners), np.concatenate(normals), np.concatenate(bends)

    def _sector(self, out: float) -> float:
        """Largest angle that one corner covers at this distance [rad]: few corners, or exact lengths."""
        return math.pi / 18 if self._exact else 2.0 * math.acos(out / (out + 0.5 * self._radius))

    def _clear(self, starts: Points, ends: Points, radius: float) -> NDArray[np.bool_]:
        """Whether the segments, each from a row to a row, keep this distance from every obstacle."""
        clear = np.ones(len(starts), dtype=np.bool_)
        along = ends - starts
        squared = np.maximum((along * along).sum(axis=1), 1e-300)
        for center, size in zip(self._centers, self._radii, strict=True):
            share = np.clip(((center - starts) * along).sum(axis=1) / squared, 0.0, 1.0)
            nearest = starts + share[:, None] * along - center
            clear &= np.linalg.norm(nearest, axis=1) >= size + radius - SLACK
        if self._polygons is not None and len(starts):
            import shapely

            lines: Any = shapely.linestrings(np.stack([starts, ends], axis=1))
            near = cast("Any", shapely).dwithin(self._polygons, lines, max(radius - SLACK, 0.0))
            clear &= ~np.asarray(near, dtype=np.bool_)
        return clear

    def _touching(self, point: Vector) -> NDArray[np.bool_]:
        """Corners past which a straight way from a point can go on round theirs.

        All of them from a point nearer to an obstacle than the obstacle's corners are: its ways bend at once.
        """
        near = np.linalg.norm(self._centers - point, axis=1) < np.array(self._out) - MEETING
        if near.any() or clearance(tuple(point.tolist()), self._angular) < self._out_angular - MEETING:
            return np.ones(len(self._nodes), dtype=np.bool_)
        towards = self._nodes - point
        gaps = np.linalg.norm(towards, axis=1)
        slant = np.abs((towards * self._normals).sum(axis=1))
        return slant <= self._bends * gaps + SLACK

    def _connect(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Vector]:
        """Pairs of corners that see each other, and their distances."""
        count = len(self._nodes)
        touching = np.array([self._touching(node) for node in self._nodes], dtype=np.bool_).reshape(count, count)
        first, second = np.nonzero(np.triu(touching & touching.T, 1))
        clear = self._clear(self._nodes[first], self._nodes[second], self._radius)
        first, second = first[clear], second[clear]
        return first, second, np.linalg.norm(self._nodes[first] - self._nodes[second], axis=1)

    def _visible_corners(self, point: Point) -> tuple[NDArray[np.int64], Vector]:
        """Corners that a body at a point can fly to straight, and their distances.

        A body that is too near an obstacle sees all places that do not lead nearer to one.
        """
        here = np.array(point)
        candidates = np.flatnonzero(self._touching(here))
        ends = self._nodes[candidates]
        room = min(self._radius, clearance(point, self._obstacles))
        seen = candidates[self._clear(np.broadcast_to(here, ends.shape), ends, room)]
        return seen, np.linalg.norm(self._nodes[seen] - here, axis=1)

    def straight(self, here: Point, goal: Point) -> bool:
        """Whether a body can fly straight from one point to another."""
        room = min(self._radius, clearance(here, self._obstacles), clearance(goal, self._obstacles))
        return segment_clearance(here, goal, self._obstacles) >= room - SLACK

    def length(self, here: Point, goal: Point) -> float:
        """Length of the shortest way, with the extra for corners [units]; infinite if there is none."""
        if self.straight(here, goal):
            return math.dist(here, goal)
        return self._way(here, goal)[0]

    def lengths(self, here: Point, goals: Points) -> Vector:
        """As `length` to each goal, shape (m,), for goals of shape (m, d) that are clear of obstacles."""
        start = np.array(here)
        lengths = np.linalg.norm(goals - start, axis=1)
        room = min(self._radius, clearance(here, self._obstacles))
        for k in np.flatnonzero(~self._clear(np.broadcast_to(start, goals.shape), goals, room)):
            lengths[k] = self._way(here, tuple(goals[k].tolist()))[0]
        return lengths

    def lengths_to(self, starts: Points, goal: Point) -> Vector:
        """As `length` from each start, shape (m,), for starts of shape (m, d) that are clear of obstacles."""
        end = np.array(goal)
        lengths = np.linalg.norm(starts - end, axis=1)
        room = min(self._radius, clearance(goal, self._obstacles))
        for k in np.flatnonzero(~self._clear(starts, np.broadcast_to(end, starts.shape), room)):
            lengths[k] = self._way(tuple(starts[k].tolist()), goal)[0]
        return lengths

    def next_stop(self, here: Point, goal: Point) -> Point:
        """The next corner of the shortest way; `goal` itself if the way is straight, or if there is none."""
        if self.straight(here, goal):
            return goal
        corner = self._way(here, goal)[1]
        if corner is None:
            return goal
        # A corner that is as good as reached leads on: it lies farther from its obstacle than it has to by this much.
        return self.next_stop(corner, goal) if math.dist(here, corner) <= MARGIN * self._radius else corner

    def _way(self, here: Point, goal: Point) -> tuple[float, Point | None]:
        """Length of the shortest way through at least one corner, and its first corner."""
        left = self._left(goal)
        seen, gaps = self._visible_corners(here)
        if not len(seen):
            return math.inf, None
        lengths = gaps + left[seen]
        # A corner at which the body is already leads nowhere.
        lengths[gaps < SLACK] = math.inf
        best = int(lengths.argmin())
        if not math.isfinite(float(lengths[best])):
            return math.inf, None
        return float(lengths[best]), tuple(self._nodes[seen[best]].tolist())

    def _left_to(self, goal: Point) -> Vector:
        """Length of the shortest way from each corner to a goal, the extra for corners included, shape (corners,)."""
        count = len(self._nodes)
        seen, gaps = self._visible_corners(goal)
        first, second, lengths = self._links
        rows = np.concatenate([first, np.full(len(seen), count)])
        columns = np.concatenate([second, seen])
        weights = np.concatenate([lengths, np.maximum(gaps, SLACK)]) + self._hop
        linked = scipy.sparse.csr_array((weights, (rows, columns)), shape=(count + 1, count + 1))
        return np.asarray(scipy.sparse.csgraph.dijkstra(linked, directed=False, indices=[count]))[0, :count]


@lru_cache(maxsize=64)
def roadmap_of(
    arena: tuple[Point, Point], obstacles: tuple[Obstacle, ...], radius: float, *, exact: bool = False
) -> Roadmap:
    """The roadmap between these obstacles; built once for all robots of a process."""
    return Roadmap(arena, obstacles, radius, exact=exact)


def shortest_ways(
    arena: tuple[Point, Point], obstacles: tuple[Obstacle, ...], radius: float, starts: Points, goals: Points
) -> Pairwise:
    """Lengths of the shortest ways for one body alone from each start to each goal, shape (n, m) [units].

    Straight ones where there is no way, and in space; never longer than the true ones by more than a
    few thousandths.
    """
    apart = np.linalg.norm(starts[:, None] - goals[None], axis=2)
    if len(arena[0]) != 2:
        return apart
    roadmap = roadmap_of(arena, obstacles, radius, exact=True)
    lengths = np.array([roadmap.lengths(tuple(start), goals) for start in starts.tolist()])
    return np.where(np.isfinite(lengths), lengths, apart)


def _turns(outline: Sequence[Point]) -> Iterable[tuple[Point, float, float]]:
    """The convex corners of a polygon: position, first direction away from it, and angle to go round [rad]."""
    corners = outline if signed_area(outline) > 0.0 else outline[::-1]
    for k, corner in enumerate(corners):
        before, after = corners[k - 1], corners[(k + 1) % len(corners)]
        turn = cross(before, corner, after)
        if turn <= 0.0:
            continue
        incoming = math.atan2(corner[1] - before[1], corner[0] - before[0])
        outgoing = math.atan2(after[1] - corner[1], after[0] - corner[0])
        yield corner, incoming - math.pi / 2.0, (outgoing - incoming) % (2.0 * math.pi)


def _round_corner(at: tuple[Point, float, float], reach: float, sector: float) -> tuple[Points, Points, Vector]:
    """Points round a turn at least `reach` away [units], their directions, and the sines of half their sectors."""
    corner, start, turn = at
    count = math.ceil(turn / sector - 1e-9)
    half = turn / count / 2.0
    angles = start + half * (2.0 * np.arange(count) + 1.0)
    away = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.array(corner) + reach / math.cos(half) * away, away, np.full(count, math.sin(half))


def _at_walls(
    at: tuple[Point, float, float], reach: float, sector: float, arena: tuple[Point, Point]
) -> tuple[Points, Points, Vector]:
    """Points at which the circle through those points meets walls: bodies cannot use points beyond a wall."""
    corner, start, turn = at
    half = turn / math.ceil(turn / sector - 1e-9) / 2.0
    far = reach / math.cos(half)
    at_walls: list[tuple[float, float]] = []
    for axis, wall in ((axis, bound[axis]) for axis in (0, 1) for bound in arena):
        gap = wall - corner[axis]
        if abs(gap) < far:
            side = math.sqrt(far * far - gap * gap)
            met = [(gap, s) if axis == 0 else (s, gap) for s in (side, -side)]
            at_walls += [(x, y) for x, y in met if (math.atan2(y, x) - start) % (2.0 * math.pi) <= turn]
    offsets = np.array(at_walls, dtype=np.float64).reshape(len(at_walls), 2)
    return np.array(corner) + offsets, offsets / far, np.full(len(at_walls), math.sin(half))


def _round_ball(center: Point, out: float) -> tuple[Points, Points, Vector]:
    """The same round a ball."""
    away = on_sphere(AROUND)
    half = 2.0 * math.acos(1.0 - 2.0 / AROUND)
    return np.array(center) + out / math.cos(half) * away, away, np.full(AROUND, math.sin(half))


def on_sphere(count: int) -> Points:
    """Points evenly spread on the unit sphere, on a Fibonacci lattice, shape (count, 3)."""
    k = np.arange(count) + 0.5
    height, turn = 1.0 - 2.0 * k / count, math.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - height * height)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
