"""The best correspondence and rotation between two sets of points: the optimum in the plane, a good one in space.

With centred positions x_i and targets y_j as complex numbers, a correspondence pi has z_pi = sum_i conj(x_i) y_pi(i).
Its best rotation is the argument of z_pi, and its sum of squares is sum |x_i|^2 + sum |y_i|^2 - 2 |z_pi|. So the
problem is to find the longest z_pi. All z_pi lie in a convex polygon, and one linear assignment problem yields the
corner that is farthest in a given direction. Between two such directions, the polygon lies within the triangle of the
two corners and the intersection of their support lines. So a branch and bound on intervals of directions ends after
finitely many corners (`longest`). Each corner costs O(n^3). `quick_error` and `proven_match` are faster: they use
nearest target points, but may find no answer.

In space (`best_in_space`), alternating between the best correspondence for a rotation and the best rotation for a
correspondence never gets worse, but may end in a local optimum. So it starts from rotations spread over all
orientations, and from rotations of pairs of robots onto two anchor points of the target with similar distances from
the centre and from each other. If the team is near its shape, one of the latter is nearly right.
"""

from __future__ import annotations

import cmath
import heapq
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from llm_flock.arrays import Points

Complex: TypeAlias = NDArray[np.complex128]

ROUNDING = 4 * float(np.finfo(np.float64).eps)
"""Gains below this share, times the number of robots, count as rounding."""

PIECES = 5  # initial intervals of directions in the full circle: below 90 degrees each, so that support lines intersect
INTERVALS, MAX_INTERVALS = 64, 8192  # initial intervals of directions, and the number after which the search gives up

MAX_PARTNERS = 16  # target points onto which the outermost point is turned
MAX_ANCHORED = 24  # pairs of robots that are turned onto the two anchor points
MAX_REFINED = 6  # starting rotations that are refined


@dataclass(frozen=True, slots=True, kw_only=True)
class Correspondence:
    """A correspondence: robot i has target `columns[i]`, and `z` is its sum z_pi."""

    z: complex
    columns: NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Corner:
    """A corner `z` of the polygon, the direction `angle` in which it is farthest, and its extent `support` in it."""

    angle: float
    support: float
    z: complex


def longest(x: Complex, y: Complex, symmetry: int = 1) -> Correspondence:
    """The correspondence pi whose z_pi = sum_i conj(x_i) y_pi(i) is longest.

    Args:
        x: centred positions, shape (n,) [units].
        y: centred targets, shape (n,) [units].
        symmetry: a rotation by 360/symmetry degrees maps the set of all z_pi to itself.
    """
    products = np.conj(x)[:, None] * y
    # Squared distances have the same best correspondence as products, and show a solver early which targets are near.
    squares = np.abs(x)[:, None] ** 2 + np.abs(y) ** 2
    real, imag = np.ascontiguousarray(products.real), np.ascontiguousarray(products.imag)
    index = np.arange(len(products))
    gap = ROUNDING * len(products)
    tiny = gap * float(np.abs(products).sum(axis=1).max()) + sys.float_info.min
    best = Correspondence(z=0j, columns=index)

    def corner(angle: float) -> _Corner:
        nonlocal best
        direction = cmath.rect(1.0, angle)
        _, columns = scipy.optimize.linear_sum_assignment(squares - 2 * (direction.real * real + direction.imag * imag))
        z = complex(products[index, columns].sum())
        if abs(z) > abs(best.z):
            best = Correspondence(z=z, columns=columns)
        return _Corner(angle=angle, support=(z * direction.conjugate()).real, z=z)

    # Climb to a good corner first, so that the bound prunes more.
    first = corner(0.0)
    while (climbed := corner(cmath.phase(first.z))).support > abs(first.z) * (1 + gap):
        first = climbed

    sector = 2 * math.pi / symmetry
    pieces = math.ceil(PIECES / symmetry)
    corners = [climbed, *(corner(climbed.angle + sector * k / pieces) for k in range(1, pieces))]
    turned = climbed.z * cmath.rect(1.0, sector)
    corners.append(_Corner(angle=climbed.angle + sector, support=climbed.support, z=turned))

    branches = [_branch(a, b) for a, b in pairwise(corners)]
    heapq.heapify(branches)
    while branches and -branches[0][0] > abs(best.z) * (1 + gap) + tiny:
        _, _, one, two = heapq.heappop(branches)
        # The direction normal to the line between the corners yields a new corner, or proves that there is none.
        across = -1j * (two.z - one.z) * cmath.rect(1.0, -one.angle)
        between = corner(one.angle + cmath.phase(across))
        known = (one.z * cmath.rect(1.0, -between.angle)).real
        if one.angle < between.angle < two.angle and between.support > known + tiny:
            heapq.heappush(branches, _branch(one, between))
            heapq.heappush(branches, _branch(between, two))
    return best


