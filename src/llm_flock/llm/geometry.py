"""Planners without a language model: plain geometry, the baseline of comparisons, and the fallback to it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from llm_flock.protocol.geometry import geometric_plan, straight_path
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.verification.steps import clip_waypoint


class GeometryPlanner:
    """A `Planner` that knows the shape: the ideal points in some orientation, and straight steps to the goal.

    `rng` draws the orientation, as independent models choose different ones; None is the reference orientation.
    """

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        self._angle_rad = 0.0 if rng is None else float(rng.uniform(0.0, 2 * math.pi))

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """As `geometric_plan`."""
        return geometric_plan(question, self._angle_rad)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """As `straight_path`."""
        return straight_path(question)


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
