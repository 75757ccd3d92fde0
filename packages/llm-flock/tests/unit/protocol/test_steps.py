"""Checks of a step, steps where the way is blocked, and steps that the shield may correct."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import StepAnswer, StepQuestion
from llm_flock.protocol._verification.steps import Fault, blocked, judge, step_faults

MISSION = Mission(shape="triangle", n_robots=3)


def ask(position: Point, goal: Point, *neighbors: Point) -> StepQuestion:
    plan = Plan.of([goal, (90.0, 90.0), (80.0, 80.0)])
    return StepQuestion(mission=MISSION, robot=0, round=1, position=position, neighbors=neighbors, plan=plan, slot=0)


def kinds(question: StepQuestion, waypoint: Point) -> list[Fault]:
    return list(step_faults(question, waypoint))


def said_of(question: StepQuestion, waypoint: Point) -> str | None:
    return judge(question, StepAnswer(waypoint=waypoint), shield_on=False).reason


def clipped(question: StepQuestion, waypoint: Point, *, shield_on: bool) -> Point | None:
    fit = judge(question, StepAnswer(waypoint=waypoint), shield_on=shield_on).fit
    return None if fit is None else fit.waypoint


FAR = ask((50.0, 50.0), (80.0, 50.0))
NEAR = ask((50.0, 50.0), (52.88, 50.0))
THERE = ask((50.0, 50.0), (50.0, 50.0))


@pytest.mark.parametrize(
    ("question", "waypoint", "expected"),
    [
        (FAR, (56.0, 50.0), []),
        (FAR, (55.0, 53.0), []),
        (FAR, (56.04, 50.0), []),
        (FAR, (57.2, 50.0), [Fault.LENGTH]),
        (FAR, (50.0, 50.0), [Fault.PROGRESS]),
        (FAR, (44.0, 50.0), [Fault.PROGRESS]),
        (FAR, (98.0, 50.0), [Fault.LENGTH, Fault.OVERSHOOT]),
        (FAR, (math.nan, 50.0), [Fault.FORM]),
        (FAR, (56.0, 50.0, 0.0), [Fault.FORM]),
        (NEAR, (52.88, 50.0), []),
        (NEAR, (51.0, 50.0), []),
        (NEAR, (56.0, 50.0), [Fault.OVERSHOOT]),
        (ask((50.0, 50.0), (54.0, 50.0)), (56.0, 50.0), [Fault.OVERSHOOT]),
        (THERE, (50.0, 50.0), []),
        (THERE, (50.1, 50.1), []),
        (THERE, (51.0, 50.0), [Fault.OVERSHOOT]),
        (ask((50.0, 50.0), (80.0, 50.0), (58.0, 50.5)), (56.0, 50.0), [Fault.SEPARATION]),
        (ask((50.0, 50.0), (80.0, 50.0), (48.0, 50.0)), (54.0, 50.0), []),
        (ask((50.0, 50.0), (80.0, 50.0), (48.0, 50.0)), (49.0, 50.0), [Fault.SEPARATION]),
        (ask((2.0, 50.0), (2.0, 80.0)), (-1.0, 54.0), [Fault.ARENA]),
        (ask((-4.0, 50.0), (2.0, 80.0)), (-3.0, 54.0), []),
        (ask((-4.0, 50.0), (2.0, 80.0)), (-5.0, 54.0), [Fault.ARENA]),
    ],
)
def test_faults(question: StepQuestion, waypoint: Point, expected: list[Fault]) -> None:
    assert kinds(question, waypoint) == expected
    assert (said_of(question, waypoint) is None) == (not expected)


def test_reasons_have_numbers() -> None:
    assert said_of(FAR, (98.0, 50.0)) == (
        "the position is 48 from yours, 6 is the step limit; the position is 18 beyond your goal, which is 30 away."
    )
    close = ask((50.0, 50.0), (80.0, 50.0), (57.0, 53.0), (58.0, 50.0))
    reason = said_of(close, (56.0, 50.0))
    assert reason == "the position is 2 from the robot at [58, 50], at least 3 is required."
    assert said_of(FAR, (44.0, 50.0)) == ("the position is 36 from your goal, no nearer than you are now (30).")
    wall = said_of(ask((2.0, 50.0), (2.0, 80.0)), (-1.0, 54.0))
    assert wall == "the position is 1 outside the arena from [0, 0] to [100, 100]."


def test_a_step_under_another_robot_needs_more_distance() -> None:
    tall = Mission(shape="sphere", n_robots=12, downwash=2)
    asked = StepQuestion(
        mission=tall,
        robot=0,
        round=1,
        position=(50.0, 50.0, 50.0),
        neighbors=((56.0, 50.0, 55.0),),
        plan=Plan.of([[80.0, 50.0, 50.0]] * 12),
        slot=0,
    )
    assert blocked(asked) and not blocked(replace(asked, mission=tall.change(downwash=1)))
    assert said_of(asked, (56.0, 50.0, 50.0)) == (
        "the position is 2.5 from the robot at [56, 50, 55] (with differences of z divided by 2), "
        "at least 3 is required."
    )


def test_a_blocked_robot_may_wait_or_go_round() -> None:
    free = ask((50.0, 50.0), (80.0, 50.0), (50.0, 56.0), (42.0, 50.0), (70.0, 50.0))
    in_the_way = ask((50.0, 50.0), (80.0, 50.0), (55.0, 51.0))
    assert not blocked(free) and blocked(in_the_way)
    assert kinds(free, (50.0, 50.0)) == [Fault.PROGRESS]
    assert kinds(in_the_way, (50.0, 50.0)) == [] == kinds(in_the_way, (49.0, 46.0))
    on_the_goal = ask((50.0, 50.0), (53.0, 50.0), (55.0, 50.0))
    assert kinds(on_the_goal, (50.0, 47.0)) == []


@pytest.mark.parametrize(
    ("question", "waypoint", "expected"),
    [
        (FAR, (56.0, 50.0), (56.0, 50.0)),
        (FAR, (62.0, 50.0), (56.0, 50.0)),
        (FAR, (98.0, 50.0), (56.0, 50.0)),
        (NEAR, (56.0, 50.0), (52.88, 50.0)),
        (THERE, (56.0, 50.0), (50.0, 50.0)),
        (FAR, (38.0, 50.0), None),
        (FAR, (50.0, 50.0), None),
        (FAR, (math.inf, 50.0), None),
        (ask((2.0, 50.0), (2.0, 80.0)), (-1.0, 54.0), (0.0, 54.0)),
        (ask((-4.0, 50.0), (2.0, 80.0)), (-5.0, 54.0), None),
    ],
)
def test_clipped_step_passes_the_checks(question: StepQuestion, waypoint: Point, expected: Point | None) -> None:
    made = clipped(question, waypoint, shield_on=False)
    assert made == (None if expected is None else pytest.approx(expected))
    if made is not None:
        assert step_faults(question, made) == {}


def test_lack_of_separation_is_left_to_an_active_shield() -> None:
    question = ask((50.0, 50.0), (80.0, 50.0), (58.0, 50.5))
    assert clipped(question, (56.0, 50.0), shield_on=True) == (56.0, 50.0)
    assert clipped(question, (56.0, 50.0), shield_on=False) is None


def path_fault(question: StepQuestion, *way: Point, shield_on: bool = True) -> str | None:
    answer = StepAnswer(waypoint=way[0], path=way[1:])
    return judge(replace(question, horizon=5), answer, shield_on=shield_on).reason


def test_each_waypoint_of_a_path_is_a_step_from_the_one_before() -> None:
    assert path_fault(FAR, (56.0, 50.0), (62.0, 50.0), (68.0, 50.0)) is None
    assert path_fault(FAR, (58.0, 50.0), (70.0, 50.0)) == "position 1 of the path: " + (
        "the position is 8 from yours, 6 is the step limit."
    )
    assert path_fault(FAR, (56.0, 50.0), (62.0, 50.0), (70.0, 50.0), (90.0, 50.0)) == (
        "position 3 of the path, counted from position 2 as yours: the position is 8 from yours, 6 is the step limit."
    )
    assert "no nearer than you are now" in (path_fault(FAR, (56.0, 50.0), (55.0, 50.0)) or "")


def test_later_positions_of_others_are_not_checked() -> None:
    question = ask((50.0, 50.0), (80.0, 50.0), (63.0, 50.0))
    assert path_fault(question, (56.0, 50.0), (62.0, 50.0), shield_on=False) is None
    near = ask((50.0, 50.0), (80.0, 50.0), (57.0, 50.0))
    assert "position 1 of the path: the position is 1 from the robot" in (
        path_fault(near, (56.0, 50.0), shield_on=False) or ""
    )
    assert path_fault(near, (56.0, 50.0)) is None


def test_without_a_path_the_answer_is_checked_as_a_step() -> None:
    near = ask((50.0, 50.0), (80.0, 50.0), (57.0, 50.0))
    answer = StepAnswer(waypoint=(56.0, 50.0))
    said = judge(near, answer, shield_on=True).reason
    assert said is not None and said == said_of(near, answer.waypoint)
