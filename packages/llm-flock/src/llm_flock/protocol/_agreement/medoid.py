"""The medoid of all proposals: agreement on what nobody can check, as a shape described in words.

Every robot compares the plans that were proposed by the likeness of their shapes, and follows the one that is nearest
to all others together. Theorem 17 in theory.md says when that is a right one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from llm_flock.errors import InputError
from llm_flock.message import Message
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.consensus import PlanKey, Standing, plan_key

CAP = 0.10
"""Distance from which on two shapes are simply unlike. Fifteen readers' drawings of one icon, each turned, stretched
and skewed on its own, are 0.06 apart in the median, and drawings of different icons 0.14."""

PITCH = 0.25
"""Share of the distance between neighbouring places by which the cap is larger: places that are evenly spread along
one outline, but begin anywhere, are a quarter of it away from each other on average."""

SAMPLES = 160  # places that a program is given to compare what it draws
DECIMALS = 9  # of sums of distances, so that they are equal on every robot
RANKED = 5  # elements of a plan's key that rank proposals before shapes count: mission and digest, epoch, places, class


def unlikeness(a: Plan, b: Plan) -> float:
    """The distance of two shapes as a share of the cap, in [0, 1]; place and size do not count. Symmetric.

    It is the Chamfer distance (Barrow et al. 1977) of the places, each set moved to a mean of zero and scaled to a mean
    square radius of 1. A program counts by what it draws, with equally many places for all teams. Turns count, up to
    about 15 degrees, because a described shape has an upper side.
    """
    return _unlikeness(*sorted((a, b), key=lambda plan: plan.digest))


@lru_cache(maxsize=2**14)
def _unlikeness(a: Plan, b: Plan) -> float:
    if a == b:
        return 0.0
    one, other = _scaled(a), _scaled(b)
    away = scipy.spatial.distance.cdist(one, other)
    cap = CAP + PITCH * (_pitch(a) + _pitch(b)) / 2.0
    return min(1.0, float(away.min(axis=0).mean() + away.min(axis=1).mean()) / 2.0 / cap)


@lru_cache(maxsize=1024)
def _scaled(plan: Plan) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    rows = plan.array
    if plan.drawing is not None:
        from llm_flock.formation import drawn_points

        with suppress(InputError):  # such as one that draws a fixed number of places
            rows = plan.drawing.placed(drawn_points(plan.program, SAMPLES, rows.shape[1]))
    rows = rows - rows.mean(axis=0)
    return rows / (math.sqrt(float((rows**2).sum(axis=1).mean())) or 1.0)


@lru_cache(maxsize=1024)
def _pitch(plan: Plan) -> float:
    """Median distance of a place from the next one, in the scale of `_scaled`."""
    rows = _scaled(plan)
    if len(rows) < 2:
        return 0.0
    away = scipy.spatial.distance.cdist(rows, rows) + np.diag([math.inf] * len(rows))
    return float(np.median(away.min(axis=1)))


@dataclass(frozen=True, slots=True)
class MedoidConsensus:
    """Follows the proposal with the smallest sum of distances to all others that are as new, as large and of its class.

    Of equally central ones the highest in the order of `ProvenanceConsensus` is chosen. With `ballots`, the messages
    are one for each proposer, its own last proposal, instead of what the neighbours follow now.
    """

    name: str = "medoid"
    ballots: bool = True

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        """The message with the medoid; None if that is the plan that the robot follows."""
        candidates = dict[PlanKey, tuple[Plan, Message | None]]()
        for message in heard:
            if message.plan is not None and message.provenance is not None:
                key = plan_key(message.plan, message.provenance, message.plan_class)
                candidates[key] = message.plan, message
        if own.plan is not None and own.provenance is not None:
            candidates[plan_key(own.plan, own.provenance, own.plan_class)] = own.plan, None
        rank = max((key[:RANKED] for key in candidates), default=())
        best = [key for key in sorted(candidates, reverse=True) if key[:RANKED] == rank]
        plans = [candidates[key][0] for key in best]
        sums = [round(math.fsum(unlikeness(one, other) for other in plans), DECIMALS) for one in plans]
        return candidates[best[sums.index(min(sums))]][1] if best else None
