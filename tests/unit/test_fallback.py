"""Plain geometry in the place of a model that failed, and what it stands in for."""

from __future__ import annotations

import asyncio
from dataclasses import replace

from llm_flock.llm.geometry import FallbackPlanner, GeometryPlanner
from llm_flock.mission import Mission
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion

MISSION = Mission(shape="triangle", n_robots=3)
PLAN = Plan.of(MISSION.ideal or ())
ASK_PLAN = PlanQuestion(mission=MISSION, robot=0, round=1, position=(20.0, 20.0), neighbors=())
ASK_STEP = StepQuestion(mission=MISSION, robot=0, round=1, position=(20.0, 20.0), neighbors=(), plan=PLAN, slot=0)


class Always:
    """A planner that always says the same."""

    def __init__(self, plan: PlanAnswer | NoAnswer, step: StepAnswer | NoAnswer) -> None:
        self.answers = plan, step

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        return self.answers[0]

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        return self.answers[1]


def asked(
    plan: PlanAnswer | NoAnswer, step: StepAnswer | NoAnswer, mission: Mission = MISSION
) -> tuple[PlanAnswer | NoAnswer, StepAnswer | NoAnswer]:
    planner = FallbackPlanner(Always(plan, step), GeometryPlanner(), shield_on=True)
    return asyncio.run(planner.plan(replace(ASK_PLAN, mission=mission))), asyncio.run(planner.step(ASK_STEP))


def test_a_model_that_answers_is_left_alone() -> None:
    plan, step = PlanAnswer(plan=PLAN, slot=2), StepAnswer(waypoint=(21.0, 21.0))
    assert asked(plan, step) == (plan, step)


def test_geometry_stands_in_and_says_for_what() -> None:
    failure = NoAnswer(cause="answer", reason="no usable answer", waypoint=(14.0, 14.0))
    plan, step = asked(failure, failure)
    assert isinstance(plan, PlanAnswer) and plan.instead_of == failure and plan.plan == PLAN
    assert isinstance(step, StepAnswer) and step.instead_of == failure and step.waypoint > (23.0, 23.0)


def test_a_step_that_the_shield_can_mend_is_left_to_it() -> None:
    failure = NoAnswer(cause="answer", reason="too long", waypoint=(40.0, 40.0))
    assert asked(failure, failure)[1] == failure


def test_where_both_fail_the_models_failure_counts() -> None:
    failure = NoAnswer(cause="server", reason="500")
    words = Mission(shape="text:a cloud", n_robots=3)
    assert asked(failure, failure, words)[0] == failure
    planner = FallbackPlanner(Always(failure, failure), Always(failure, failure), shield_on=True)
    assert asyncio.run(planner.step(ASK_STEP)) == failure
