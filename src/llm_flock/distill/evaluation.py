"""Measure a model's answers: as it gives them, and as they would be flown after the checks.

Questions go through the frame, prompts and reader of a run. Each is asked once. Missions, positions and goals are drawn
apart from those of training, but the own frame removes much of that: every figure says how many prompts were taught.
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
from llm_flock.distill.taught import training_prompts
from llm_flock.llm.frame import frame_plan, frame_step
from llm_flock.llm.local.source import TAUGHT_PLANS
from llm_flock.llm.models import ModelPool
from llm_flock.llm.planner import LanguagePlanner
from llm_flock.llm.port import FrameName, LanguageModel
from llm_flock.llm.prompting import PromptSet
from llm_flock.llm.sources import habits_of
from llm_flock.protocol.planning import Answer, PlanAnswer, PlanQuestion, Question, StepAnswer, StepQuestion
from llm_flock.protocol.verification.plans import LENGTH_TOLERANCE, check_plan
from llm_flock.protocol.verification.steps import judge

OTHER_TEAMS: tuple[tuple[str, int], ...] = (
    *(("line", n) for n in (3, 5, 8)),
    *(("triangle", n) for n in (6, 9)),
    *(("square", n) for n in (8, 12)),
    *(("circle", n) for n in (3, 4, 6, 8, 12)),
    *(("polygon:5", n) for n in (5, 10)),
    ("polygon:6", 6),
    *(("cross", n) for n in (9, 13)),
    *(("wedge", n) for n in (3, 5, 7)),
    *(("grid", n) for n in (4, 6, 9)),
    *(("star", n) for n in (10, 20)),
)
"""Teams whose plans are not taught."""

FAR = ((14.0, 20.0), (20.0, 25.0), (25.0, 30.0))
"""Distances of goals that are farther than any that is taught, in bands [step limits]."""

AT_ONCE = 4
"""Questions asked at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFigures:
    """Results of questions for the next waypoint.

    Attributes:
        asked: number of questions.
        taught: number of questions whose prompt the recipe teaches (`distill.taught`).
        parsed: share of readable answers.
        within: share of waypoints within the step limit, up to the tolerance of the checks.
        passed: share that passes all checks of a run; other robots count only where they stand in the way.
        degrees: median angle between the step and the way to the goal, None where no answer moves [degrees].
        error: median distance to the best waypoint; unreadable answers count as staying [units].
        shielded_error: the same after clipping; answers that cannot be clipped count as staying [units].
    """

    asked: int
    taught: int = 0
    parsed: float
    within: float
    passed: float
    degrees: float | None = None
    error: float
    shielded_error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFigures:
    """Results of questions for a plan of one shape and size.

    Attributes:
        asked: number of questions.
        distinct: number of different prompts among them.
        taught: number of these different prompts that the recipe teaches (`distill.taught`).
        passed: share of the questions whose answer passes.
    """

    team: str
    asked: int
    distinct: int
    taught: int
    passed: float


def best_waypoint(question: StepQuestion) -> Point:
    """Straight towards the goal, as far as the step limit allows [units]."""
    here, goal, limit = question.position, question.goal, question.mission.max_step
    share = min(1.0, limit / max(math.dist(here, goal), 1e-12))
    return tuple(x + share * (g - x) for x, g in zip(here, goal, strict=True))


def score(question: StepQuestion, answer: Answer, *, in_the_way: bool = False) -> MotionFigures:
    """Compare one answer with the best one.

    Other robots are left out, because the shield takes care of them, but for questions about robots `in_the_way`.
    """
    judged = question if in_the_way else replace(question, neighbors=())
    here, best = question.position, best_waypoint(question)
    if not isinstance(answer, StepAnswer):
        standing = math.dist(here, best)
        return MotionFigures(asked=1, parsed=0, within=0, passed=0, error=standing, shielded_error=standing)
    said = answer.waypoint
    verdict = judge(judged, answer, shield_on=True)
    return MotionFigures(
        asked=1,
        parsed=1,
        within=math.dist(here, said) <= question.mission.max_step * (1 + LENGTH_TOLERANCE),
        passed=verdict.reason is None,
        degrees=_degrees(here, said, question.goal),
        error=math.dist(said, best),
        shielded_error=math.dist(here if verdict.fit is None else verdict.fit.waypoint, best),
    )


