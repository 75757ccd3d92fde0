"""How far it is to a place of a plan for a robot that stays near the formation.

Across a large ring the straight way is the shortest, and leads out of everybody's range. So a way may touch any places
of the plan, and a hop from one to the next counts more than its length if it is long: the cheapest way then leads along
the formation, as far as there is one. Shortest paths of all pairs: Floyd: Algorithm 97 (CACM 1962).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import floyd_warshall

from llm_flock import graph
from llm_flock.arrays import Pairwise, Point, Vector
from llm_flock.protocol.plan import Plan

REACH = 1.5
"""A hop of at most this many spacings counts as long as it is; one k times as long counts k times its length."""


LARGEST = 256
"""In plans of more places the straight way is taken: finding the others takes the cube of their number."""

CACHED = 4096

FAR = 3.0
"""A goal this many spacings away is approached along the formation, from place to place, each so far ahead at most."""

ACROSS = 8.0
"""A robot that is in touch with everybody flies straight, unless its goal is so many spacings away: it would be alone
for long, where others could move up instead."""

BESIDE = 0.6
"""Those who fly along the formation pass its places at so many spacings, on the side of the centre."""


def path_lengths(here: Point, plan: Plan, slots: Iterable[int], spacing: float) -> list[float]:
    """Lengths of the cheapest ways to some places, by any others [units].

    Args:
        here: where they begin [units; frame of the plan].
        plan: has the places.
        slots: numbers of the places where they end.
        spacing: wanted distance between neighbouring robots [units].
    """
    if len(plan.points) > LARGEST:
        return [math.dist(here, plan.points[a]) for a in slots]
    every = _by_places(here, plan, spacing)
    return [every[a] for a in slots]


@lru_cache(maxsize=CACHED)
def _by_places(here: Point, plan: Plan, spacing: float) -> list[float]:
    return (_hops(here, plan, spacing) + _between(plan, spacing)).min(axis=1).tolist()


def next_stop(here: Point, plan: Plan, slot: int, center: Point, spacing: float) -> Point | None:
    """Where to fly on the way to a far place: beside a place ahead; None where the straight way is the cheapest.

    Args:
        here: where the robot is [units; frame of the plan].
        plan: has the places.
        slot: number of the place where it is to end.
        center: centre of the formation.
        spacing: wanted distance between neighbouring robots [units].
    """
    if len(plan) > LARGEST or math.dist(here, plan.points[slot]) <= FAR * spacing:
        return None
    left = _between(plan, spacing)[slot]
    counted = _hops(here, plan, spacing) + left
    first = int(counted.argmin())
    near = np.linalg.norm(plan.array - np.array(here), axis=1) <= FAR * spacing
    ahead = np.flatnonzero(near & (left <= left[first]))
    stop = int(ahead[left[ahead].argmin()]) if len(ahead) else first
    if stop == slot:
        return None
    place = plan.points[stop]
    inwards = min(1.0, BESIDE * spacing / max(math.dist(place, center), spacing))
    return tuple(x + inwards * (c - x) for x, c in zip(place, center, strict=True))


@lru_cache(maxsize=4096)
def _hops(here: Point, plan: Plan, spacing: float) -> Vector:
    """What a straight hop to each place counts, shape (n,) [units]."""
    return _counted(np.linalg.norm(plan.array - np.array(here), axis=1), spacing)


@lru_cache(maxsize=256)
def _between(plan: Plan, spacing: float) -> Pairwise:
    """Lengths of the ways between any two places, shape (n, n) [units]."""
    return np.asarray(floyd_warshall(_counted(graph.distances(plan.array), spacing), directed=False))


def _counted(lengths: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    return lengths * np.maximum(1.0, lengths / (REACH * spacing))
