"""Measure a model's answers: as it gives them, and as they would be flown after the checks.

Questions are held out from training, and go through the frame, prompts and reader of a run. Each is asked once.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import TypeVar

import numpy as np

from llm_flock.arrays import Point
from llm_flock.distill.examples import HELD_OUT_TEAMS, draw_mission, draw_step
from llm_flock.llm.frame import FrameName, trained_for
from llm_flock.llm.models import ModelPool
from llm_flock.llm.planner import LanguagePlanner
from llm_flock.llm.port import LanguageModel
from llm_flock.llm.prompting import PromptSet
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.verification.plans import LENGTH_TOLERANCE, check_plan
from llm_flock.protocol.verification.steps import check_answer, clip_waypoint

Q = TypeVar("Q", PlanQuestion, StepQuestion)
T = TypeVar("T")

PLAN_TEAMS = (("triangle", 3), ("square", 4), ("cross", 5), ("circle", 5), ("circle", 10))
"""Shapes and sizes of the questions for a plan."""

AT_ONCE = 4
"""Questions asked at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFigures:
    """Results of questions for the next waypoint.

    Attributes:
        asked: number of questions.
        parsed: share of readable answers.
        within: share of waypoints within the step limit, up to the tolerance of the checks.
        passed: share that passes all checks of a run, other robots aside.
        error: median distance to the best waypoint; unreadable answers count as staying [units].
        shielded_error: the same after clipping; answers that cannot be clipped count as staying [units].
    """

    asked: int
    parsed: float
    within: float
    passed: float
    error: float
    shielded_error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFigures:
    """Results of questions for a plan of one shape and size: number asked, and share that passes."""

    team: str
    asked: int
    passed: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WaypointScore:
    """One answer, in the terms of `MotionFigures`."""

    parsed: bool
    within: bool
    passed: bool
    error: float
    shielded_error: float


def best_waypoint(question: StepQuestion) -> Point:
    """Straight towards the goal, as far as the step limit allows [units]."""
    here, goal, limit = question.position, question.goal, question.mission.max_step
    share = min(1.0, limit / max(math.dist(here, goal), 1e-12))
    return tuple(x + share * (g - x) for x, g in zip(here, goal, strict=True))


def score(question: StepQuestion, answer: StepAnswer | NoAnswer) -> WaypointScore:
    """Compare an answer with the best one. Other robots are left out: the shield takes care of them."""
    alone = replace(question, neighbors=())
    here, best = question.position, best_waypoint(question)
    if isinstance(answer, NoAnswer):
        standing = math.dist(here, best)
        return WaypointScore(parsed=False, within=False, passed=False, error=standing, shielded_error=standing)
    said = answer.waypoint
    flown = clip_waypoint(question.mission, alone, said, shield_on=True)
    return WaypointScore(
        parsed=True,
        within=math.dist(here, said) <= question.mission.max_step * (1 + LENGTH_TOLERANCE),
        passed=check_answer(question.mission, alone, answer, shield_on=True) is None,
        error=math.dist(said, best),
        shielded_error=math.dist(here if flown is None else flown, best),
    )


def motion_figures(scores: Sequence[WaypointScore]) -> MotionFigures:
    """Shares and medians over at least one answer."""
    n = len(scores)
    return MotionFigures(
        asked=n,
        parsed=sum(s.parsed for s in scores) / n,
        within=sum(s.within for s in scores) / n,
        passed=sum(s.passed for s in scores) / n,
        error=median(s.error for s in scores),
        shielded_error=median(s.shielded_error for s in scores),
    )


class Evaluator:
    """Asks one model held-out questions.

    Args:
        model: the model as `--model` names it.
        prompts: a packaged set or a folder; None is the model's default.
        frame: coordinates; None is the model's default.
        seed: of the questions.
    """

    def __init__(
        self, model: str, *, prompts: str | None = None, frame: FrameName | None = None, seed: int = 0
    ) -> None:
        own = trained_for(model)
        self._text = model
        self._prompts = PromptSet.load(prompts or ("brief" if own else "full"))
        self._frame: FrameName = frame or ("own" if own else "world")
        self._seed = seed

    def steps(self, count: int, horizon: int) -> MotionFigures:
        """Ask for `count` steps, or for paths where `horizon` is more than 1."""
        rng = np.random.default_rng([self._seed, horizon])
        questions: list[StepQuestion] = []
        while len(questions) < count:
            question = draw_step(rng, draw_mission(rng, "held-out", HELD_OUT_TEAMS))
            if (question.horizon > 1) == (horizon > 1):
                questions.append(question)

        async def ask(planner: LanguagePlanner, question: StepQuestion) -> WaypointScore:
            return score(question, await planner.step(question))

        return motion_figures(asyncio.run(self._all(questions, ask)))

    def plans(self, count: int) -> list[PlanFigures]:
        """Ask for `count` plans of each of `PLAN_TEAMS`, by robots in turn, at held-out centres and spacings."""
        out: list[PlanFigures] = []
        for shape, n in PLAN_TEAMS:
            rng = np.random.default_rng([self._seed, n])
            questions = [
                PlanQuestion(mission=mission, robot=k % n, round=1, position=mission.center, neighbors=())
                for k, mission in enumerate(draw_mission(rng, "held-out", ((shape, (n,)),)) for _ in range(count))
            ]

            async def ask(planner: LanguagePlanner, question: PlanQuestion) -> bool:
                answer = await planner.plan(question)
                return isinstance(answer, PlanAnswer) and check_plan(question.mission, answer.plan) is None

            passed = asyncio.run(self._all(questions, ask))
            out.append(PlanFigures(team=f"{shape} {n}", asked=count, passed=sum(passed) / count))
        return out

    async def _all(self, questions: Sequence[Q], ask: Callable[[LanguagePlanner, Q], Awaitable[T]]) -> list[T]:
        gate = asyncio.Semaphore(AT_ONCE)

        async def one(model: LanguageModel, question: Q) -> T:
            planner = LanguagePlanner(question.robot, model, self._prompts, max_retries=0, frame=self._frame)
            async with gate:
                return await ask(planner, question)

        async with ModelPool() as pool:
            model = pool.model(self._text, robot=0, rng=np.random.default_rng(self._seed))
            return list(await asyncio.gather(*(one(model, question) for question in questions)))
