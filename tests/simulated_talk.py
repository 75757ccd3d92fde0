"""Conversations with the simulated model: questions of plans and steps in the words that robots use."""

from __future__ import annotations

import numpy as np

from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanQuestion, StepQuestion

TEXT, JSON = PromptSet.load(), PromptSet.load(json=True)
CIRCLE = build_mission(shape="circle", n_robots=10)
PLAN = Plan.of(CIRCLE.ideal or ())

Conversation = list[tuple[str, str]]


def plan_talk(mission: Mission = CIRCLE, robot: int = 3, prompts: PromptSet = TEXT) -> Conversation:
    question = PlanQuestion(mission=mission, robot=robot, round=1, position=mission.center, neighbors=())
    return [("system", prompts.system(mission)), ("user", prompts.plan(question))]


def step_talk(
    position: tuple[float, ...] = (20.0, 20.0),
    slot: int = 0,
    neighbors: tuple[tuple[float, ...], ...] = (),
    mission: Mission = CIRCLE,
    plan: Plan = PLAN,
    prompts: PromptSet = TEXT,
    horizon: int = 1,
) -> Conversation:
    question = StepQuestion(
        mission=mission,
        robot=3,
        round=1,
        position=position,
        neighbors=neighbors,
        plan=plan,
        slot=slot,
        horizon=horizon,
    )
    return [("system", prompts.system(mission)), ("user", prompts.step(question))]


def responder(profile: str = "ideal", seed: int = 0) -> SimulatedModel:
    return SimulatedModel(parse_profile(profile), np.random.default_rng(seed))
