"""Another planner, usually plain geometry, where a language model gives no usable answer."""

from __future__ import annotations

from dataclasses import replace

from llm_flock.protocol.planning import NoAnswer, PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.verification.steps import mended


class FallbackPlanner:
    """A `Planner` that asks a second one where the first gives up; `instead_of` of its answers holds the failure.

    A rejected waypoint that the shield can mend takes precedence: it is closer to what the model wanted.

    Args:
        first: asked first.
        second: asked where `first` gives no answer.
        shield_on: whether the robot has a safety shield.
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
        """The first planner's waypoint, its failure if the shield can mend the last waypoint, or the second's."""
        answer = await self._first.step(question)
        if isinstance(answer, StepAnswer):
            return answer
        unfit = answer.waypoint
        if unfit is not None and mended(question.mission, question, unfit, shield_on=self._shield_on) is not None:
            return answer
        second = await self._second.step(question)
        return replace(second, instead_of=answer) if isinstance(second, StepAnswer) else answer
