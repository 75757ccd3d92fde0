"""Geometry of a set of points: distances, closest pair, radius, rotation and symmetry."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike

from llm_flock.arrays import Pairwise, Points

SMALL = 50
"""Largest number of points measured without scipy.spatial, which takes longer to import than a small run takes."""


def distances(points: ArrayLike) -> Pairwise:
    """Distances between all points, shape (n, n) [units], exactly symmetric."""
    rows = np.asarray(points, dtype=np.float64)
    if len(rows) > SMALL:
        return scipy.spatial.distance.cdist(rows, rows)
    # Axis by axis: scipy sums in this order too, so the size of a team does not change a bit.
    return np.sqrt(sum((axis[:, None] - axis) ** 2 for axis in rows.T))


def smallest_distance(points: ArrayLike) -> float:
    """Distance of the closest pair of points, shape (n, d) [units]; infinite for fewer than two."""
    rows = np.asarray(points, dtype=np.float64)
    if len(rows) < 2:
        return math.inf
    if len(rows) <= SMALL:
        return float(distances(rows)[np.triu_indices(len(rows), 1)].min())
    return float(np.asarray(scipy.spatial.KDTree(rows).query(rows, k=2)[0])[:, 1].min())


def circumradius(points: ArrayLike, center: Sequence[float]) -> float:
    """Largest distance of the points, shape (n, d), from the centre [units]."""
    return float(np.linalg.norm(np.asarray(points, dtype=np.float64) - np.asarray(center), axis=1).max())


def rotated(points: ArrayLike, center: Sequence[float], angle_rad: float) -> Points:
    """Points of the plane, shape (n, 2), rotated about the centre, counterclockwise for a positive angle."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    arm = np.asarray(points, dtype=np.float64) - np.asarray(center)
    return arm @ np.array([[cos, sin], [-sin, cos]]) + np.asarray(center)


def rotational_symmetry(points: ArrayLike, tolerance: float = 1e-9) -> int:
    """Largest k such that a rotation by 360/k degrees about the mean maps the set of points, shape (n, d), to itself.

    It is 1 without symmetry, for a single point, and in dimensions other than two. `tolerance` is the largest distance
    of an image from a point, as a share of the largest radius.
    """
    rows = np.asarray(points, dtype=np.float64)
    n, dim = rows.shape
    if dim != 2 or n < 2:
        return 1
    rows = rows - rows.mean(axis=0)
    allowed = tolerance * circumradius(rows, (0.0, 0.0))
    tree = scipy.spatial.KDTree(rows)
    # Points other than one at the mean form orbits of k points, so k divides n or n - 1.
    for k in range(n, 1, -1):
        if n % k > 1:
            continue
        offset, image = map(np.asarray, tree.query(rotated(rows, (0.0, 0.0), 2 * math.pi / k)))
        if offset.max() <= allowed and len(np.unique(image)) == n:
            return k
    return 1
