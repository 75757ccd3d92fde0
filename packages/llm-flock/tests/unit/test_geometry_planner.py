"""The baseline without a language model."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest

from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._geometry import GeometryPlanner, KnownPlans
from llm_flock.shapes import rotated

CIRCLE = build_mission(shape="circle", n_robots=10)


def plan_of(planner: GeometryPlanner, mission: Mission = CIRCLE, robot: int = 3) -> PlanAnswer:
    question = PlanQuestion(mission=mission, robot=robot, round=1, position=(0.0, 0.0), neighbors=())
    answer = asyncio.run(planner.plan(question))
    assert isinstance(answer, PlanAnswer)
    return answer


def step_of(mission: Mission, position: tuple[float, ...], goal: tuple[float, ...]) -> tuple[float, ...]:
    question = StepQuestion(
        mission=mission, robot=3, round=1, position=position, neighbors=(), plan=Plan.of([goal]), slot=0
    )
    answer = asyncio.run(GeometryPlanner().step(question))
    assert isinstance(answer, StepAnswer)
    return answer.waypoint


def test_without_chance_the_plan_is_the_reference_orientation() -> None:
    answer = plan_of(GeometryPlanner())
    assert answer.slot == 3
    np.testing.assert_allclose(answer.plan.array, np.array(CIRCLE.ideal), atol=1e-6)


def test_chance_turns_the_plan_about_centre_seed_repeats_it() -> None:
    plans = [plan_of(GeometryPlanner(np.random.default_rng(seed))).plan for seed in (1, 1, 2)]
    assert plans[0] == plans[1] != plans[2]
    radii = np.linalg.norm(plans[2].array - CIRCLE.center, axis=1)
    np.testing.assert_allclose(radii, radii[0], atol=1e-5)
    planner = GeometryPlanner(np.random.default_rng(1))
    assert plan_of(planner) == plan_of(planner)


def test_geometry_has_no_points_for_a_described_shape() -> None:
    words = build_mission(shape="text:a cloud", n_robots=4)
    question = PlanQuestion(mission=words, robot=0, round=1, position=(0.0, 0.0), neighbors=())
    answer = asyncio.run(GeometryPlanner().plan(question))
    assert isinstance(answer, NoAnswer) and "a cloud" in answer.reason


def test_steps_go_straight_and_end_at_the_goal() -> None:
    assert step_of(CIRCLE, (0.0, 0.0), (3.0, 4.0)) == (3.0, 4.0)
    waypoint = step_of(CIRCLE, (10.0, 20.0), (40.0, 60.0))
    np.testing.assert_allclose(waypoint, (13.6, 24.8), atol=1e-9)
    assert math.dist(waypoint, (10.0, 20.0)) <= CIRCLE.max_step


def test_a_path_goes_straight_on_until_the_goal_or_the_horizon() -> None:
    mission = build_mission(shape="triangle", n_robots=3)
    plan = Plan.of([(20.0, 0.0), (90.0, 90.0), (80.0, 80.0)])
    here = (0.0, 0.0)
    question = StepQuestion(
        mission=mission, robot=0, round=1, position=here, neighbors=(), plan=plan, slot=0, horizon=9
    )
    answer = asyncio.run(GeometryPlanner().step(question))
    assert isinstance(answer, StepAnswer)
    assert [answer.waypoint, *answer.path] == [
        pytest.approx(x) for x in ((6.0, 0.0), (12.0, 0.0), (18.0, 0.0), (20.0, 0.0))
    ]
    assert answer.path[-1] == plan.points[0]
    short = asyncio.run(GeometryPlanner().step(replace(question, horizon=2)))
    assert isinstance(short, StepAnswer) and len(short.path) == 1


def test_in_space_a_formation_turns_about_the_third_axis() -> None:
    points = np.array([[6.0, 5.0, 2.0], [4.0, 5.0, 8.0]])
    np.testing.assert_allclose(rotated(points, (5, 5, 5), math.pi / 2), [[5, 6, 2], [5, 4, 8]], atol=1e-12)
    assert points[0, 0] == 6.0
    mission = build_mission(points=points.tolist(), center=(5, 5, 5), arena=((0, 0, 0), (20, 20, 20)), spacing=4)
    plan = plan_of(GeometryPlanner(np.random.default_rng(0)), mission).plan
    assert math.isclose(math.dist(*plan.points), math.sqrt(40), abs_tol=1e-5)
    waypoint = step_of(mission, (0.0, 0.0, 0.0), (0.0, 0.0, 10.0))
    assert waypoint == pytest.approx((0, 0, 6))


def test_question_sets_place_count_and_centre_spares_count_on() -> None:
    planner = GeometryPlanner()
    spares = plan_of(planner, CIRCLE.change(places=8, center=(40, 45)), robot=9)
    assert len(spares.plan) == 8 and spares.slot == 1
    np.testing.assert_allclose(spares.plan.array.mean(axis=0), (40, 45), atol=1e-6)
    assert len(plan_of(planner, CIRCLE.change(places=12)).plan) == 12


@pytest.mark.parametrize("known", [True, False])
def test_a_planner_of_known_plans_is_asked_for_those_alone(known: bool) -> None:
    planner = KnownPlans(GeometryPlanner(np.random.default_rng(1)), lambda question: known)
    question = PlanQuestion(mission=CIRCLE, robot=3, round=1, position=(0.0, 0.0), neighbors=())
    answer = asyncio.run(planner.plan(question))
    assert isinstance(answer, PlanAnswer)
    assert (answer.by == "geometry") is not known
    step = StepQuestion(mission=CIRCLE, robot=3, round=1, position=(0.0, 0.0), neighbors=(), plan=answer.plan, slot=0)
    assert asyncio.run(planner.step(step)) == asyncio.run(GeometryPlanner().step(step))