def _branch(one: _Corner, two: _Corner) -> tuple[float, float, _Corner, _Corner]:
    """An interval of directions, after minus the largest possible length of a corner within it (for a min-heap)."""
    width = two.angle - one.angle
    # In the frame of the first direction the support lines are u = one.support and u cos + v sin = two.support.
    v = (two.support - one.support * math.cos(width)) / math.sin(width)
    # The longest corner is the farthest in its own direction, so the intersection counts only inside the interval.
    inside = 0.0 <= math.atan2(v, one.support) <= width
    bound = math.hypot(one.support, v) if inside else max(one.support, two.support)
    return -bound, one.angle, one, two


def quick_error(rows: Points, target: Points, enough: float = 0.0) -> float | None:
    """Mean distance from the shape [units], an upper bound for the optimum, if a correspondence is easy to find.

    Rotations turn the outermost point onto target points at about the same radius. If every point then has a different
    nearest target point, that correspondence determines the final rotation. The cost is O(n log n), against O(n^3) in
    general. Call before `ShapeTarget.error` if an upper bound may be enough. Stops at the first correspondence with a
    mean of at most `enough`. Returns None if it finds no such rotation; the optimum is then unknown.
    """
    x, y = _centre(rows), _centre(target)
    best: float | None = None
    for match in _candidates(x, y):
        mean = float(np.abs(x * (match.z / abs(match.z)) - y[match.columns]).mean())
        best = mean if best is None else min(best, mean)
        if best <= enough:
            break
    return best


def proven_match(rows: Points, target: Points, symmetry: int = 1) -> Correspondence | None:
    """The best correspondence, as from `longest`, if nearest target points suffice to prove it best.

    For a given rotation, no correspondence is better than the nearest target point of each point, and a rotation by
    less than an angle h moves a point by less than h times its radius. An interval of directions is settled in two
    cases. Either the points stay so far from their nearest targets that no better correspondence exists there. Or each
    point keeps the same nearest target and no two points share one; that correspondence is then the best there. Other
    intervals are halved.

    Args:
        rows: shape (n, 2) [units], n >= 2.
        target: shape (n, 2) [units].
        symmetry: as for `longest`.

    Returns:
        None if there is no candidate, or too many intervals are left.
    """
    x, y = _centre(rows), _centre(target)
    best = max(_candidates(x, y), key=lambda match: abs(match.z), default=None)
    if best is None:
        return None
    reach, tree = np.abs(x), scipy.spatial.KDTree(_columns(y))
    pieces = math.ceil(INTERVALS / symmetry)
    width = math.pi / (pieces * symmetry)
    intervals = [(k * 2 * width, width) for k in range(pieces)]
    for _ in range(MAX_INTERVALS):
        if not intervals:
            return best
        least = float((np.abs(x * (best.z / abs(best.z)) - y[best.columns]) ** 2).sum())
        angle, width = intervals.pop()
        turned = _columns(x * cmath.rect(1.0, angle))
        slack = reach * width
        distance = np.asarray(tree.query(turned)[0])
        if float((np.maximum(distance - slack, 0.0) ** 2).sum()) > least:
            continue
        distances, nearest = map(np.asarray, tree.query(turned, k=2))
        columns = nearest[:, 0]
        if len(np.unique(columns)) == len(y) and bool((distances[:, 0] + 2 * slack < distances[:, 1]).all()):
            z = complex((np.conj(x) * y[columns]).sum())
            best = Correspondence(z=z, columns=columns) if abs(z) > abs(best.z) else best
            continue
        intervals += [(angle - width / 2, width / 2), (angle + width / 2, width / 2)]
    return None


