"""Exact projection of a move onto an intersection of half-spaces and a ball, in any dimension."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
import scipy

from llm_flock.arrays import Point, Points, Vector
from llm_flock.mission import Mission
from llm_flock.obstacles import Mover

TOLERANCE = 1e-9  # a constraint counts as satisfied to within this [units]


class HalfSpace(msgspec.Struct, frozen=True):
    """Displacements u with normal . u <= room [units]; `normal` is a unit vector that points out of the cell.

    With negative room the robot has to move back. `violated` says that the limit is broken by more than noise explains.
    """

    normal: Point
    room: float
    violated: bool = False


def line_of_sight(position: Point, other: Point, gap: float, downwash: float) -> tuple[Point, float]:
    """The normal of the side towards a robot at the distance `gap`, by the norm of `arrays.flattened` [units].

    Also the share of a move along the normal by which that distance changes: its room, divided by the share, is that
    of the side. A side of the flattened space, moved back: its normal is flattened once more.
    """
    normal = tuple((b - a) / gap for a, b in zip(position, other, strict=True))
    if downwash == 1.0:
        return normal, 1.0
    normal = (*normal[:2], normal[2] / downwash**2)
    share = math.hypot(*normal)
    return tuple(x / share for x in normal), share


def nearest_move(wish: Point, sides: Sequence[HalfSpace], longest: float) -> Point | None:
    """The displacement nearest to `wish` that keeps to all sides and is no longer than `longest`; None without one."""
    move = clip(wish, longest)
    if all(_dot(side.normal, move) <= side.room for side in sides):
        return move
    return _project_plane(wish, sides, longest) if len(wish) == 2 else _project_any(wish, sides, longest)


def relaxed_move(wish: Point, sides: Sequence[HalfSpace], longest: float) -> Point:
    """As `nearest_move`, with the rooms of violated sides multiplied by the largest share in 0 .. 1 that allows a move.

    So no violated limit gets worse, and no other one is broken. If even that is impossible, the robot stands still.
    """
    best = nearest_move(wish, sides, longest)
    if best is None and any(side.violated for side in sides):
        low, high = 0.0, 1.0
        best = nearest_move(wish, [_ease(side, low) for side in sides], longest)
        for _ in range(24 if best is not None else 0):  # bisections
            share = (low + high) / 2
            tried = nearest_move(wish, [_ease(side, share) for side in sides], longest)
            if tried is None:
                high = share
            else:
                low, best = share, tried
    return (0.0,) * len(wish) if best is None else best


def _ease(side: HalfSpace, share: float) -> HalfSpace:
    return HalfSpace(side.normal, share * min(side.room, 0.0)) if side.violated else side


def _dot(a: Point, b: Point) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def clip(vector: Point, longest: float) -> Point:
    """The vector, shortened to `longest` if it is longer."""
    length = math.hypot(*vector)
    if length <= longest:
        return vector
    return tuple(x * longest / length for x in vector)


def _project_plane(wish: Point, sides: Sequence[HalfSpace], radius: float) -> Point | None:
    """Exact projection onto the intersection of half-planes and a disc, by enumeration of active sets."""
    wx, wy = wish
    candidates = [clip(wish, radius)]
    for i, side in enumerate(sides):
        nx, ny = side.normal
        over = nx * wx + ny * wy - side.room
        candidates.append((wx - over * nx, wy - over * ny))
        # A side that misses the circle yields points outside of it, which fail the check below.
        chord = math.sqrt(max(0.0, radius * radius - side.room * side.room))
        candidates.append((side.room * nx - chord * ny, side.room * ny + chord * nx))
        candidates.append((side.room * nx + chord * ny, side.room * ny - chord * nx))
        for other in sides[:i]:
            mx, my = other.normal
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

    Without the ball, this is least distance programming (Lawson, Hanson: Solving Least Squares Problems, 1974, ch. 23).
    The ball's multiplier only scales the wish towards the origin, and a smaller wish gives a shorter move: bisection
    finds the longest move that the ball allows. There must be at least one side.
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
        for _ in range(60):  # bisections
            middle = (low + high) / 2
            tried = _nearest(middle * target, normals, rooms)
            if tried is not None and float(np.linalg.norm(tried)) <= radius:
                low, move = middle, tried
            else:
                high = middle
    return None if move is None else tuple(float(x) for x in move)


def _nearest(target: Vector, normals: Points, rooms: Vector) -> Vector | None:
    """The point u with `normals @ u <= rooms` nearest to `target`; None if no such point exists."""
    excess = normals @ target - rooms
    if float(excess.max()) <= 0.0:
        return target
    system = np.vstack([-normals.T, excess])
    ones = np.zeros(len(target) + 1)
    ones[-1] = 1.0
    weights, residual = scipy.optimize.nnls(system, ones)
    if residual < 1e-12:
        return None
    left = system @ weights - ones
    return target - left[:-1] / left[-1]


def static_half_spaces(
    position: Point, mission: Mission, *, max_step: float, noise_bound: float = 0.0
) -> list[HalfSpace]:
    """The walls and obstacles within one step, as sides of the robot's cell. From outside, they lead back.

    With the position known to within `noise_bound` e [units], a wall moves inwards by e. The direction to the nearest
    point of an obstacle at distance d turns by at most 2 e / d, so its side moves by e and by 2 e max_step / d.
    """
    sides: list[HalfSpace] = []
    low, high = mission.arena
    for axis, x in enumerate(position):
        for sign, room in ((-1.0, x - low[axis]), (1.0, high[axis] - x)):
            if room - noise_bound < max_step:
                normal = tuple(sign if k == axis else 0.0 for k in range(len(position)))
                sides.append(HalfSpace(normal, max(-max_step, room - noise_bound), room < -noise_bound))
    buffer = mission.body_radius
    for obstacle in mission.obstacles:
        for nearest in obstacle.nearest(position):
            margin = noise_bound * (1.0 + 2.0 * max_step / max(nearest.distance, buffer))
            room = nearest.distance - buffer - margin
            if room < max_step:
                normal = tuple(-x for x in nearest.outward)
                violated = nearest.distance - buffer < -noise_bound
                sides.append(HalfSpace(normal, max(-max_step, room), violated))
    return sides


def moving_half_spaces(
    position: Point, movers: Iterable[Mover], mission: Mission, *, max_step: float, horizon: float, noise_bound: float
) -> list[HalfSpace]:
    """The places that moving obstacles can reach within a `horizon` [rounds], as sides of the robot's cell.

    The robot keeps clear of them alone: an obstacle makes no room. Where one can reach the robot, its side leads back,
    as far as other sides allow. Own position and that of the obstacle are off by `noise_bound` each [units].
    """
    sides: list[HalfSpace] = []
    for mover in movers:
        gap = math.dist(position, mover.position)
        if gap < TOLERANCE:
            continue  # no direction leads away from it
        room = gap - mover.radius - mission.body_radius - mover.speed * horizon - 2.0 * noise_bound
        if room < max_step:
            normal = tuple((b - a) / gap for a, b in zip(position, mover.position, strict=True))
            sides.append(HalfSpace(normal, max(-max_step, room), room < 0.0))
    return sides
