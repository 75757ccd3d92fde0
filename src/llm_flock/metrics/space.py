"""A good correspondence and rotation between two sets of points in space: a local optimum from many starts.

Alternating between the best correspondence for a rotation and the best rotation for a correspondence never gets worse,
but may end in a local optimum. So it starts from rotations spread over all orientations, and from rotations of pairs
of robots onto two anchor points of the target with similar distances from the centre and from each other. If the team
is near its shape, one of the latter is nearly right.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from llm_flock.arrays import Points

ANCHORED_STARTS = 24
"""Number of pairs of robots that are rotated onto the target's two anchor points."""

REFINED_STARTS = 6
"""Number of starting rotations, the best ones, that are refined."""

GAIN = 1e-12
"""Smallest gain for which a refinement continues, as a share."""


@cache
def _cube_rotations() -> NDArray[np.float64]:
    """The 24 rotations of a cube, shape (24, 3, 3): every rotation is within 63 degrees of one of them."""
    return scipy.spatial.transform.Rotation.create_group("O").as_matrix().round()


def best_in_space(rows: Points, target: Points) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """For each robot the index of its target point, and the rotation, shape (3, 3), of robots onto target points.

    Args:
        rows: centred positions, shape (n, 3) [units].
        target: centred target points, shape (n, 3) [units].
    """
    starts = [*_cube_rotations(), *_anchored(rows, target)]
    fits = [_correspond(rows, target, rotation) for rotation in starts]
    order = sorted(range(len(fits)), key=lambda k: (-fits[k][0], k))
    best_fit, best = fits[order[0]]
    for k in order[:REFINED_STARTS]:
        fit, columns = fits[k]
        while True:
            better, refined = _correspond(rows, target, proper_rotation(rows, target[columns]))
            gained = better > fit * (1 + GAIN)
            fit, columns = better, refined
            if not gained:
                break
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


def _anchored(rows: Points, target: Points) -> list[NDArray[np.float64]]:
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
    cheapest = np.argsort(cost, axis=None, kind="stable")[:ANCHORED_STARTS]
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