def _candidates(x: Complex, y: Complex) -> Iterator[Correspondence]:
    """Correspondences with nearest target points after rotations of the outermost point onto target points."""
    outermost = x[np.abs(x).argmax()]
    if outermost == 0.0:
        return
    tree = scipy.spatial.KDTree(_columns(y))
    partners = np.argsort(np.abs(np.abs(y) - abs(outermost)), kind="stable")[:MAX_PARTNERS]
    for partner in y[partners]:
        turn = complex(partner) / complex(outermost)
        if turn == 0.0:
            continue
        nearest = np.asarray(tree.query(_columns(x * (turn / abs(turn))))[1])
        if len(np.unique(nearest)) == len(y):
            yield Correspondence(z=complex((np.conj(x) * y[nearest]).sum()), columns=nearest)


def _columns(points: Complex) -> Points:
    return np.column_stack([points.real, points.imag])


def as_complex(rows: Points) -> Complex:
    """Points of the plane, shape (n, 2), as complex numbers, shape (n,)."""
    return rows[:, 0] + 1j * rows[:, 1]


def _centre(rows: Points) -> Complex:
    points = as_complex(rows)
    return points - points.mean()


def best_in_space(rows: Points, target: Points) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """For each robot the index of its target point, and the rotation, shape (3, 3), of robots onto target points.

    Args:
        rows: centred positions, shape (n, 3) [units].
        target: centred target points, shape (n, 3) [units].
    """
    # Every rotation is within 63 degrees of one of the 24 of a cube.
    starts = [*scipy.spatial.transform.Rotation.create_group("O").as_matrix().round(), *_from_anchors(rows, target)]
    fits = [_correspond(rows, target, rotation) for rotation in starts]
    order = sorted(range(len(fits)), key=lambda k: -fits[k][0])
    best_fit, best = fits[order[0]]
    for k in order[:MAX_REFINED]:
        fit, columns = fits[k]
        gained = True
        while gained:
            better, refined = _correspond(rows, target, proper_rotation(rows, target[columns]))
            gained = better > fit * (1 + 1e-12)
            fit, columns = better, refined
        if fit > best_fit:
            best_fit, best = fit, columns
    return best, proper_rotation(rows, target[best])


def proper_rotation(rows: Points, target: Points) -> NDArray[np.float64]:
    """The rotation R, shape (d, d), that minimises the sum of |R x_i - y_i|^2 over centred points.

    With the singular value decomposition U S V^T of sum y_i x_i^T it is U diag(1, .., det(U V^T)) V^T (Kabsch 1976).
    The paper flips the sign of a singular value instead (line 626), which leaves U V^T a reflection.
    """
    u, _, vt = np.linalg.svd(target.T @ rows)
    signs = np.ones(rows.shape[1])
    signs[-1] = np.sign(np.linalg.det(u @ vt))
    return (u * signs) @ vt


def _correspond(rows: Points, target: Points, rotation: NDArray[np.float64]) -> tuple[float, NDArray[np.intp]]:
    """The largest sum of <R x_i, y_pi(i)>, and the correspondence pi that has it and so the least sum of squares."""
    gain = (rows @ rotation.T) @ target.T
    index, columns = scipy.optimize.linear_sum_assignment(gain, maximize=True)
    return float(gain[index, columns].sum()), columns


def _from_anchors(rows: Points, target: Points) -> list[NDArray[np.float64]]:
    """Rotations of the planes of two robots onto the plane of two target points far from the centre."""
    radii = np.linalg.norm(target, axis=1)
    a = target[radii.argmax()]
    areas = np.linalg.norm(np.cross(a, target), axis=1)
    b = target[areas.argmax()]
    if areas.max() <= 1e-9 * radii.max() ** 2:
        return []
    out = np.linalg.norm(rows, axis=1)
    apart = np.linalg.norm(rows[:, None] - rows[None], axis=2)
    cost = (out - np.linalg.norm(a))[:, None] ** 2 + (out - np.linalg.norm(b))[None] ** 2
    cost += (apart - np.linalg.norm(a - b)) ** 2
    cheapest = np.argsort(cost, axis=None, kind="stable")[:MAX_ANCHORED]
    pairs = [divmod(int(k), len(rows)) for k in cheapest]
    frames = [frame for i, j in pairs if (frame := _frame(rows[i], rows[j])) is not None]
    goal = _frame(a, b)
    return [] if goal is None else [goal.T @ frame for frame in frames]


def _frame(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Rows: the direction of p, the component of q normal to it, the normal of both; None if p and q are collinear."""
    normal = np.cross(p, q)
    area = float(np.linalg.norm(normal))
    if area <= 1e-12 * float(p @ p + q @ q):
        return None
    along, up = p / np.linalg.norm(p), normal / area
    return np.array([along, np.cross(up, along), up])
