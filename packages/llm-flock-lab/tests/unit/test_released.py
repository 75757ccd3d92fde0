"""The authors' program as rules: a leader for all in reach, one table of goals, one check of all steps."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

import llm_flock
from llm_flock.arrays import Point
from llm_flock.message import Message, Provenance
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, StepAnswer, StepQuestion
from llm_flock.protocol import AssignmentInput, Standing
from llm_flock_lab._released import LeaderConsensus, SharedTable, central_check

A = Plan.of([[0, 0], [10, 0], [5, 8]])
B = Plan.of([[1, 1], [11, 1], [6, 9]])


def origin(proposer: int) -> Provenance:
    return Provenance(mission=0, mission_digest="0" * 16, epoch=0, degree=1, proposer=proposer, sequence=0)


def says(sender: int, degree: int, plan: Plan | None = B) -> Message:
    provenance = None if plan is None else origin(sender)
    return Message(sender=sender, sequence=0, degree=degree, plan=plan, provenance=provenance)


def holds(robot: int, degree: int, proposer: int, plan: Plan = A) -> Standing:
    return Standing(robot=robot, plan=plan, provenance=origin(proposer), degree=degree)


def test_all_follow_the_most_influential() -> None:
    rule = LeaderConsensus()
    assert rule.choose(holds(0, 1, 0), [says(1, 2), says(2, 3), says(3, 9, None)]) == says(2, 3)
    assert rule.choose(holds(2, 3, 2), [says(0, 1), says(1, 2)]) is None


def test_of_equals_the_followed_leads_then_the_lower_id() -> None:
    rule, heard = LeaderConsensus(), [says(1, 2), says(2, 2)]
    assert rule.choose(holds(0, 1, 0), heard) == says(1, 2)
    rule = LeaderConsensus()
    rule.choose(holds(0, 1, 0), [says(2, 2)])
    assert rule.choose(holds(0, 1, 0), heard) == says(2, 2)


def test_the_same_points_of_the_leader_count_as_its_plan() -> None:
    rule = LeaderConsensus()
    assert rule.choose(holds(0, 1, 0, B), [says(1, 2)]) == says(1, 2)
    assert rule.choose(holds(0, 1, 1, B), [says(1, 2)]) is None


def wants(robot: int, position: tuple[float, float], *, proposer: int = 1, adopted: bool = True) -> AssignmentInput:
    return AssignmentInput(
        robot=robot,
        position=position,
        plan=A,
        spacing=10.0,
        chosen=0,
        adopted=adopted,
        heard=(),
        sensed={},
        origin=origin(proposer),
    )


def test_goals_of_robots_out_of_touch_are_taken_too() -> None:
    table = SharedTable()
    assert table.take(wants(1, (0, 0), adopted=False)).slot == 0
    assert [table.take(wants(robot, (0, 0))).slot for robot in (0, 2)] == [2, 1]
    assert table.take(wants(7, (0, 0))).slot == 2, "none is free: its id, or the last"


def test_points_of_another_proposer_are_another_plan() -> None:
    table = SharedTable()
    claim = table.take(wants(0, (0, 0), proposer=0, adopted=False))
    assert table.update(claim, wants(0, (0, 0), proposer=0)) is claim
    table.take(wants(1, (0, 0), adopted=False))
    assert table.update(claim, wants(0, (0, 0))).slot == 2


class Asked:
    """A trial of two robots that answers each further question with the steps given."""

    def __init__(self, start: list[list[float]], *again: dict[int, tuple[float, float]]) -> None:
        self.config = SimpleNamespace(mission=Mission(n_robots=len(start), shape="line"))
        self.bodies = SimpleNamespace(positions=np.array(start))
        self.objections: list[dict[int, str]] = []
        self._again = list(again)

    async def ask_steps(self, asking: dict[int, StepQuestion]) -> dict[int, StepAnswer | NoAnswer]:
        self.objections.append({robot: question.objection for robot, question in asking.items()})
        steps = self._again.pop(0)
        return {robot: StepAnswer(waypoint=steps[robot]) for robot in asking}

    def check(self, steps: dict[int, tuple[float, float]]) -> dict[int, Point | None]:
        plan, start = Plan.of([[30, 0], [0, 0]]), self.bodies.positions.tolist()
        asked = {
            robot: StepQuestion(
                mission=self.config.mission,
                robot=robot,
                round=1,
                position=tuple(start[robot]),
                neighbors=(),
                plan=plan,
                slot=robot,
            )
            for robot in steps
        }
        answers = {robot: StepAnswer(waypoint=step) for robot, step in steps.items()}
        flown = asyncio.run(central_check(cast(Any, self), asked, answers))
        return {robot: a.waypoint if isinstance(a, StepAnswer) else None for robot, a in flown.items()}


def test_free_ways_are_flown_as_they_are() -> None:
    trial = Asked([[0, 0], [10, 0]])
    assert trial.check({0: (2, 0), 1: (8, 0)}) == {0: (2, 0), 1: (8, 0)}
    assert not trial.objections


def test_the_robot_nearer_to_its_goal_is_asked_again() -> None:
    trial = Asked([[0, 0], [10, 0]], {1: (10, 5)})
    assert trial.check({0: (6, 0), 1: (4, 0)}) == {0: (6, 0), 1: (10, 5)}
    (objections,) = trial.objections
    assert (
        objections.keys() == {1} and "nearer than 3.5 to: robot 0, which flies from [0, 0] to [6, 0]" in objections[1]
    )


def test_after_two_reprompts_all_in_conflict_are_held() -> None:
    trial = Asked([[0, 0], [10, 0]], {1: (4, 0)}, {1: (4, 0)})
    assert trial.check({0: (6, 0), 1: (4, 0)}) == {0: None, 1: None}
    assert len(trial.objections) == 2


def test_a_team_forms_by_the_program() -> None:
    starts = [[30, 30], [50, 20], [70, 40]]
    run = llm_flock.run(Mission(shape="triangle", n_robots=3), protocol="released", start_positions=starts, rounds=40)
    assert run.formed and run.summary.plans_in_use == 1
    assert run.summary.min_separation is not None and run.summary.min_separation >= 3.0
