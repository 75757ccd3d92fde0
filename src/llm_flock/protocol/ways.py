"""How far it is to a place of a plan for a robot that stays near the formation.

Across a large ring the straight way is the shortest, and leads out of everybody's range. So a way may touch any places
of the plan, and a hop from one to the next counts more than its length if it is long: the cheapest way then leads along
the formation, as far as there is one. Shortest paths: Dijkstra: A note on two problems in connexion with graphs
(Numerische Mathematik 1959).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from llm_flock.arrays import Point, Vector
from llm_flock.protocol.plan import Plan

REACH = 1.5
"""A hop of at most this many spacings counts as long as it is; one k times as long counts k times its length."""


def way_length(here: Point, plan: Plan, slot: int, spacing: float) -> float:
    """Length of the cheapest way to a place, by any others [units].

    Args:
        here: where it begins [units; world frame].
        plan: has the places.
        slot: number of the place where it ends.
        spacing: wanted distance between neighbouring robots [units].
    """
    return float((_hops(here, plan, spacing) + _to_slot(plan, slot, spacing)).min())


def _hops(here: Point, plan: Plan, spacing: float) -> Vector:
    """What a straight hop to each place counts, shape (n,) [units]."""
    lengths = np.linalg.norm(plan.array - np.array(here), axis=1)
    return lengths * np.maximum(1.0, lengths / (REACH * spacing))


@lru_cache(maxsize=4096)
def _to_slot(plan: Plan, slot: int, spacing: float) -> Vector:
    """Lengths of the ways from every place to one of them, shape (n,) [units]."""
    ways = _hops(plan.points[slot], plan, spacing)
    pending = ways.copy()
    for _ in range(len(plan)):
        nearest = int(pending.argmin())
        ways = np.minimum(ways, ways[nearest] + _hops(plan.points[nearest], plan, spacing))
        pending = np.where(np.isinf(pending), np.inf, ways)
        pending[nearest] = np.inf
    return ways
