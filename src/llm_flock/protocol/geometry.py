"""Answers by plain geometry, without a language model: the ideal points of the shape, and straight steps."""

from __future__ import annotations

import math

import numpy as np

from llm_flock import formations
from llm_flock.arrays import Point, Points
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.verification.plans import check_proposal
from llm_flock.protocol.verification.steps import shortened

TURNS = 72
"""Orientations tried to keep the places off bodies that stand still."""


def turned(points: Points, center: tuple[float, ...], angle_rad: float) -> Points:
    """A formation, shape (n, d), turned about its centre: in the plane, or about the third axis in space."""
    out = np.array(points, dtype=np.float64)
    out[:, :2] = formations.rotated(out[:, :2], center[:2], angle_rad)
    return out


def geometric_plan(question: PlanQuestion, angle_rad: float = 0.0) -> PlanAnswer | NoAnswer:
    """The ideal points in an orientation, the same every time, and the place with the robot's id (modulo the places).

    No answer for a shape in words: its points are unknown.
    """
    mission = question.mission
    if mission.ideal is None:
        return NoAnswer(cause="answer", reason=f"geometry knows no points for shape {mission.shape!r}")
    turns = (angle_rad + 2 * math.pi * k / TURNS for k in range(TURNS))
    plans = (Plan.of(turned(np.array(mission.ideal), mission.center, angle).tolist()) for angle in turns)
    plan = next(plans)
    if question.still:  # the first orientation with no place on a body that stands still
        free = (p for p in (plan, *plans) if check_proposal(mission, p, question.still) is None)
        plan = next(free, plan)
    return PlanAnswer(plan=plan, slot=question.robot % len(plan))


def straight_path(question: StepQuestion) -> StepAnswer:
    """Straight towards the goal, as far as the step limit allows, and on from there up to the horizon."""
    path = [_towards(question.position, question)]
    while len(path) < question.horizon and path[-1] != question.goal:
        path.append(_towards(path[-1], question))
    return StepAnswer(waypoint=path[0], path=tuple(path[1:]))


def _towards(position: Point, question: StepQuestion) -> Point:
    goal, max_step = question.goal, question.mission.max_step
    if math.dist(position, goal) <= max_step:
        return goal
    return shortened(position, goal, max_step)
