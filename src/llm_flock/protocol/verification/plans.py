"""What is checked before a plan or a step is used: reasons in words for whoever made it, and a class for the order.

Everything here is a pure function of the mission and of what one robot knows, so each receiver judges for itself and
all come to the same verdict on the same plan. Tolerances are shares of the mission's lengths: they leave room for
coordinates that a model has rounded, and less than the definition of a formed team leaves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from llm_flock import metrics
from llm_flock.arrays import Point, Points
from llm_flock.mission import Mission
from llm_flock.protocol.plan import DECIMALS, Plan

CENTER_TOLERANCE = 0.05
"""Share of the spacing by which the mean of the places may miss the centre: half a unit at the paper's spacing of 10,
which is what whole-number coordinates can be off. The shape does not depend on it."""

SPACING_TOLERANCE = 0.1
"""Share by which a place's nearest other place may be nearer or farther than in the shape."""

RESIDUAL_LIMIT = 0.05
"""Share of the spacing that places may be off the ideal shape, on average: half of what a formed team may be."""

EXACT_RESIDUAL = 0.01
"""Share of the spacing up to which a plan counts as exact. Two decimals suffice at any spacing from 1 on."""

ROUNDING = 0.02
"""Share of the spacing that two rounded coordinates may take away from a distance or add to it."""

LENGTH_TOLERANCE = 0.01
"""Share of the step limit by which printed decimals may make a waypoint too far; the shield clips it."""

CACHED_PLANS = 4096


class PlanClass(IntEnum):
    """How good a plan is; in the order of plans, higher comes before the proposer's influence."""

    REFUSED = 0
    ACCEPTABLE = 1
    EXACT = 2


@dataclass(frozen=True, slots=True)
class _Verdict:
    plan_class: PlanClass
    reason: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Expected:
    """What a mission's plans are compared with; `near` and `far` bound a place's distance to its nearest other one."""

    target: metrics.ShapeTarget | None
    points: Points | None
    near: float
    far: float


def check_plan(mission: Mission, plan: Plan) -> str | None:
    """Why this plan will not do, as a sentence for the model, or None.

    Checked in this order: as many points as robots, of the mission's dimension, finite; inside the arena; mean at the
    centre; no pair nearer than the safe distance; every place about as far from its nearest one as in the shape; and,
    where the ideal is known, close to it after the best rotation and correspondence.
    """
    return _verdict(mission, plan).reason


def blocked_within(mission: Mission) -> float:
    """A place is out of everybody's reach if a body that does not move is nearer to it than this [units]."""
    return mission.safe_distance - metrics.AT_GOAL * mission.spacing


def check_proposal(mission: Mission, plan: Plan, still: Iterable[Point]) -> str | None:
    """As `check_plan`, for a plan of one's own: no place may be so near a body in sight that nobody can take it."""
    reason = check_plan(mission, plan)
    if reason is not None:
        return reason
    for body in still:
        for i, point in enumerate(plan.points):
            if math.dist(point, body) < blocked_within(mission):
                return (
                    f"point {i} is {number_text(math.dist(point, body))} from the robot that stands still at "
                    f"{at_text(body)}, at least {number_text(mission.safe_distance)} is required."
                )
    return None


def plan_class(mission: Mission, plan: Plan) -> PlanClass:
    """The class of this plan; where no ideal is known (a shape in words, a single robot) it is acceptable at best."""
    return _verdict(mission, plan).plan_class


@lru_cache(maxsize=CACHED_PLANS)
def _verdict(mission: Mission, plan: Plan) -> _Verdict:
    """Both answers at once. Pure, so every plan is judged once however many robots of a process hear of it."""
    reason = _fault_of_form(mission, plan) or _fault_of_place(mission, plan) or _fault_of_spacing(mission, plan)
    if reason is not None:
        return _Verdict(PlanClass.REFUSED, reason)
    residual = _residual(mission, plan)
    if residual is None:
        return _Verdict(PlanClass.ACCEPTABLE, None)
    if residual > RESIDUAL_LIMIT * mission.spacing:
        return _Verdict(
            PlanClass.REFUSED,
            f"its points are {number_text(residual)} off the shape on average, "
            f"{number_text(RESIDUAL_LIMIT * mission.spacing)} is the limit: this is not {mission.shape}.",
        )
    exact = residual <= EXACT_RESIDUAL * mission.spacing
    return _Verdict(PlanClass.EXACT if exact else PlanClass.ACCEPTABLE, None)


