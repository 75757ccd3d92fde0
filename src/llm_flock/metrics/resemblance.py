"""A quick look whether points of the plane resemble a shape: fast where they do, undecided where they may not."""

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
"""So many target points are tried as the partner of the outermost point."""

INTERVALS, MAX_LOOKS = 64, 8192
"""Intervals of directions at the start, and how many are looked at before it counts as undecided."""


def resemblance(rows: Points, target: Points, enough: float = 0.0) -> float | None:
    """Mean distance to the shape [units], as `ShapeTarget.error` has it, if the correspondence is plain to see.

    The outermost point is turned onto target points about as far out. Once every point has a nearest target point of
    its own, that correspondence gives the rotation. It costs n log n, where finding the best one in general costs n^3.

    Args:
        rows: shape (n, 2) [units].
        target: shape (n, 2) [units].
        enough: the first correspondence with a mean up to this is taken [units].

    Returns:
        None where no such turn was found: then nothing is known.
    """
    x, y = _centred(rows), _centred(target)
    best: float | None = None
    for found in _candidates(x, y):
        mean = float(np.abs(x * (found.z / abs(found.z)) - y[found.columns]).mean())
        best = mean if best is None else min(best, mean)
        if best <= enough:
            break
    return best


def evident(rows: Points, target: Points, symmetry: int = 1) -> Correspondence | None:
    """The best correspondence, as `plane.longest` has it, where it is so good that no other one can match it.

    No rotation brings the points nearer to the target than each is to its nearest target point, and turning by less
    than an angle h moves a point by less than h times its distance from the centre. So an interval of directions is
    done with once the points stay too far off in all of it, or once the nearest target points are the same in all of
    it and a correspondence: that is then the best one there. Others are halved.

    Args:
        rows: shape (n, 2) [units], n >= 2.
        target: shape (n, 2) [units].
        symmetry: a turn by 360/symmetry degrees is known to map the target to itself.

    Returns:
        None where no such correspondence was found, or too many intervals were left.
    """
    x, y = _centred(rows), _centred(target)
    best = max(_candidates(x, y), key=lambda found: abs(found.z), default=None)
    if best is None:
        return None
    reach, tree = np.abs(x), KDTree(_columns(y))
    pieces = math.ceil(INTERVALS / symmetry)
    width = math.pi / (pieces * symmetry)
    intervals = [(k * 2 * width, width) for k in range(pieces)]
    for _ in range(MAX_LOOKS):
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
    """Correspondences of points with nearest target points, once the outermost point is turned onto a target point."""
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
