"""Checks of plans: a reason for the model that proposed a plan, and a class for the order of plans.

All are pure functions, so every receiver reaches the same verdict. Tolerances, shares of the mission's lengths, accept
rounded coordinates and are tighter than the definition of a formed team.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import IntEnum
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from llm_flock import metrics
from llm_flock.arrays import Point, Points, flattened
from llm_flock.correspondence import quick_error
from llm_flock.mission import CENTER_TOLERANCE, Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import DECIMALS, Plan
from llm_flock.printable import shape_title

RESIDUAL_LIMIT = 0.05
"""Largest mean distance of places from the ideal shape, as a share of the spacing: half of a formed team's limit."""

EXACT_RESIDUAL = 0.01
"""Mean distance up to which a plan counts as exact, as a share of the spacing. Two decimals suffice from spacing 1."""

ROUNDING = 0.02
"""Share of the spacing by which two rounded coordinates may change a distance."""

LENGTH_TOLERANCE = 0.01
"""Share of the step limit by which printed decimals may exceed it; the shield clips such a step."""


class PlanClass(IntEnum):
    """Quality of a plan. In the order of plans, a higher class counts before the proposer's influence."""

    REFUSED = 0
    ACCEPTABLE = 1
    EXACT = 2


def check_plan(mission: Mission, plan: Plan) -> str | None:
    """The reason to reject a plan, as a sentence for the model, or None. Call before a plan is adopted or forwarded.

    The checks, in this order: one finite point of the mission's dimension for each place; all inside the arena; their
    mean at the centre; all half the safe distance away from obstacles, and in one region, so that robots can get from
    each to each; no pair nearer than the safe distance; every place about as far from its nearest one as in the shape;
    and, if the ideal is known, close to it after the best rotation, unless `turn` fixes it, and correspondence. A
    formation that travels passes obstacles: where they are does not matter for its plan.
    """
    return _fault_of_size(mission, plan) or _verdict(mission, plan)[1]


def blocked_within(mission: Mission) -> float:
    """No robot can reach a place if a body that does not move is nearer to it than this [units]."""
    return mission.safe_distance - metrics.AT_GOAL * mission.spacing


def check_proposal(mission: Mission, plan: Plan, still: Iterable[Point], position: Point) -> str | None:
    """As `check_plan`, for a plan of a robot at `position`: places must be in its reach and clear of `still` bodies."""
    reason = check_plan(mission, plan)
    if reason is not None:
        return reason
    if mission.velocity is None and len(mission.regions_of((position, plan.points[0]))) > 1:
        return f"there is no way from {at_text(position)}, where you are, to its points: obstacles are in between."
    for body in still:
        for i, point in enumerate(plan.points):
            if (gap := mission.separation(point, body)) < blocked_within(mission):
                return (
                    f"point {i} is {number_text(gap)} from the robot that stands still at "
                    f"{at_text(body)}{mission.by_height}, at least {number_text(mission.safe_distance)} is required."
                )
    return None


def enlarged(mission: Mission, plan: Plan) -> Plan:
    """The plan, or if rounding put places nearer than the safe distance, a slightly larger one in which they are not.

    Otherwise robots would keep others from their places: between two neighbours that are 0.2 % too near, a robot gets
    to 6 % of the spacing from its place, and only 5 % count as at its goal. Call for plans that pass `check_plan`.
    """
    if len(plan) == 1:
        return plan
    nearest = float(_nearest(flattened(plan.array, mission.downwash))[0].min())
    if nearest >= mission.safe_distance:
        return plan
    mean = plan.array.mean(axis=0)
    share = (mission.safe_distance + 10.0 ** (1 - DECIMALS)) / nearest  # some room, for rounding to use up
    return plan.mapped(tuple(((1 - share) * mean).tolist()), share)


def plan_class(mission: Mission, plan: Plan) -> PlanClass:
    """The class of a plan. Without a known ideal (a shape given as text, a single robot) it is at best acceptable."""
    return PlanClass.REFUSED if _fault_of_size(mission, plan) else _verdict(mission, plan)[0]


@lru_cache(maxsize=1024)
def _verdict(mission: Mission, plan: Plan) -> tuple[PlanClass, str | None]:
    """Class and reason of a plan of the right size; cached for all robots of a process."""
    for fault in (_fault_of_form, _fault_of_place, _fault_of_world, _fault_of_spacing):
        reason = fault(mission, plan)
        if reason is not None:
            return PlanClass.REFUSED, reason
    residual = _residual(mission, plan)
    if residual is None:
        return PlanClass.ACCEPTABLE, None
    if residual > RESIDUAL_LIMIT * mission.spacing:
        return PlanClass.REFUSED, (
            f"its points are {number_text(residual)} off the shape on average, "
            f"{number_text(RESIDUAL_LIMIT * mission.spacing)} is the limit: this is not {shape_title(mission.shape)}."
        )
    exact = residual <= EXACT_RESIDUAL * mission.spacing
    return PlanClass.EXACT if exact else PlanClass.ACCEPTABLE, None


