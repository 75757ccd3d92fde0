"""Answers by plain geometry, without a language model: the ideal points of the shape, and straight steps."""

from __future__ import annotations

import math

import numpy as np

from llm_flock import formations
from llm_flock.arrays import Point, Points
from llm_flock.mission import Mission
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.verification.plans import check_proposal
from llm_flock.protocol.verification.steps import shortened


def turned(points: Points, center: tuple[float, ...], angle_rad: float) -> Points:
    """A formation, shape (n, d), turned about its centre: in the plane, or about the third axis in space."""
    out = np.array(points, dtype=np.float64)
    out[:, :2] = formations.rotated(out[:, :2], center[:2], angle_rad)
    return out


def geometric_plan(question: PlanQuestion, angle_rad: float = 0.0) -> PlanAnswer | NoAnswer:
    """The ideal points, and the place with the robot's id (modulo the places); the same answer every time.

    They are turned by `angle_rad`, or else to the first orientation from there, and the first small shift, that passes
    `check_proposal`. No answer for a shape in words, whose points are unknown, or if nothing passes.
    """
    mission, reason = question.mission, ""
    if mission.ideal is None:
        return NoAnswer(cause="answer", reason=f"geometry knows no points for shape {mission.shape!r}")
    placements = mission.placements(angle_rad) if mission.velocity is None else [_turned(mission, angle_rad)]
    for points in placements:
        plan = Plan.of(points.tolist())
        objection = check_proposal(mission, plan, question.still, question.position)
        if objection is None:
            return PlanAnswer(plan=plan, slot=question.robot % len(plan))
        reason = reason or objection
    why = f"the first was refused: {reason}" if reason else "obstacles are in the way of all of them"
    return NoAnswer(cause="answer", reason=f"geometry found no orientation and shift that fits; {why}")


def _turned(mission: Mission, angle_rad: float) -> Points:
    return turned(np.array(mission.ideal), mission.center, angle_rad)


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
