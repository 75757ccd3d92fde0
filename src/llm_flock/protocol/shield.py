"""Buffered Voronoi shield: the nearest safe waypoint to the one that was asked for.

Zhou, Wang, Bandyopadhyay, Schwager: Fast, on-line collision avoidance for dynamic vehicles using buffered Voronoi
cells (IEEE RA-L 2017). Each robot stays on its own side of the bisector to every neighbour, shrunk by half the safe
distance. If all do so from one snapshot and move along straight segments in step, no pair is ever nearer than the
safe distance, on the way either: along the line of sight each gives up at most half of the room between them, so the
distance along it never falls below `safe_distance`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from llm_flock.arrays import Point, Points, Vector

TOLERANCE = 1e-9
"""A constraint counts as kept within this much [units]."""

BISECTIONS = 60

STEP_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Lengths of step that are tried where positions are uncertain, as shares of `max_step`."""


@dataclass(frozen=True, slots=True)
class HalfSpace:
    """Displacements u with normal . u <= room; `normal` is a unit vector."""

    normal: Point
    room: float


def separation_half_spaces(
    position: Point,
    neighbors: Iterable[Point],
    *,
    safe_distance: float,
    max_step: float,
    noise_bound: float = 0.0,
) -> list[HalfSpace]:
    """The sides of the buffered Voronoi cell that can matter within one step, as limits on the displacement.

    With positions known to within `noise_bound` e [units], each side moves inwards by e for the distance and by
    4 e max_step / d for the direction: two estimated positions turn the line of sight by at most 4 e / d, and a
    step of that length along a line so turned is off by that much.
    """
    sides: list[HalfSpace] = []
    for other in neighbors:
        gap = math.dist(position, other)
        if gap < TOLERANCE:
            continue  # coincident bodies have no line of sight; the others' sides still hold
        margin = noise_bound * (1.0 + 4.0 * max_step / gap)
        room = (gap - safe_distance) / 2.0 - margin
        if room < max_step:
            sides.append(HalfSpace(tuple((b - a) / gap for a, b in zip(position, other, strict=True)), room))
    return sides


def project(
    position: Point,
    waypoint: Point,
    neighbors: Iterable[Point],
    *,
    safe_distance: float,
    max_step: float,
    noise_bound: float = 0.0,
) -> Point:
    """The point of the robot's buffered Voronoi cell, within `max_step`, that is nearest to `waypoint`.

    Args:
        position: where the robot believes it is, d coordinates [units].
        waypoint: where it wants to be.
        neighbors: believed positions of all robots within sensing range.
        safe_distance: smallest distance allowed between two robots [units].
        max_step: longest move allowed [units].
        noise_bound: largest error of each believed position [units].

    Returns:
        The waypoint to fly to; `position` itself where the cell is empty (then standing still is safest).
    """
    if noise_bound == 0.0:
        return _project_within(position, waypoint, neighbors, safe_distance, max_step, 0.0)
    # The margin for the direction grows with the step: a shorter step may lead farther through a narrow gap.
    others = tuple(neighbors)
    tries = [
        _project_within(position, waypoint, others, safe_distance, max_step * share, noise_bound)
        for share in STEP_SHARES
    ]
    return min(tries, key=lambda target: math.dist(target, waypoint))


def _project_within(
    position: Point,
    waypoint: Point,
    neighbors: Iterable[Point],
    safe_distance: float,
    max_step: float,
    noise_bound: float,
) -> Point:
    """The projection for one length of step; the position itself where the cell is empty."""
    sides = separation_half_spaces(
        position, neighbors, safe_distance=safe_distance, max_step=max_step, noise_bound=noise_bound
    )
    wish = tuple(w - p for w, p in zip(waypoint, position, strict=True))
    move = _clip(wish, max_step)
    if all(_dot(side.normal, move) <= side.room for side in sides):
        # The waypoint comes back as it was given, not as position + (waypoint - position).
        return waypoint if move is wish else _plus(position, move)
    best = _project_plane(wish, sides, max_step) if len(position) == 2 else _project_any(wish, sides, max_step)
    return position if best is None else _plus(position, best)


def _dot(a: Point, b: Point) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _plus(a: Point, b: Point) -> Point:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _clip(vector: Point, longest: float) -> Point:
    """The same direction, no longer than `longest`."""
    length = math.hypot(*vector)
    if length <= longest:
        return vector
    return tuple(x * longest / length for x in vector)


def _project_plane(wish: Point, sides: Sequence[HalfSpace], radius: float) -> Point | None:
    """Exact projection on the intersection of half-planes and a disc, by looking at every possible active set.

    The nearest point is the wish clipped to the disc, the foot of the wish on one side, the corner of two sides, or
    the meeting of a side with the circle.
    """
    candidates: list[tuple[float, float]] = []
    clipped = _clip(wish, radius)
    candidates.append((clipped[0], clipped[1]))
    wx, wy = wish[0], wish[1]
    for i, side in enumerate(sides):
        nx, ny = side.normal[0], side.normal[1]
        over = nx * wx + ny * wy - side.room
        candidates.append((wx - over * nx, wy - over * ny))
        half = radius * radius - side.room * side.room
        if half >= 0.0:
            chord = math.sqrt(half)
            candidates.append((side.room * nx - chord * ny, side.room * ny + chord * nx))
            candidates.append((side.room * nx + chord * ny, side.room * ny - chord * nx))
        for other in sides[:i]:
            mx, my = other.normal[0], other.normal[1]
            det = nx * my - ny * mx
            if abs(det) > 1e-12:
                candidates.append(((side.room * my - other.room * ny) / det, (other.room * nx - side.room * mx) / det))
    candidates.sort(key=lambda u: (u[0] - wx) ** 2 + (u[1] - wy) ** 2)
    limit = radius + TOLERANCE
    for ux, uy in candidates:
        if ux * ux + uy * uy <= limit * limit and all(
            s.normal[0] * ux + s.normal[1] * uy <= s.room + TOLERANCE for s in sides
        ):
            return (ux, uy)
    return None


def _project_any(wish: Point, sides: Sequence[HalfSpace], radius: float) -> Point | None:
    """Exact projection in any dimension.

    Without the ball this is least distance programming (Lawson, Hanson: Solving Least Squares Problems, 1974, ch. 23).
    The ball's multiplier only pulls the wish towards the origin, and the farther it is pulled the shorter the move:
    bisection finds the longest move that the ball allows.
    """
    normals = np.array([side.normal for side in sides])
    rooms = np.array([side.room for side in sides])
    target = np.array(wish)
    move = _nearest(target, normals, rooms)
    if move is not None and float(np.linalg.norm(move)) > radius:
        move = _nearest(np.zeros_like(target), normals, rooms)
        if move is None or float(np.linalg.norm(move)) > radius:
            return None
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            tried = _nearest(middle * target, normals, rooms)
            if tried is not None and float(np.linalg.norm(tried)) <= radius:
                low, move = middle, tried
            else:
                high = middle
    return None if move is None else tuple(float(x) for x in move)


def _nearest(target: Vector, normals: Points, rooms: Vector) -> Vector | None:
    """The point with `normals @ u <= rooms` nearest to `target`; None if there is none."""
    excess = normals @ target - rooms
    if float(excess.max()) <= 0.0:
        return target
    system = np.vstack([-normals.T, excess])
    ones = np.zeros(len(target) + 1)
    ones[-1] = 1.0
    weights, residual = nnls(system, ones)
    if residual < 1e-12:
        return None
    left = system @ weights - ones
    return target - left[:-1] / left[-1]
