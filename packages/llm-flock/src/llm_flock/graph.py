"""The communication graph of a team: robots are neighbours if they are within radio range of each other.

Positions have the shape (n, d) [units], and `comm_range` is the radio range r_comm [units]. An adjacency matrix is
symmetric, shape (n, n); its diagonal does not matter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from llm_flock.arrays import Mask
from llm_flock.shapes import distances as distances


def adjacency(positions: ArrayLike, comm_range: float) -> Mask:
    """Whether each two robots are neighbours: different, and within `comm_range` (paper, equation 1, line 129)."""
    near = distances(positions) <= comm_range
    np.fill_diagonal(near, val=False)
    return near


def neighbors(positions: ArrayLike, comm_range: float) -> tuple[tuple[int, ...], ...]:
    """The neighbours N_i of each robot by number, in ascending order."""
    return tuple(tuple(np.flatnonzero(row).tolist()) for row in adjacency(positions, comm_range))


def is_connected(adjacent: Mask) -> bool:
    """Whether there is a path between any two robots; True for a single robot."""
    reached = np.zeros(len(adjacent), dtype=np.bool_)
    front = reached.copy()
    front[:1] = True
    while front.any():
        reached |= front
        front = adjacent[front].any(axis=0) & ~reached
    return bool(reached.all())
