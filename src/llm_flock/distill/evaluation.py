"""Measure a model's answers: as it gives them, and as they would be flown after the checks.

Questions are held out from training, and go through the frame, prompts and reader of a run. Each is asked once.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from llm_flock.arrays import Point
from llm_flock.distill.examples import HELD_OUT_TEAMS, draw_mission, draw_step
from llm_flock.llm.frame import FrameName, trained_for
from llm_flock.llm.models import ModelPool
from llm_flock.llm.planner import LanguagePlanner
from llm_flock.llm.port import LanguageModel
from llm_flock.llm.prompting import PromptSet
from llm_flock.protocol.planning import Answer, PlanAnswer, PlanQuestion, Question, StepAnswer, StepQuestion
from llm_flock.protocol.verification.plans import LENGTH_TOLERANCE, check_plan
from llm_flock.protocol.verification.steps import check_answer, clip_waypoint

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


def best_waypoint(question: StepQuestion) -> Point:
    """Straight towards the goal, as far as the step limit allows [units]."""
    here, goal, limit = question.position, question.goal, question.mission.max_step
    share = min(1.0, limit / max(math.dist(here, goal), 1e-12))
    return tuple(x + share * (g - x) for x, g in zip(here, goal, strict=True))


def score(question: StepQuestion, answer: Answer) -> MotionFigures:
    """Compare one answer with the best one. Other robots are left out: the shield takes care of them."""
    alone = replace(question, neighbors=())
    here, best = question.position, best_waypoint(question)
    if not isinstance(answer, StepAnswer):
        standing = math.dist(here, best)
        return MotionFigures(asked=1, parsed=0, within=0, passed=0, error=standing, shielded_error=standing)
    said = answer.waypoint
    flown = clip_waypoint(question.mission, alone, said, shield_on=True)
    return MotionFigures(
        asked=1,
        parsed=1,
        within=math.dist(here, said) <= question.mission.max_step * (1 + LENGTH_TOLERANCE),
        passed=check_answer(question.mission, alone, answer, shield_on=True) is None,
        error=math.dist(said, best),
        shielded_error=math.dist(here if flown is None else flown, best),
    )


def motion_figures(scores: Sequence[MotionFigures]) -> MotionFigures:
    """Shares and medians over at least one answer, each by itself in `scores`."""
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

    The model is named as in `--model`; prompts (a packaged set or a folder) and frame default to the model's own.
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

        return motion_figures(list(map(score, questions, asyncio.run(self._ask(questions)))))

    def plans(self, count: int) -> list[PlanFigures]:
        """Ask for `count` plans of each of `PLAN_TEAMS`, by robots in turn, at held-out centres and spacings."""
        out: list[PlanFigures] = []
        for shape, n in PLAN_TEAMS:
            rng = np.random.default_rng([self._seed, n])
            missions = [draw_mission(rng, "held-out", ((shape, (n,)),)) for _ in range(count)]
            questions = [
                PlanQuestion(mission=mission, robot=k % n, round=1, position=mission.center, neighbors=())
                for k, mission in enumerate(missions)
            ]
            passed = sum(
                isinstance(answer, PlanAnswer) and check_plan(mission, answer.plan) is None
                for mission, answer in zip(missions, asyncio.run(self._ask(questions)), strict=True)
            )
            out.append(PlanFigures(team=f"{shape} {n}", asked=count, passed=passed / count))
        return out

    async def _ask(self, questions: Sequence[Question]) -> list[Answer]:
        gate = asyncio.Semaphore(AT_ONCE)

        async def one(model: LanguageModel, question: Question) -> Answer:
            planner = LanguagePlanner(question.robot, model, self._prompts, max_retries=0, frame=self._frame)
            async with gate:
                return await (planner.plan(question) if isinstance(question, PlanQuestion) else planner.step(question))

        async with ModelPool() as pool:
            model = pool.model(self._text, robot=0, rng=np.random.default_rng(self._seed))
            return list(await asyncio.gather(*(one(model, question) for question in questions)))
