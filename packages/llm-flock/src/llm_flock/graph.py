"""The communication graph of a team: robots are neighbours if they are within radio range of each other.

Positions have the shape (n, d) [units], and `comm_range` is the radio range r_comm [units]. An adjacency matrix is
symmetric, shape (n, n); its diagonal does not matter.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike

from llm_flock import shapes as formations
from llm_flock.arrays import Mask, Pairwise, Vector


def distances(positions: ArrayLike) -> Pairwise:
    """Distances between all robots, shape (n, n) [units], exactly symmetric."""
    return formations.distances(positions)


def adjacency(positions: ArrayLike, comm_range: float) -> Mask:
    """Whether each two robots are neighbours: different, and within `comm_range` (paper, equation 1, line 129)."""
    near = distances(positions) <= comm_range
    np.fill_diagonal(near, val=False)
    return near


def neighbors(positions: ArrayLike, comm_range: float) -> tuple[tuple[int, ...], ...]:
    """The neighbours N_i of each robot by number, in ascending order."""
    return tuple(tuple(np.flatnonzero(row).tolist()) for row in adjacency(positions, comm_range))


def influence(positions: ArrayLike, comm_range: float) -> Vector:
    """Influence I_i = |N_i| / N of each robot (paper, equation 1), shape (n,), 0 .. (N - 1) / N."""
    near = adjacency(positions, comm_range)
    return near.sum(axis=1) / len(near)


def is_connected(adjacent: Mask) -> bool:
    """Whether there is a path between any two robots; True for a single robot."""
    reached = np.zeros(len(adjacent), dtype=np.bool_)
    front = reached.copy()
    front[:1] = True
    while front.any():
        reached |= front
        front = adjacent[front].any(axis=0) & ~reached
    return bool(reached.all())


def diameter(adjacent: Mask) -> int | None:
    """Largest number of hops between two robots; None if the graph is not connected.

    On a fixed graph without message loss, max-consensus on plans takes this many communication rounds.
    """
    hops = np.asarray(
        scipy.sparse.csgraph.shortest_path(scipy.sparse.csr_array(adjacent), directed=False, unweighted=True)
    )
    longest = float(hops.max())
    return int(longest) if longest < np.inf else None
