"""Smallest distances between robots, at one moment and along straight segments."""

from __future__ import annotations

import functools
import math

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from llm_flock import formations

ROUNDING = 1e-6
"""A pair nearer than allowed by up to this still counts as separated [units]."""

ALL_PAIRS_UP_TO = 200
"""Largest team for which all pairs are examined; beyond it, a k-d tree selects the pairs that can come near."""


def min_separation(positions: ArrayLike) -> float:
    """Distance of the closest pair [units]; infinite for a single robot."""
    return formations.smallest_distance(positions)


def segment_separation(before: ArrayLike, after: ArrayLike, without: frozenset[tuple[int, int]] = frozenset()) -> float:
    """Smallest distance of any pair during a lockstep round [units]; infinite for a single robot.

    All robots start and arrive together, on straight segments at constant speed. A pair with offset p and change of
    offset v over the round is nearest after the share t = -<p, v> / |v|^2 of the round, clipped to 0 .. 1. Pairs
    (lower id, higher id) in `without` are left out.
    """
    start, end = np.asarray(before, dtype=np.float64), np.asarray(after, dtype=np.float64)
    if len(start) < 2:
        return math.inf
    few = len(start) <= ALL_PAIRS_UP_TO or bool(without)
    one, two = _pairs(len(start)) if few else _near_pairs(start, end)
    if without:
        kept = np.array([pair not in without for pair in zip(one.tolist(), two.tolist(), strict=True)])
        one, two = one[kept], two[kept]
        if len(one) == 0:
            return math.inf
    move = end - start
    offset = start[one] - start[two]
    change = move[one] - move[two]
    squared = (change * change).sum(axis=1)
    share = np.clip(-(offset * change).sum(axis=1) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    closest = offset + share[:, None] * change
    return math.sqrt(float((closest * closest).sum(axis=1).min()))


@functools.lru_cache(maxsize=16)
def _pairs(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of all pairs of n robots, the lower one first. Cached: do not modify."""
    one, two = np.triu_indices(n, 1)
    return one, two


def _near_pairs(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs that include the one that comes nearest.

    A robot is always within half a segment of its segment's midpoint. The nearest pair is at most as far apart as the
    closest pair at the start or the end, so its midpoints are at most that distance plus the longest segment apart.
    """
    known = min(min_separation(start), min_separation(end))
    longest = float(np.linalg.norm(end - start, axis=1).max())
    reach = (known + longest) * (1 + 1e-9)
    pairs = np.asarray(scipy.spatial.KDTree((start + end) / 2).query_pairs(reach, output_type="ndarray"))
    return pairs[:, 0], pairs[:, 1]


class StartSeparation:
    """Separation of a run without the pairs that start too close. Call `update` for the start and after every round.

    A pair that starts nearer than the safe distance is left out until it has first been separated.

    Attributes:
        start_violations: number of pairs that are too close at the start.
        separated_at: first round after which all of these pairs have been separated; 0 without such pairs, None before.
        smallest: smallest distance of any pair from its first separation on, including along segments [units].
    """

    def __init__(self, safe_distance: float) -> None:
        self._limit = safe_distance - ROUNDING
        self._together: frozenset[tuple[int, int]] = frozenset()
        self._before: NDArray[np.float64] | None = None
        self.start_violations = 0
        self.separated_at: int | None = None
        self.smallest = math.inf

    def update(self, round_number: int, positions: NDArray[np.float64], closest: float) -> None:
        """Add a round (0 is the start), its last positions, and the smallest distance in it, segments included."""
        if self._before is None:
            self._before, self._together = (
                positions,
                frozenset(scipy.spatial.KDTree(positions).query_pairs(self._limit)),
            )
            self.start_violations = len(self._together)
        if self._together:
            closest = segment_separation(self._before, positions, self._together)
        self.smallest = min(self.smallest, closest)
        self._together = frozenset(
            (i, j) for i, j in self._together if math.dist(positions[i], positions[j]) < self._limit
        )
        self._before = positions
        if self.separated_at is None and not self._together:
            self.separated_at = round_number
