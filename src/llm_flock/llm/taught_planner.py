"""Which plans the model on board is asked for: its adapter was taught those of a few teams."""

from __future__ import annotations

from collections.abc import Callable

from llm_flock.llm.geometry import plan_by_geometry
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion

TAUGHT_PLANS = (("triangle", 3), ("square", 4), ("cross", 5), ("circle", 5), ("circle", 10))
"""Shapes and numbers of places of the plans that the packaged adapter was taught."""


def is_taught(question: PlanQuestion) -> bool:
    """Whether the packaged adapter was taught to plan this: one of the taught teams, with nothing in the way."""
    mission = question.mission
    return (mission.shape, mission.n_places) in TAUGHT_PLANS and not mission.obstacles and not question.still


class TaughtPlanner:
    """A `Planner` for `local:smollm2`: its model is asked for the plans that it `knows`, by default what it was taught.

    Other plans come from geometry, and say so: of 25 untaught teams the model gets one right.
    """

    def __init__(self, asking: Planner, knows: Callable[[PlanQuestion], bool] = is_taught) -> None:
        self._asking = asking
        self._knows = knows

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """The model's plan where it knows one, else the shape in its reference orientation, by geometry."""
        return await self._asking.plan(question) if self._knows(question) else plan_by_geometry(question)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """The model's answer."""
        return await self._asking.step(question)