@lru_cache(maxsize=16)
def _expected(mission: Mission) -> _Expected:
    if mission.ideal is None or mission.n_places == 1:
        points, distances = None, np.array([mission.spacing])
    else:
        points = np.array(mission.ideal)
        distances = _nearest(points)[0]
    return _Expected(
        target=None if points is None else metrics.ShapeTarget(points),
        points=points,
        near=float(distances.min()) * (1 - SPACING_TOLERANCE),
        far=float(distances.max()) * (1 + SPACING_TOLERANCE),
    )


def _nearest(points: Points) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """For each of n >= 2 points the distance to its nearest other point and that one's number, shape (n,) each."""
    found = KDTree(points).query(points, k=2)
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    rows = np.arange(len(points))
    # Of two points in one place the tree may name the other one first.
    other = np.where(index[:, 0] == rows, index[:, 1], index[:, 0])
    return distance[:, 1], other


def _fault_of_form(mission: Mission, plan: Plan) -> str | None:
    if len(plan) != mission.n_places:
        return f"the plan holds {len(plan)} points, {mission.n_places} are required."
    for i, point in enumerate(plan.points):
        if len(point) != mission.dim:
            return f"point {i} has {len(point)} numbers, {mission.dim} are required."
        if not all(map(math.isfinite, point)):
            return f"point {i} is {at_text(point)}; every coordinate must be a finite number."
    return None


def _fault_of_place(mission: Mission, plan: Plan) -> str | None:
    low, high = (np.array(corner) for corner in mission.arena)
    out = np.maximum(low - plan.array, plan.array - high).max(axis=1) > ROUNDING * mission.spacing
    if out.any():
        i = int(out.argmax())
        corners = " to ".join(map(at_text, mission.arena))
        return f"point {i} is at {at_text(plan.points[i])}, outside the arena from {corners}."
    mean = tuple(float(x) for x in plan.array.mean(axis=0))
    off = round(math.dist(mean, mission.center), DECIMALS)
    if off > CENTER_TOLERANCE * mission.spacing:
        center = at_text(mission.center)
        return f"the mean of its points is {at_text(mean)}, {number_text(off)} away from {center}, where it must be."
    return None


def _fault_of_spacing(mission: Mission, plan: Plan) -> str | None:
    if len(plan) == 1:
        return None
    distances, others = _nearest(plan.array)
    distances = distances.round(DECIMALS)
    closest = int(distances.argmin())
    # Where the spacing is the safe distance itself, rounded coordinates cannot keep it to the last digit.
    if distances[closest] < min(mission.safe_distance, (1 - ROUNDING) * mission.spacing):
        i, j = sorted((closest, int(others[closest])))
        least = number_text(mission.safe_distance)
        return f"points {i} and {j} are {number_text(distances[closest])} apart, at least {least} is required."
    expected = _expected(mission)
    for i, (distance, j) in enumerate(zip(distances.tolist(), others.tolist(), strict=True)):
        if not expected.near <= distance <= expected.far:
            return (
                f"the point nearest to point {i} is point {j}, {number_text(distance)} away; "
                f"from {number_text(expected.near)} to {number_text(expected.far)} is required."
            )
    return None


def _residual(mission: Mission, plan: Plan) -> float | None:
    """Mean distance to the ideal shape [units], rounded so that the last digits of a machine do not decide."""
    expected = _expected(mission)
    if expected.target is None or expected.points is None:
        return None
    exact = EXACT_RESIDUAL * mission.spacing
    quick = metrics.resemblance(plan.array, expected.points, exact) if mission.dim == 2 else None
    if quick is None or quick > RESIDUAL_LIMIT * mission.spacing:
        quick = expected.target.error(plan.array).mean
    return round(quick, DECIMALS)


def outside(mission: Mission, point: Point) -> float:
    """How far a point is beyond the nearest walls, along the worst axis [units]; zero inside."""
    low, high = mission.arena
    beyond = 0.0
    for a, x, b in zip(low, point, high, strict=True):
        if x < a or x > b:
            beyond = max(beyond, a - x, x - b)
    return beyond


def number_text(value: float) -> str:
    """A number for a sentence, to four digits."""
    return f"{value:.4g}"


def at_text(point: Point) -> str:
    """A point for a sentence."""
    return "[" + ", ".join(map(number_text, point)) + "]"
