"""Answers by plain geometry, without a language model: the ideal points of the shape, and straight steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from llm_flock import shapes as formations
from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.plan import Drawing, Plan
from llm_flock.planner import NoAnswer, PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._verification.plans import check_proposal
from llm_flock.protocol._verification.steps import towards


def ideal_plan(mission: Mission, turn_rad: float, shift: Point = (0.0, 0.0)) -> Plan:
    """The ideal points turned and moved (`Mission.placed`). What a program draws is a plan that consists of it."""
    if not formations.is_drawn(mission.shape):
        return Plan.of(mission.placed(turn_rad, shift).tolist())
    from llm_flock.formation import program_of

    program = program_of(mission.shape)
    assert program is not None, "all shapes that are drawn are programs"
    center = tuple(c + d for c, d in zip(mission.center, (*shift, 0.0), strict=False))
    turn_rad += math.radians(mission.turn or 0.0)
    return Plan(drawing=Drawing(program.text, mission.n_places, mission.spacing, center, turn_rad=turn_rad))


def geometric_plan(question: PlanQuestion, angle_rad: float = 0.0) -> PlanAnswer | NoAnswer:
    """The ideal points, and the place with the robot's id (modulo the number of places). Deterministic.

    They are turned by `angle_rad`, or else to the first orientation from there, and the first small shift, that passes
    `check_proposal`. No answer for a shape given as text, whose points are unknown, or if nothing passes.
    """
    mission, reason = question.mission, ""
    if mission.ideal is None:
        return NoAnswer(cause="answer", reason=f"geometry knows no points for shape {mission.shape!r}")
    placements = mission.placements(angle_rad)
    if mission.velocity is not None:
        placements = [(angle_rad if mission.turn is None else 0.0, (0.0, 0.0))]
    for turn_rad, shift in placements:
        plan = ideal_plan(mission, turn_rad, shift)
        objection = check_proposal(mission, plan, question.still, question.position)
        if objection is None:
            return PlanAnswer(plan=plan, slot=question.robot % len(plan))
        reason = reason or objection
    why = f"the first was refused: {reason}" if reason else "obstacles are in the way of all of them"
    return NoAnswer(cause="answer", reason=f"geometry found no orientation and shift that fits; {why}")


def straight_path(question: StepQuestion) -> StepAnswer:
    """Straight towards the goal, as far as the step limit allows, and on from there up to the horizon."""
    goal, longest = question.goal, question.mission.max_step
    path = [towards(question.position, goal, longest)]
    while len(path) < question.horizon and path[-1] != goal:
        path.append(towards(path[-1], goal, longest))
    return StepAnswer(waypoint=path[0], path=tuple(path[1:]))


class GeometryPlanner:
    """A `Planner` that knows the shape, in the reference orientation or in one that `rng` draws, and flies straight."""

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        self._angle_rad = 0.0 if rng is None else float(rng.uniform(0.0, 2 * math.pi))

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        return geometric_plan(question, self._angle_rad)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        return straight_path(question)


def plan_by_geometry(question: PlanQuestion) -> PlanAnswer | NoAnswer:
    """As `geometric_plan`, for a planner whose model is not asked: the answer is marked as geometry's."""
    answer = geometric_plan(question)
    return replace(answer, by="geometry") if isinstance(answer, PlanAnswer) else answer


class KnownPlans:
    """A `Planner` whose model is asked only for the plans that it `knows`. Geometry answers the others."""

    def __init__(self, asking: Planner, knows: Callable[[PlanQuestion], bool]) -> None:
        self._asking = asking
        self._knows = knows

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        return await self._asking.plan(question) if self._knows(question) else plan_by_geometry(question)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        return await self._asking.step(question)
