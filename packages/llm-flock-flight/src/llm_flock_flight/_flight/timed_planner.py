"""Limits how long a flight waits for its models, and for how many rounds without an answer."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from llm_flock.planner import NoAnswer, PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion

T = TypeVar("T")


class TimedPlanner:
    """A planner whose answers come within `longest_s`; calls `on_silence` after `most` rounds in a row without any."""

    def __init__(self, planner: Planner, longest_s: float, most: int | None, on_silence: Callable[[], None]) -> None:
        self._planner = planner
        self._longest_s = longest_s
        self._most = most
        self._on_silence = on_silence
        self._silent: set[int] = set()

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        return await self._in_time(question.round, self._planner.plan(question))

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        return await self._in_time(question.round, self._planner.step(question))

    async def _in_time(self, number: int, answer: Awaitable[T | NoAnswer]) -> T | NoAnswer:
        try:
            async with asyncio.timeout(self._longest_s):
                found = await answer
        except TimeoutError:
            found = NoAnswer(cause="timeout", reason=f"no answer within {self._longest_s:g} s")
        if not isinstance(found, NoAnswer) or found.cause == "answer":
            self._silent.clear()
            return found
        self._silent.add(number)
        if self._most is not None and len(self._silent) >= self._most:
            self._on_silence()
        return found
