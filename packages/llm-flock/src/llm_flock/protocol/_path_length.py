"""Path lengths to the places of a plan for a robot that stays near the formation, within radio range of others.

Across a large ring the straight line leads out of every robot's radio range. So a path may pass through any places, and
a long hop counts more than its length: the cheapest path leads along the formation. Floyd: Algorithm 97 (CACM 1962).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from llm_flock import graph
from llm_flock.arrays import Pairwise, Point, Points, Vector, between
from llm_flock.plan import Plan

if TYPE_CHECKING:
    from llm_flock.roadmap import Roadmap  # only missions with obstacles need it

REACH = 1.5  # spacings up to which a hop counts with its length; one k times as long counts k times its length
MAX_PLACES = 256  # larger plans use the straight line: other paths cost O(n^3)
FAR = 3.0  # a goal this many spacings away is approached along the formation, in stages of at most this length
ACROSS = 8.0  # a robot in touch with others flies straight to a goal nearer than this many spacings
NO_WAY = 1e6  # length that stands for a way that does not exist [units]: longer than any other
BESIDE = 0.6  # distance at which robots on such a path pass its places, on the side of the centre [spacings]


def ways(here: Point, places: Points, roadmap: Roadmap | None) -> Vector:
    """Lengths of the ways from `here` to some places, shape (m, d), round obstacles [units]; at most `NO_WAY`."""
    if roadmap is None:
        return np.linalg.norm(places - np.array(here), axis=1)
    return np.minimum(roadmap.lengths(here, places), NO_WAY)


def ways_to(here: Point, plan: Plan, slots: Iterable[int], roadmap: Roadmap | None) -> list[float]:
    """As `ways`, to the places of a few slots: for these arrays would cost more than the sums."""
    if roadmap is not None:
        return ways(here, plan.array[list(slots)], roadmap).tolist()
    apart = ([x - y for x, y in zip(plan.points[a], here, strict=True)] for a in slots)
    return [math.sqrt(sum([x * x for x in offset])) for offset in apart]


def path_lengths(
    here: Point, plan: Plan, slots: Iterable[int], spacing: float, roadmap: Roadmap | None = None
) -> list[float]:
    """Lengths of the cheapest paths from `here` to the places of some slots [units; frame of the plan]."""
    if len(plan.points) > MAX_PLACES:
        return ways_to(here, plan, slots, roadmap)
    every = _by_places(here, plan, spacing, roadmap)
    return [every[a] for a in slots]


@lru_cache(maxsize=4096)
def _by_places(here: Point, plan: Plan, spacing: float, roadmap: Roadmap | None) -> list[float]:
    return (_hops(here, plan, spacing, roadmap) + _between(plan, spacing, roadmap)).min(axis=1).tolist()


def next_stop(
    here: Point, plan: Plan, slot: int, center: Point, spacing: float, roadmap: Roadmap | None = None
) -> Point | None:
    """The stop on the path to a far place, beside a place ahead [units; frame of the plan]; None to fly straight."""
    if len(plan) > MAX_PLACES or math.dist(here, plan.points[slot]) <= FAR * spacing:
        return None
    left = _between(plan, spacing, roadmap)[slot]
    counted = _hops(here, plan, spacing, roadmap) + left
    first = int(counted.argmin())
    near = np.linalg.norm(plan.array - np.array(here), axis=1) <= FAR * spacing
    ahead = np.flatnonzero(near & (left <= left[first]))
    stop = int(ahead[left[ahead].argmin()]) if len(ahead) else first
    if stop == slot:
        return None
    place = plan.points[stop]
    inwards = min(1.0, BESIDE * spacing / max(math.dist(place, center), spacing))
    return between(place, center, inwards)


@lru_cache(maxsize=4096)
def _hops(here: Point, plan: Plan, spacing: float, roadmap: Roadmap | None) -> Vector:
    """Cost of a hop to each place, shape (n,) [units]."""
    return _hop_costs(ways(here, plan.array, roadmap), spacing)


@lru_cache(maxsize=256)
def _between(plan: Plan, spacing: float, roadmap: Roadmap | None) -> Pairwise:
    """Lengths of the paths between any two places, shape (n, n) [units]."""
    apart = graph.distances(plan.array)
    if roadmap is not None:
        apart = np.array([ways(place, plan.array, roadmap) for place in plan.points])
    return np.asarray(scipy.sparse.csgraph.floyd_warshall(_hop_costs(apart, spacing), directed=False))


def _hop_costs(lengths: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    return lengths * np.maximum(1.0, lengths / (REACH * spacing))