def _degrees(here: Point, said: Point, goal: Point) -> float | None:
    """Angle between two ways from a point; None where one of them has no length."""
    moved, way = math.dist(here, said), math.dist(here, goal)
    if moved == 0.0 or way == 0.0:
        return None
    cosine = sum((p - x) * (g - x) for x, p, g in zip(here, said, goal, strict=True)) / (moved * way)
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def motion_figures(scores: Sequence[MotionFigures]) -> MotionFigures:
    """Shares and medians over at least one answer, each by itself in `scores`."""
    n = len(scores)
    degrees = [s.degrees for s in scores if s.degrees is not None]
    return MotionFigures(
        asked=n,
        parsed=sum(s.parsed for s in scores) / n,
        within=sum(s.within for s in scores) / n,
        passed=sum(s.passed for s in scores) / n,
        degrees=median(degrees) if degrees else None,
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
        habits = habits_of(model)
        self._text = model
        self._prompts = PromptSet.load(prompts or habits.prompts)
        self._frame: FrameName = frame or habits.frame
        self._seed = seed

    def steps(self, count: int, horizon: int) -> MotionFigures:
        """Ask for `count` steps, or for paths where `horizon` is more than 1."""
        return self._motion(self._drawn_steps(count, horizon))

    def repeated(self, count: int) -> MotionFigures:
        """The figures of `steps(count, 1)` for a program that only repeats the goal: what frame and checks do alone."""
        questions = self._drawn_steps(count, 1)
        return self._figures(questions, [StepAnswer(waypoint=question.goal) for question in questions])

    def far_steps(self, count: int) -> dict[str, MotionFigures]:
        """Ask for `count` steps to goals in each band of `FAR`, with nobody around; by `far 14 to 20` and so on."""
        rng = np.random.default_rng([self._seed, 2])
        bands = {f"far {low:g} to {high:g}": [far_step(rng, low, high) for _ in range(count)] for low, high in FAR}
        return {name: self._motion(questions) for name, questions in bands.items()}

    def blocked_steps(self, count: int) -> MotionFigures:
        """Ask for `count` steps where another robot stands at the end of the straight one, which is no answer then."""
        rng = np.random.default_rng([self._seed, 3])
        return self._motion([blocked_step(rng) for _ in range(count)], in_the_way=True)

    def plans(self, count: int, teams: Sequence[tuple[str, int]] = TAUGHT_PLANS) -> list[PlanFigures]:
        """Ask for `count` plans of each team, by robots in turn, at held-out centres and spacings."""
        out: list[PlanFigures] = []
        prompts = self.prompts_of_plans(count, teams)
        for shape, n in teams:
            questions = self._plan_questions(shape, n, count)
            passed = sum(
                isinstance(answer, PlanAnswer) and check_plan(question.mission, answer.plan) is None
                for question, answer in zip(questions, asyncio.run(self._ask(questions)), strict=True)
            )
            different, taught = prompts[f"{shape} {n}"]
            figures = PlanFigures(
                team=f"{shape} {n}", asked=count, distinct=len(different), taught=taught, passed=passed / count
            )
            out.append(figures)
        return out

    def prompts_of_plans(
        self, count: int, teams: Sequence[tuple[str, int]] = TAUGHT_PLANS
    ) -> dict[str, tuple[frozenset[tuple[str, str]], int]]:
        """The different prompts of `plans`, by team, and how many of them the recipe teaches. Asks nothing."""
        found: dict[str, tuple[frozenset[tuple[str, str]], int]] = {}
        for shape, n in teams:
            different = frozenset(map(self._prompt, self._plan_questions(shape, n, count)))
            found[f"{shape} {n}"] = different, len(different & training_prompts())
        return found

    def _plan_questions(self, shape: str, n: int, count: int) -> list[PlanQuestion]:
        rng = np.random.default_rng([self._seed, n])
        missions = [draw_mission(rng, "held-out", ((shape, (n,)),)) for _ in range(count)]
        return [
            PlanQuestion(mission=mission, robot=k % n, round=1, position=mission.center, neighbors=())
            for k, mission in enumerate(missions)
        ]

    def _drawn_steps(self, count: int, horizon: int) -> list[StepQuestion]:
        rng = np.random.default_rng([self._seed, horizon])
        questions: list[StepQuestion] = []
        while len(questions) < count:
            question = draw_step(rng, draw_mission(rng, "held-out", HELD_OUT_TEAMS))
            if (question.horizon > 1) == (horizon > 1):
                questions.append(question)
        return questions

    def _motion(self, questions: Sequence[StepQuestion], *, in_the_way: bool = False) -> MotionFigures:
        return self._figures(questions, asyncio.run(self._ask(questions)), in_the_way=in_the_way)

    def _figures(
        self, questions: Sequence[StepQuestion], answers: Sequence[Answer], *, in_the_way: bool = False
    ) -> MotionFigures:
        scores = [score(q, answer, in_the_way=in_the_way) for q, answer in zip(questions, answers, strict=True)]
        taught = sum(self._prompt(question) in training_prompts() for question in questions)
        return replace(motion_figures(scores), taught=taught)

    def _prompt(self, question: PlanQuestion | StepQuestion) -> tuple[str, str]:
        """System and user message of a question, as the model sees them."""
        if isinstance(question, PlanQuestion):
            plan = frame_plan(question, self._frame).framed
            return self._prompts.system(plan.mission), self._prompts.plan(plan)
        step = frame_step(question, self._frame).framed
        return self._prompts.system(step.mission), self._prompts.step(step)

    async def _ask(self, questions: Sequence[Question]) -> list[Answer]:
        gate = asyncio.Semaphore(AT_ONCE)

        async def one(model: LanguageModel, question: Question) -> Answer:
            planner = LanguagePlanner(question.robot, model, self._prompts, max_retries=0, frame=self._frame)
            async with gate:
                return await (planner.plan(question) if isinstance(question, PlanQuestion) else planner.step(question))

        async with ModelPool() as pool:
            model = pool.model(self._text, rng=np.random.default_rng(self._seed))
            return list(await asyncio.gather(*(one(model, question) for question in questions)))


def far_step(rng: np.random.Generator, low: float, high: float) -> StepQuestion:
    """A held-out step to a goal from `low` to `high` step limits away."""
    question = draw_step(rng, draw_mission(rng, "held-out", HELD_OUT_TEAMS))
    distance, angle = rng.uniform(low, high) * question.mission.max_step, rng.uniform(0.0, 2 * math.pi)
    x, y = question.goal
    here = x + distance * math.cos(angle), y + distance * math.sin(angle)
    return replace(question, position=here, neighbors=(), horizon=1)


def blocked_step(rng: np.random.Generator) -> StepQuestion:
    """A held-out step, to a goal out of reach, whose straight end is within the safe distance of another robot."""
    while True:
        question = draw_step(rng, draw_mission(rng, "held-out", HELD_OUT_TEAMS))
        end, safe = best_waypoint(question), question.mission.safe_distance
        angle, gap = rng.uniform(0.0, 2 * math.pi), rng.uniform(0.0, 0.6) * safe
        other = end[0] + gap * math.cos(angle), end[1] + gap * math.sin(angle)
        far = math.dist(question.position, question.goal) > 1.2 * question.mission.max_step
        if far and math.dist(question.position, other) > 1.05 * safe:
            return replace(question, neighbors=(other,), horizon=1)
