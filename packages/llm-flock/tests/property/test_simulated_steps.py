"""Steps of an ideal stand-in keep the limit from the true position, not only from the position in the question."""

from __future__ import annotations

import math

import numpy as np
from answer_readers import parse_step
from hypothesis import assume, given
from hypothesis import strategies as st

from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.mission import build_mission
from llm_flock.plan import Plan
from llm_flock.planner import StepQuestion

PROMPTS = PromptSet.load()
inside = st.floats(-100, 100)
lengths = st.floats(0.01, 30)


@given(
    st.integers(2, 3).flatmap(
        lambda dim: st.tuples(*[st.tuples(*[inside] * dim)] * 2)
    ),
    lengths,
    st.sampled_from(["ideal", "overshoot"]),
)  # fmt: skip
def test_no_step_exceeds_the_limit_near_goals_are_met_exactly(
    points: tuple[tuple[float, ...], tuple[float, ...]], max_step: float, profile: str
) -> None:
    position, target = points
    dim = len(position)
    mission = build_mission(
        points=(target,), center=(0.0,) * dim, arena=((-100.0,) * dim, (100.0,) * dim), max_step=max_step
    )
    plan = Plan.of([target])
    question = StepQuestion(mission=mission, robot=0, round=1, position=position, neighbors=(), plan=plan, slot=0)
    model = SimulatedModel(parse_profile(profile), np.random.default_rng(0))
    text = model.answer([("system", PROMPTS.system(mission)), ("user", PROMPTS.step(question))])
    waypoint = parse_step(text, dim)
    step, distance = math.dist(position, waypoint), math.dist(position, plan.points[0])
    assert step <= max_step
    if profile == "ideal" and distance <= 0.99 * max_step:
        assert waypoint == plan.points[0]
    else:
        assume(distance > 0.01 * max_step)
        assert step > 0.95 * max_step
