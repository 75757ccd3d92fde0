"""Strokes as a network: where they meet, end or bend is a node, and points are even along the edges between nodes."""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from llm_flock.arrays import Points
from llm_flock.bounds import MAX_ROBOTS
from llm_flock.errors import InputError

NEAR = 1e-6  #: Points of strokes nearer than this, as a share of the drawing's width, are one.
BEND_DEG = 30.0  #: A stroke that turns by more in one corner has a node there.
MOST_SLID = 150  #: Most points of a drawing that are moved apart: each one pushes every other.
SLIDES, STEEP = 200, 8  #: Rounds of sliding, and the power with which the push falls with the distance.
WORTH = 1.05  #: Points stay even unless sliding makes the closest pair so much wider.
MAX_PAIRS = 200_000  #: Most pairs of straight pieces that are examined for where they cross.
MAX_CUTS = 8 * MAX_ROBOTS  #: Most spots at which lines are cut by others; most of them need a robot.
LEAST_ON_LOOP = 3  #: Pieces into which an edge that ends where it begins is cut at least.


@dataclass(frozen=True, kw_only=True)
class Net:
    """Nodes, shape (v, 3), and edges, each a polyline; edges without nodes at their ends are loops."""

    nodes: Points
    edges: tuple[Points, ...]
    free: tuple[bool, ...]  #: For each edge, whether it is a loop that begins at no node.

    @cached_property
    def lengths(self) -> NDArray[np.float64]:
        """Length of each edge."""
        return np.array([_length(edge) for edge in self.edges])

    @property
    def least(self) -> int:
        """Fewest points that show every edge."""
        return len(self.nodes) + sum(self._least_pieces()) - self._ends()

    def _ends(self) -> int:
        return sum(not free for free in self.free)

    def _least_pieces(self) -> list[int]:
        return [LEAST_ON_LOOP if (edge[0] == edge[-1]).all() else 1 for edge in self.edges]

    def place(self, n: int) -> Points:
        """`n` points, at least `least`: one on each node, the others evenly along the edges, shape (n, 3).

        Each further piece goes to the edge whose pieces stay longest, so that the shortest piece is as long as possible
        (the divisor method of Jefferson and D'Hondt). Where strokes leave a node side by side, their points are nearer
        to each other than along the strokes: then points slide along them as far as that helps.
        """
        pieces: list[int] = self._least_pieces()
        lengths: list[float] = self.lengths.tolist()

        def further(k: int) -> tuple[float, int]:
            """Orders edges by the length of their pieces if they had one more, rounded, as equal ones are many."""
            return -round(lengths[k] / (pieces[k] + 1), 9), k

        heap = [further(k) for k in range(len(pieces))]
        heapq.heapify(heap)
        for _ in range(n - self.least):
            k = heap[0][1]
            pieces[k] += 1
            heapq.heapreplace(heap, further(k))
        shares = [np.arange(0 if free else 1, m) / m for free, m in zip(self.free, pieces, strict=True)]
        even = self._at(shares)
        if (
            not lengths
            or n > MOST_SLID
            or n == len(self.nodes)
            or nearest(even) >= 0.9 * min(length / m for length, m in zip(lengths, pieces, strict=True))
        ):
            return even
        slid = self._at(self._slid(shares))
        return slid if nearest(slid) > WORTH * nearest(even) else even

    def _at(self, shares: Sequence[NDArray[np.float64]]) -> Points:
        return np.concatenate([self.nodes, *map(along, self.edges, shares)])

    def _slid(self, shares: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Points pushed apart along their edges by a steep, smooth force (Riesz energy: Hardin, Saff 2004)."""
        at, owner = np.concatenate(shares), np.repeat(np.arange(len(shares)), [*map(len, shares)])
        lengths, first, ends = self.lengths[owner], len(self.nodes), np.cumsum([*map(len, shares)])[:-1]
        gap = float(self.lengths.sum()) / len(at)
        for k in range(SLIDES):
            points = self._at(np.split(at, ends))
            ahead = self._at(np.split(at + 1e-4, ends))
            way = points[first:, None] - points[None]
            apart = np.linalg.norm(way, axis=2)
            apart[np.arange(len(at)), first + np.arange(len(at))] = math.inf
            force = np.minimum(gap / np.maximum(apart, 1e-3 * gap), 4.0) ** STEEP
            push = ((force / np.maximum(apart, 1e-3 * gap))[:, :, None] * way).sum(axis=1)
            along_edge = (
                (ahead - points)[first:] / np.linalg.norm((ahead - points)[first:], axis=1)[:, None] * push
            ).sum(axis=1)
            move = 0.1 * gap * (1 - k / SLIDES) * along_edge / np.sqrt(1 + along_edge**2)
            at = np.clip(at + move / lengths, 0.0, 0.999).round(5)  # what differs between machines does not grow
        return np.split(at, ends)


def nearest(points: Points) -> float:
    """Distance of the closest pair of points, infinite for one."""
    if len(points) < 2:
        return math.inf
    return float(np.asarray(scipy.spatial.cKDTree(points).query(points, k=2)[0])[:, 1].min())


def along(edge: Points, shares: NDArray[np.float64]) -> Points:
    """The points of a polyline at shares of its length, shape (m, 3)."""
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(edge, axis=0), axis=1))])
    axes: list[NDArray[np.float64]] = [np.interp(shares * at[-1], at, axis) for axis in edge.T]
    return np.column_stack(axes)


def _length(edge: Points) -> float:
    return float(np.linalg.norm(np.diff(edge, axis=0), axis=1).sum())


def net_of(strokes: list[Points], *, bends: bool) -> Net:
    """The network of strokes, shape (m, 3) each; with `bends`, their sharp corners are nodes, too."""
    corners, links = _graph(strokes)
    beside: dict[int, list[int]] = defaultdict(list)
    for a, b in sorted(links):
        beside[a].append(b)
        beside[b].append(a)
    nodes = [k for k in range(len(corners)) if len(beside[k]) != 2 or (bends and _bends(corners, k, beside[k]))]
    known, left = set(nodes), set(links)
    paths: list[list[int]] = []

    def walk(path: list[int]) -> None:
        left.discard((min(path[-2:]), max(path[-2:])))
        while path[-1] not in known and path[-1] != path[0]:
            path.append(next(k for k in beside[path[-1]] if k != path[-2]))
            left.discard((min(path[-2:]), max(path[-2:])))
        paths.append(path)

    for node in nodes:
        for k in beside[node]:
            if (min(node, k), max(node, k)) in left:
                walk([node, k])
    ways = len(paths)
    for start in range(len(corners)):  # loops begin and go on as they are drawn
        for k in beside[start][:1]:
            if (min(start, k), max(start, k)) in left:
                walk([start, k])
    return Net(
        nodes=corners[nodes],
        edges=tuple(corners[path] for path in paths),
        free=tuple(k >= ways for k in range(len(paths))),
    )


def _bends(corners: Points, k: int, beside: list[int]) -> bool:
    a, b = (corners[j] - corners[k] for j in beside)
    cos = float(a @ b) / (float(np.linalg.norm(a)) * float(np.linalg.norm(b)))
    return cos > -math.cos(math.radians(BEND_DEG))


def _graph(strokes: list[Points]) -> tuple[Points, set[tuple[int, int]]]:
    """Corners and the pieces between them, after strokes are cut where they touch or cross each other."""
    every = np.concatenate(strokes)
    near = NEAR * max(float(np.ptp(every, axis=0).max()), 1e-9)
    ends = np.cumsum([len(stroke) for stroke in strokes])
    first = np.setdiff1d(np.arange(len(every)), ends - 1)
    start, step = every[first], every[first + 1] - every[first]
    cuts = _cuts(start, step, near)
    rows, pairs = [every], list[tuple[int, int]]()
    count = len(every)
    for k, left in enumerate(first.tolist()):
        shares = cuts.get(k, ())
        rows.append(start[k] + np.array(shares).reshape(-1, 1) * step[k])
        line = [left, *range(count, count + len(shares)), left + 1]
        pairs += pairwise(line)
        count += len(shares)
    spots = np.concatenate(rows)
    same = scipy.spatial.cKDTree(spots).query_pairs(10 * near, output_type="ndarray")
    links = scipy.sparse.coo_array((np.ones(len(same)), (same[:, 0], same[:, 1])), shape=(count, count))
    label = np.asarray(scipy.sparse.csgraph.connected_components(links, directed=False)[1])
    corners = spots[np.unique(label, return_index=True)[1]]
    joined = {(min(a, b), max(a, b)) for a, b in ((int(label[i]), int(label[j])) for i, j in pairs) if a != b}
    return corners, joined


def _cuts(start: Points, step: Points, near: float) -> dict[int, list[float]]:
    """For each piece, shape (m, 3), the shares of its length at which another touches or crosses it, ascending."""
    end = start + step
    low, high = np.minimum(start, end) - near, np.maximum(start, end) + near
    meet = np.ones((len(start), len(start)), dtype=bool)
    for axis in range(3):
        meet &= (low[:, None, axis] <= high[None, :, axis]) & (low[None, :, axis] <= high[:, None, axis])
    i, j = np.nonzero(np.triu(meet, 1))
    if len(i) > MAX_PAIRS:
        raise InputError("draw", None, says="too many of its lines cross each other")
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b, r = step[i], step[j], start[i] - start[j]
        aa, ab, bb, ar, br = ((x * y).sum(axis=1) for x, y in ((a, a), (a, b), (b, b), (a, r), (b, r)))
        parallel = aa * bb - ab * ab
        s, t = (ab * br - ar * bb) / parallel, (aa * br - ab * ar) / parallel
        apart = np.linalg.norm(r + s[:, None] * a - t[:, None] * b, axis=1)
        cross = (parallel > 1e-12 * aa * bb) & (apart <= near) & (np.abs(s - 0.5) <= 0.5) & (np.abs(t - 0.5) <= 0.5)
    found = [(i[cross], s[cross]), (j[cross], t[cross])]
    for one, other in ((i, j), (j, i)):  # ends of one on the other
        for tip in (start[one], end[one]):
            along_ = ((tip - start[other]) * step[other]).sum(axis=1) / np.maximum(
                (step[other] ** 2).sum(axis=1), 1e-300
            )
            on = np.linalg.norm(start[other] + along_[:, None] * step[other] - tip, axis=1) <= near
            found.append((other[on], along_[on]))
    piece, share = (np.concatenate(parts) for parts in zip(*found, strict=True))
    inside = (share > 0) & (share < 1)
    piece, share = piece[inside], share[inside].round(12)
    order = np.lexsort((share, piece))
    piece, share = piece[order], share[order]
    # Many pieces through one spot cut each other there: one cut of each is enough.
    spot = np.floor(share * np.linalg.norm(step, axis=1)[piece] / near)
    new = np.append(True, (np.diff(piece) != 0) | (np.diff(spot) != 0))[: len(piece)]
    if (count := int(new.sum())) > MAX_CUTS:
        raise InputError("draw", None, f"lines that touch or cross at most {MAX_CUTS:,} times (here {count:,})")
    cuts: dict[int, list[float]] = defaultdict(list)
    for k, one in zip(piece[new].tolist(), share[new].tolist(), strict=True):
        cuts[k].append(one)
    return cuts
