"""Which plans the model on board is asked for, in a run and when that is replayed; and how goals far away are named."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from llm_flock.llm._frame import frame_step
from llm_flock.llm._port import Attempt, Call, ChatMessage, Reply
from llm_flock.llm._prompt_values import FARTHEST, nearer_goal
from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._providers import Habits, habits_of
from llm_flock.llm._replay import CassetteWriter
from llm_flock.mission import build_mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._geometry import KnownPlans
from llm_flock.runtime._config import build_config
from llm_flock.runtime._planners import TeamPlanners
from llm_flock_onboard._local.source import is_asked, is_taught

SAID = PlanAnswer(plan=Plan.of([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]), slot=2)


def asked(shape: str, n: int, round: int = 1, **changes: Any) -> PlanQuestion:
    mission = build_mission(shape=shape, n_robots=n, **changes.pop("fields", {}))
    return PlanQuestion(mission=mission, robot=0, round=round, position=(50.0, 50.0), neighbors=(), **changes)


class Saying:
    """A planner that always has the same answers."""

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        return SAID

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        return StepAnswer(waypoint=(1.0, 2.0))


@pytest.mark.parametrize(("shape", "n"), [("triangle", 3), ("circle", 7), ("star", 10), ("text:a heart", 5)])
def test_the_model_is_asked_for_shapes_to_draw(shape: str, n: int) -> None:
    question = asked(shape, n)
    assert is_asked(question) and asyncio.run(KnownPlans(Saying(), is_asked).plan(question)) is SAID


@pytest.mark.parametrize(
    "question",
    [
        asked("letters:L", 6),
        asked("sphere", 6, fields={"center": (50.0, 50.0, 50.0), "arena": ((0.0,) * 3, (100.0,) * 3)}),
        asked("circle", 5, still=((80.0, 80.0),)),
        asked("circle", 5, fields={"obstacles": [{"center": [80, 80], "radius": 2}]}),
    ],
)
def test_plans_left_to_code_are_marked(question: PlanQuestion) -> None:
    answer = asyncio.run(KnownPlans(Saying(), is_asked).plan(question))
    assert isinstance(answer, PlanAnswer) and answer.by == "geometry"
    assert len(answer.plan) == question.mission.n_places


@pytest.mark.parametrize(("shape", "n", "taught"), [("circle", 5, True), ("circle", 7, False), ("star", 10, False)])
def test_it_is_known_which_plans_were_taught(shape: str, n: int, taught: bool) -> None:
    assert is_taught(build_mission(shape=shape, n_robots=n)) == taught


def test_described_shape_has_no_plan_by_geometry() -> None:
    question = asked("text:a heart", 5, still=((80.0, 80.0),))
    assert isinstance(asyncio.run(KnownPlans(Saying(), is_asked).plan(question)), NoAnswer)


@pytest.mark.parametrize(("model", "by"), [("local:smollm2", "geometry"), ("openai:o3-mini", None)])
def test_a_replay_asks_for_the_plans_that_were_asked_for(tmp_path: Path, model: str, by: str | None) -> None:
    """Round 1 has a plan of the model's, round 2 has none: the run's plan came from geometry there."""
    question, later = asked("star", 10), asked("star", 10, round=2)
    messages = (ChatMessage("system", "Be brief."), ChatMessage("user", "A plan, please."))
    call = Call(robot=0, round=1, kind="plan", attempt=0, messages=messages, schema=None)
    with CassetteWriter(tmp_path / "run.jsonl") as writer:
        writer(Attempt(call=call, reply=Reply(text="none", model=model)))
    planners = TeamPlanners(build_config(model=f"replay:{tmp_path / 'run.jsonl'}", shape="star", n_robots=10))

    async def replay() -> list[PlanAnswer | NoAnswer | Exception]:
        answers = await asyncio.gather(planners[0].plan(question), planners[0].plan(later), return_exceptions=True)
        await planners.close()
        return answers  # type: ignore[return-value]

    first, second = asyncio.run(replay())
    assert isinstance(first, Exception), "the recorded question was another one"
    assert getattr(second, "by", None) == by


def test_brief_prompts_name_a_nearer_goal_in_the_same_direction() -> None:
    rng = np.random.default_rng(0)
    for max_step in (0.05, 1.0, 6.0, 300.0):
        for distance in (0.5, 9.9, 10.1, 35.0, 100.0):
            here, angle = (float(rng.uniform(-9, 9)), float(rng.uniform(-9, 9))), rng.uniform(0, 2 * math.pi)
            far = distance * max_step
            goal = here[0] + far * math.cos(angle), here[1] + far * math.sin(angle)
            near = nearer_goal(here, goal, max_step)
            if distance <= FARTHEST:
                assert near == goal
                continue
            ahead = tuple((x - h) / max_step for x, h in zip(near, here, strict=True))
            assert math.dist(ahead, (FARTHEST * math.cos(angle), FARTHEST * math.sin(angle))) < 0.1


def test_own_frame_prompt_has_few_digits_for_a_far_goal() -> None:
    mission = build_mission(shape="triangle", n_robots=3, arena=[[0, 0], [400, 400]], center=(300.0, 300.0))
    plan = Plan.of(mission.ideal or ())
    question = StepQuestion(
        mission=mission, robot=0, round=1, position=(20.0, 20.0), neighbors=(), plan=plan, slot=0, target=(320.0, 220.0)
    )
    brief = PromptSet.load("brief")
    assert "Goal: [1000, 0]" in brief.step(frame_step(question, "own").framed)
    near = replace(question, target=(26.0, 29.0))
    assert "Goal: [180, 0]" in brief.step(frame_step(near, "own").framed)
    assert "[320.0, 220.0]" in PromptSet.load("full").step(question)


def test_models_that_are_trained_for_it() -> None:
    assert habits_of("local:smollm2").frame == habits_of("local:smollm2+none").frame == "own"
    assert habits_of("local:/models/smollm2.gguf") == habits_of("openai:o3-mini") == Habits()
