"""How near robots come to each other: at an instant, and while all move along straight segments."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from llm_flock import formations

ALL_PAIRS_UP_TO = 200
"""Up to so many robots all pairs are looked at; beyond, only those that can come near, found by a k-d tree."""


def min_separation(positions: ArrayLike) -> float:
    """Distance of the closest pair [units]; infinite for a robot alone.

    Args:
        positions: shape (n, d) [units].
    """
    return formations.smallest_distance(positions)


def segment_separation(before: ArrayLike, after: ArrayLike) -> float:
    """Smallest distance of any pair while all move at once along straight segments [units]; infinite for one robot.

    All start and arrive together, each at its own constant speed, as in a lockstep round. A pair with the offset p and
    the change of offset v over the round is nearest at the share t = -<p, v> / |v|^2 of it, clipped to 0 .. 1.

    Args:
        before: positions at the start of the round, shape (n, d) [units].
        after: positions at its end, shape (n, d) [units].
    """
    start, end = np.asarray(before, dtype=np.float64), np.asarray(after, dtype=np.float64)
    if len(start) < 2:
        return math.inf
    one, two = np.triu_indices(len(start), 1) if len(start) <= ALL_PAIRS_UP_TO else _near_pairs(start, end)
    move = end - start
    offset = start[one] - start[two]
    change = move[one] - move[two]
    squared = (change * change).sum(axis=1)
    share = np.clip(-(offset * change).sum(axis=1) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    closest = offset + share[:, None] * change
    return math.sqrt(float((closest * closest).sum(axis=1).min()))


def _near_pairs(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs among which the closest one is.

    At any time a robot is within half its segment of the segment's middle. So the pair that comes nearest, which is
    at most as far as the closest pair at the start or end, has middles within that distance plus one longest segment.
    """
    known = min(min_separation(start), min_separation(end))
    longest = float(np.linalg.norm(end - start, axis=1).max())
    reach = (known + longest) * (1 + 1e-9)
    pairs = np.asarray(KDTree((start + end) / 2).query_pairs(reach, output_type="ndarray"))
    return pairs[:, 0], pairs[:, 1]
