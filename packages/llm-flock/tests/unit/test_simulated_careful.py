"""Simulated models that look where they go, and one that answers by chance."""

from __future__ import annotations

import math

from answer_readers import parse_plan, parse_step
from simulated_talk import CIRCLE, PLAN, TEXT, plan_talk, responder, step_talk

from llm_flock.planner import PlanQuestion
from llm_flock.protocol._verification.plans import check_plan


def test_careful_model_steps_aside_only_if_necessary() -> None:
    goal = PLAN.points[0]
    straight = parse_step(responder().answer(step_talk()), 2)
    beside = step_talk(neighbors=((straight[0] + CIRCLE.safe_distance + 0.1, straight[1]),))
    assert parse_step(responder("careful").answer(beside), 2) == straight
    ahead = step_talk(neighbors=((straight[0] + 0.5, straight[1] - 0.5),))
    assert parse_step(responder().answer(ahead), 2) == straight, "an ideal one walks straight"
    aside = parse_step(responder("careful").answer(ahead), 2)
    assert math.dist(aside, (straight[0] + 0.5, straight[1] - 0.5)) >= CIRCLE.safe_distance
    assert math.dist(aside, goal) < math.dist((20.0, 20.0), goal)
    assert 0 < math.dist(aside, (20.0, 20.0)) <= CIRCLE.max_step


def test_a_careful_model_among_robots_on_all_sides_waits() -> None:
    crowd = tuple((20.0 + 3 * x, 20.0 + 3 * y) for x in range(-3, 4) for y in range(-3, 4) if x or y)
    assert parse_step(responder("careful").answer(step_talk(neighbors=crowd)), 2) == (20.0, 20.0)


def test_careful_model_turns_its_plan_away_from_still_robots() -> None:
    assert CIRCLE.ideal is not None
    body = CIRCLE.ideal[0]
    question = PlanQuestion(
        mission=CIRCLE, robot=3, round=1, position=CIRCLE.center, neighbors=(), still=(body, (0.0, 0.0))
    )
    talk = [("system", TEXT.system(CIRCLE)), ("user", TEXT.plan(question))]

    def nearest(profile: str, seed: int) -> float:
        plan, _ = parse_plan(responder(profile, seed).answer(talk), 10, 2)
        return min(math.dist(place, body) for place in plan.points)

    assert min(nearest("careful", seed) for seed in range(12)) >= CIRCLE.safe_distance - 0.02
    assert min(nearest("ideal", seed) for seed in range(12)) < CIRCLE.safe_distance - 1.0


def test_a_random_model_keeps_to_the_form_only() -> None:
    plan, slot = parse_plan(responder("random").answer(plan_talk()), 10, 2)
    assert 0 <= slot < 10 and check_plan(CIRCLE, plan) is not None
    assert plan != parse_plan(responder("random", 1).answer(plan_talk()), 10, 2)[0]
    steps = {parse_step(responder("random", seed).answer(step_talk()), 2) for seed in range(5)}
    assert len(steps) == 5