@lru_cache(maxsize=16)
def _expected(mission: Mission) -> tuple[metrics.ShapeTarget | None, float, float]:
    """The ideal shape, and bounds of a place's distance from its nearest other place [units]."""
    # What words describe may have parts; the robots of each have to hear those of the next.
    target, distances = None, np.array([mission.spacing, max(mission.spacing, mission.comm_range / 1.1)])
    if mission.ideal is not None and mission.n_places > 1:
        points = np.array(mission.ideal)
        target, distances = metrics.ShapeTarget(points, turns=mission.turn is None), _nearest(points)[0]
    tolerance = 0.1  # share by which the distance of a place from its nearest other place may differ from the shape's
    return target, float(distances.min()) * (1 - tolerance), float(distances.max()) * (1 + tolerance)


def _nearest(points: Points) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """For each of n >= 2 points, distance and index of its nearest other point, shape (n,) each."""
    distance, index = map(np.asarray, scipy.spatial.KDTree(points).query(points, k=2))
    rows = np.arange(len(points))
    # For two points at one position, the tree may return the other one first.
    other = np.where(index[:, 0] == rows, index[:, 1], index[:, 0])
    return distance[:, 1], other


def _fault_of_size(mission: Mission, plan: Plan) -> str | None:
    """Not cached: plans of another size are not worth remembering."""
    if len(plan) != mission.n_places:
        return f"the plan holds {len(plan)} points, {mission.n_places} are required."
    return None


def _fault_of_form(mission: Mission, plan: Plan) -> str | None:
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


def _fault_of_world(mission: Mission, plan: Plan) -> str | None:
    """A place at an obstacle, or one that is cut off from another."""
    if not mission.obstacles or mission.velocity is not None:
        return None
    # Robots keep the whole distance, and so end within the rounding of coordinates of such a place: at their goal.
    least = mission.body_radius - ROUNDING * mission.spacing
    for i, point in enumerate(plan.points):
        gap, obstacle = min(((o.distance(point), o) for o in mission.obstacles), key=lambda pair: pair[0])
        if gap < least:
            where = f"inside {_obstacle_text(obstacle)}" if gap < 0 else f"{number_text(gap)} from "
            where += "" if gap < 0 else _obstacle_text(obstacle)
            return f"point {i} is {where}, at least {number_text(mission.body_radius)} is required."
    cut_off = (i for i, x in enumerate(plan.points) if len(mission.regions_of((plan.points[0], x))) > 1)
    lonely = next(cut_off, None)
    if lonely is not None:
        return f"there is no way from point 0 to point {lonely}: obstacles are in between."
    return None


def _obstacle_text(obstacle: Obstacle) -> str:
    if obstacle.polygon is not None:
        return f"the polygon with a corner at {at_text(obstacle.polygon[0])}"
    return f"the {'disc' if obstacle.dim == 2 else 'ball'} around {at_text(obstacle.center or ())}"


def _fault_of_spacing(mission: Mission, plan: Plan) -> str | None:
    if len(plan) == 1:
        return None
    gaps, others = _nearest(flattened(plan.array, mission.downwash))
    gaps = gaps.round(DECIMALS)
    closest = int(gaps.argmin())
    # If the spacing equals the safe distance, rounded coordinates cannot keep it to the last digit.
    tight = max(mission.safe_distance, mission.spacing / mission.downwash)
    if gaps[closest] < min(mission.safe_distance, (1 - ROUNDING) * tight):
        i, j = sorted((closest, int(others[closest])))
        gap, least = number_text(gaps[closest]), number_text(mission.safe_distance)
        return f"points {i} and {j} are {gap} apart{mission.by_height}, at least {least} is required."
    distances, others = _nearest(plan.array)
    distances = distances.round(DECIMALS)
    _, near, far = _expected(mission)
    for i, (distance, j) in enumerate(zip(distances.tolist(), others.tolist(), strict=True)):
        if not near <= distance <= far:
            return (
                f"the point nearest to point {i} is point {j}, {number_text(distance)} away; "
                f"from {number_text(near)} to {number_text(far)} is required."
            )
    return None


def _residual(mission: Mission, plan: Plan) -> float | None:
    """Mean distance from the ideal shape [units], rounded so that the verdict does not depend on the machine."""
    target = _expected(mission)[0]
    if target is None:
        return None
    exact = EXACT_RESIDUAL * mission.spacing
    turns = mission.dim == 2 and mission.turn is None
    quick = quick_error(plan.array, np.array(mission.ideal), exact) if turns else None
    if quick is None or quick > RESIDUAL_LIMIT * mission.spacing:
        quick = target.error(plan.array).mean
    return round(quick, DECIMALS)


def outside(mission: Mission, point: Point) -> float:
    """Largest distance of a point beyond a wall, along any axis [units]; zero inside the arena."""
    low, high = mission.arena
    return max(0.0, *(max(a - x, x - b) for a, x, b in zip(low, point, high, strict=True)))


def number_text(value: float) -> str:
    """A number with four significant digits, for a sentence."""
    return f"{value:.4g}"


def at_text(point: Point) -> str:
    """A point for a sentence."""
    return "[" + ", ".join(map(number_text, point)) + "]"
