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
from typing import Any, cast

import numpy as np
import scipy

from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.message import Message
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.consensus import PlanKey, Standing, plan_key

CAP = 0.09
"""Distance from which on two shapes are simply unlike. Two readers' drawings of one icon, each turned, stretched and
skewed on its own, are 0.03 apart in the median once one is fitted to the other, at most 0.08; drawings of different
icons are 0.15 apart, and 1 % of them less than 0.09 (`benchmarks/words.py`; 4,500 pairs)."""

FITS = 6  # steps of fitting one drawing to the other
MOST_TURN_RAD = math.radians(30.0)  # by which drawings are fitted: a described shape has an upper side
MOST_STRETCH = 1.3  # likewise

PITCH = 0.25
"""Share of the distance between neighbouring places by which the cap is larger: places that are evenly spread along
one outline, but begin anywhere, are a quarter of it away from each other on average."""

SAMPLES = 160  # places that a program is given to compare what it draws
DECIMALS = 9  # of sums of distances, so that they are equal on every robot
RANKED = 5  # elements of a plan's key that rank proposals before shapes count: mission and digest, epoch, places, class


def unlikeness(a: Plan, b: Plan) -> float:
    """The distance of two shapes as a share of the cap, in [0, 1]; place and size do not count. Symmetric.

    It is the Chamfer distance (Barrow et al. 1977) of the places, each set moved to a mean of zero and scaled to a mean
    square radius of 1. A program counts by what it draws, with equally many places for all teams, and two programs by
    the smallest distance while one drawing is fitted to the other (`_fitted`): readers of one word differ in turn and
    stretch. Places that were given are too few to fit.
    """
    return _unlikeness(*sorted((a, b), key=lambda plan: plan.digest))


@lru_cache(maxsize=2**14)
def _unlikeness(a: Plan, b: Plan) -> float:
    if a == b:
        return 0.0
    cap = CAP + PITCH * (_pitch(a) + _pitch(b)) / 2.0
    return min(1.0, _fitted(_scaled(a), _scaled(b), FITS if a.program and b.program else 0) / cap)


def _fitted(one: Points, other: Points, steps: int) -> float:
    """The smallest Chamfer distance while `one` is turned and stretched towards `other`, both of shape (n, d).

    Each step fits an affine map to pairs of nearest points (iterative closest points: Besl and McKay 1992), within
    limits of turn and stretch, and never mirrors. Distances are rounded, so that every robot finds the same pairs.
    """
    moved, best = one, math.inf
    for _ in range(steps + 1):
        away = scipy.spatial.distance.cdist(moved, other).round(DECIMALS)
        to, back = away.argmin(axis=1), away.argmin(axis=0)
        near = away[np.arange(len(one)), to].mean() + away[back, np.arange(len(other))].mean()
        best = min(best, float(near) / 2.0)
        here, there = np.concatenate([one, one[back]]), np.concatenate([other[to], other])
        middle, target = here.mean(axis=0), there.mean(axis=0)
        arms = here - middle
        fit: Points = cast("Any", np.linalg).lstsq(arms, there - target, rcond=1e-6)[0]
        left, stretch, right = np.linalg.svd(fit)
        turn = left @ right
        if np.linalg.det(turn) < 0 or np.trace(turn) < len(turn) - 2 + 2 * math.cos(MOST_TURN_RAD):
            break
        moved = (one - middle) @ (left * stretch.clip(1 / MOST_STRETCH, MOST_STRETCH)) @ right + target
    return best


@lru_cache(maxsize=1024)
def _scaled(plan: Plan) -> Points:
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
