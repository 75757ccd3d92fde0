"""A quick look whether points of the plane resemble a shape: fast where they do, undecided where they may not."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from llm_flock.arrays import Points

ANCHORS = 16
"""So many target points are tried as the partner of the outermost point."""


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
    x = _centred(rows)
    y = _centred(target)
    outermost = x[np.abs(x).argmax()]
    if outermost == 0.0:
        return None
    tree = KDTree(np.column_stack([y.real, y.imag]))
    partners = np.argsort(np.abs(np.abs(y) - abs(outermost)), kind="stable")[:ANCHORS]
    best: float | None = None
    for partner in y[partners]:
        turn = complex(partner) / complex(outermost)
        if turn == 0.0:
            continue
        turned = x * (turn / abs(turn))
        nearest = np.asarray(tree.query(np.column_stack([turned.real, turned.imag]))[1])
        if len(np.unique(nearest)) < len(y):
            continue
        z = complex((np.conj(x) * y[nearest]).sum())
        mean = float(np.abs(x * (z / abs(z)) - y[nearest]).mean())
        best = mean if best is None else min(best, mean)
        if best <= enough:
            break
    return best


def _centred(rows: Points) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    points = rows[:, 0] + 1j * rows[:, 1]
    return points - points.mean()
