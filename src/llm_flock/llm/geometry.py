"""A planner without a language model: plain geometry, the baseline of comparisons."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from llm_flock.protocol.geometry import geometric_plan, straight_path
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion


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


def plan_by_geometry(question: PlanQuestion) -> PlanAnswer | NoAnswer:
    """As `geometric_plan`, for a planner whose model is not asked: the answer says who made it."""
    answer = geometric_plan(question)
    return replace(answer, by="geometry") if isinstance(answer, PlanAnswer) else answer


class KnownPlans:
    """A `Planner` whose model is asked only for the plans that it `knows`. Others come from geometry, and say so."""

    def __init__(self, asking: Planner, knows: Callable[[PlanQuestion], bool]) -> None:
        self._asking = asking
        self._knows = knows

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """The model's plan where it knows one, else the shape in its reference orientation."""
        return await self._asking.plan(question) if self._knows(question) else plan_by_geometry(question)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """The model's answer."""
        return await self._asking.step(question)
