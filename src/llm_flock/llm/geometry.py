"""Planners without a language model: plain geometry, the baseline of comparisons, and the fallback to it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from llm_flock import formations
from llm_flock.arrays import Point, Points
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.verification.plans import check_proposal
from llm_flock.protocol.verification.steps import clip_waypoint


def turned(points: Points, center: tuple[float, ...], angle_rad: float) -> Points:
    """A formation, shape (n, d), turned about its centre: in the plane, or about the third axis in space."""
    out = np.array(points, dtype=np.float64)
    out[:, :2] = formations.rotated(out[:, :2], center[:2], angle_rad)
    return out


TURNS = 72
"""Orientations tried to keep the places off bodies that stand still."""


class GeometryPlanner:
    """A `Planner` that knows the shape: the ideal points in some orientation, and straight steps to the goal.

    `rng` draws the orientation, as independent models choose different ones; None is the reference orientation.
    """

    def __init__(self, robot: int, rng: np.random.Generator | None = None) -> None:
        self._robot = robot
        self._angle_rad = 0.0 if rng is None else float(rng.uniform(0.0, 2 * math.pi))

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """The ideal points, the same every time, and the place with the robot's id (modulo the number of places).

        No answer for a shape in words: its points are unknown.
        """
        mission = question.mission
        if mission.ideal is None:
            return NoAnswer(cause="answer", reason=f"geometry knows no points for shape {mission.shape!r}")
        turns = (self._angle_rad + 2 * math.pi * k / TURNS for k in range(TURNS))
        plans = (Plan.of(turned(np.array(mission.ideal), mission.center, angle).tolist()) for angle in turns)
        plan = next(plans)
        if question.still:  # the first orientation with no place on a body that stands still
            free = (p for p in (plan, *plans) if check_proposal(mission, p, question.still) is None)
            plan = next(free, plan)
        return PlanAnswer(plan=plan, slot=self._robot % len(plan))

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Straight towards the goal, as far as the step limit allows, and on from there up to the horizon."""
        path = [self._towards(question.position, question)]
        while len(path) < question.horizon and path[-1] != question.goal:
            path.append(self._towards(path[-1], question))
        return StepAnswer(waypoint=path[0], path=tuple(path[1:]))

    def _towards(self, position: Point, question: StepQuestion) -> Point:
        goal, max_step = question.goal, question.mission.max_step
        distance = math.dist(position, goal)
        if distance <= max_step:
            return goal
        # A hair short of the limit, so that rounding cannot exceed it.
        share = max_step * (1 - 1e-12) / distance
        return tuple(x + share * (g - x) for x, g in zip(position, goal, strict=True))


class FallbackPlanner:
    """A `Planner` that asks a second one where the first gives up; `instead_of` of its answers holds the failure.

    A rejected waypoint that the shield can mend takes precedence: it is closer to what the model wanted.

    """

    def __init__(self, first: Planner, second: Planner, *, shield_on: bool) -> None:
        self._first = first
        self._second = second
        self._shield_on = shield_on

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """The first planner's plan, or the second's; the first one's failure if both fail."""
        answer = await self._first.plan(question)
        if isinstance(answer, PlanAnswer):
            return answer
        second = await self._second.plan(question)
        return replace(second, instead_of=answer) if isinstance(second, PlanAnswer) else answer

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """The first planner's waypoint, its failure if clipping can correct the last waypoint, or the second's."""
        answer = await self._first.step(question)
        if isinstance(answer, StepAnswer):
            return answer
        asked, shield_on = answer.waypoint, self._shield_on
        if asked is not None and clip_waypoint(question.mission, question, asked, shield_on=shield_on) is not None:
            return answer
        second = await self._second.step(question)
        return replace(second, instead_of=answer) if isinstance(second, StepAnswer) else answer
