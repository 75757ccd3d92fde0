"""A fast comparison of points of the plane with a shape: decides quickly if they match, or not at all.

`llm_flock.metrics.plane` always finds the optimum, but takes the cube of the number of points, many times.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from llm_flock.arrays import Points
from llm_flock.metrics.plane import Correspondence

Complex: TypeAlias = NDArray[np.complex128]

ANCHORS = 16
"""Number of target points that are tried as the partner of the outermost point."""

INTERVALS, MAX_INTERVALS = 64, 8192
"""Initial number of intervals of directions, and the number after which the search gives up."""


def quick_error(rows: Points, target: Points, enough: float = 0.0) -> float | None:
    """Mean distance from the shape [units], an upper bound for the optimum, if a correspondence is easy to find.

    Rotations turn the outermost point onto target points at about the same radius. If every point then has a different
    nearest target point, that correspondence determines the final rotation. The cost is n log n, against n^3 for
    the general case. Call before `ShapeTarget.error` if an upper bound may settle the matter.

    Args:
        rows: shape (n, 2) [units].
        target: shape (n, 2) [units].
        enough: stop at the first correspondence with a mean of at most this [units].

    Returns:
        None if no such rotation was found; nothing is known then.
    """
    x, y = _centred(rows), _centred(target)
    best: float | None = None
    for found in _candidates(x, y):
        mean = float(np.abs(x * (found.z / abs(found.z)) - y[found.columns]).mean())
        best = mean if best is None else min(best, mean)
        if best <= enough:
            break
    return best


def proven_match(rows: Points, target: Points, symmetry: int = 1) -> Correspondence | None:
    """The best correspondence, as from `plane.longest`, if nearest target points suffice to prove it best.

    For a given rotation, no correspondence is better than the nearest target point of each point, and a rotation by
    less than an angle h moves a point by less than h times its radius. So an interval of directions is settled if the
    points are too far from their nearest target points in all of it; or if these are the same in all of it and all
    different, which is then the best correspondence there. Other intervals are halved.

    Args:
        rows: shape (n, 2) [units], n >= 2.
        target: shape (n, 2) [units].
        symmetry: a rotation by 360/symmetry degrees maps the target to itself.

    Returns:
        None if no correspondence was found, or too many intervals were left.
    """
    x, y = _centred(rows), _centred(target)
    best = max(_candidates(x, y), key=lambda found: abs(found.z), default=None)
    if best is None:
        return None
    reach, tree = np.abs(x), KDTree(_columns(y))
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
        off = np.asarray(tree.query(turned)[0])
        if float((np.maximum(off - slack, 0.0) ** 2).sum()) > least:
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
    tree = KDTree(_columns(y))
    partners = np.argsort(np.abs(np.abs(y) - abs(outermost)), kind="stable")[:ANCHORS]
    for partner in y[partners]:
        turn = complex(partner) / complex(outermost)
        if turn == 0.0:
            continue
        nearest = np.asarray(tree.query(_columns(x * (turn / abs(turn))))[1])
        if len(np.unique(nearest)) == len(y):
            yield Correspondence(z=complex((np.conj(x) * y[nearest]).sum()), columns=nearest)


def _columns(points: Complex) -> Points:
    return np.column_stack([points.real, points.imag])


def _centred(rows: Points) -> Complex:
    points = rows[:, 0] + 1j * rows[:, 1]
    return points - points.mean()
