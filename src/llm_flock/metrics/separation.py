"""How near robots come to each other: at an instant, and while all move along straight segments."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from llm_flock import formations

ROUNDING = 1e-6
"""A pair this much nearer than allowed still counts as apart [units]."""

ALL_PAIRS_UP_TO = 200
"""Up to so many robots all pairs are looked at; beyond, only those that can come near, found by a k-d tree."""


def min_separation(positions: ArrayLike) -> float:
    """Distance of the closest pair [units]; infinite for a robot alone.

    Args:
        positions: shape (n, d) [units].
    """
    rows = np.asarray(positions, dtype=np.float64)
    if not 2 <= len(rows) <= ALL_PAIRS_UP_TO:
        return formations.smallest_distance(rows)
    one, two = _pairs(len(rows))
    apart = rows[one] - rows[two]
    return math.sqrt(float((apart * apart).sum(axis=1).min()))


def segment_separation(before: ArrayLike, after: ArrayLike, without: frozenset[tuple[int, int]] = frozenset()) -> float:
    """Smallest distance of any pair while all move at once along straight segments [units]; infinite for one robot.

    All start and arrive together, each at its own constant speed, as in a lockstep round. A pair with the offset p and
    the change of offset v over the round is nearest at the share t = -<p, v> / |v|^2 of it, clipped to 0 .. 1.

    Args:
        before: positions at the start of the round, shape (n, d) [units].
        after: positions at its end, shape (n, d) [units].
        without: pairs (lower id, higher id) to leave out.
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
    """All pairs of n, the lower one first; not to be written to."""
    one, two = np.triu_indices(n, 1)
    return one, two


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


class StartSeparation:
    """Follows the pairs that start nearer than the safe distance until each has come apart.

    Args:
        safe_distance: smallest distance allowed between two robots [units].

    Attributes:
        start_violations: pairs too near at the start.
        separated_at: first round at whose end every one of them had been apart; 0 where there was none, None before.
        smallest: smallest distance of any pair, along segments too, from when that pair was first apart [units].
    """

    def __init__(self, safe_distance: float) -> None:
        self._limit = safe_distance - ROUNDING
        self._together: frozenset[tuple[int, int]] | None = None
        self._before: NDArray[np.float64] | None = None
        self.start_violations = 0
        self.separated_at: int | None = None
        self.smallest = math.inf

    def update(self, round_number: int, positions: NDArray[np.float64], closest: float) -> None:
        """Take a round.

        Args:
            round_number: from 0, the start.
            positions: at its end, shape (n, d) [units].
            closest: smallest distance of any pair in it, along segments too [units].
        """
        if self._together is None:
            near = KDTree(positions).query_pairs(self._limit) if len(positions) > 1 else set[tuple[int, int]]()
            self._together = frozenset(near)
            self.start_violations = len(near)
        if self._together:
            before = positions if self._before is None else self._before
            closest = segment_separation(before, positions, self._together)
        self.smallest = min(self.smallest, closest)
        self._together = frozenset(
            (i, j) for i, j in self._together if math.dist(positions[i], positions[j]) < self._limit
        )
        self._before = positions
        if self.separated_at is None and not self._together:
            self.separated_at = round_number
