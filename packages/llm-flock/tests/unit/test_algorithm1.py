"""The paper on one screen: its formulas, both readings of its assignment, and its demonstration."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from llm_flock import algorithm1
from llm_flock.algorithm1 import (
    DemoRobot,
    adopt,
    consensus_round,
    flown,
    influence,
    main,
    nearest_available,
    neighbors,
    three_robots,
)

RANGE = 15.0
PLAN = ((0.0, 0.0), (10.0, 0.0), (20.0, 0.0))
OTHER = ((0.0, 0.0), (0.0, 10.0), (0.0, 20.0))


def said(sender: int, degree: int, plan: tuple[tuple[float, float], ...] = OTHER) -> DemoRobot:
    return DemoRobot(sender=sender, position=(0.0, 0.0), plan=plan, slot=0, degree=degree)


def test_influence_is_the_share_of_the_team_in_radio_range() -> None:
    positions = [(0.0, 0.0), (15.0, 0.0), (30.1, 0.0)]
    assert [neighbors(positions, i, RANGE) for i in range(3)] == [[1], [0], []]
    assert influence(len(neighbors(positions, 0, RANGE)), 3) == pytest.approx(1 / 3)


def test_the_plan_of_the_most_influential_neighbour_is_adopted() -> None:
    k = said(2, 5)
    assert adopt(1, PLAN, [said(1, 4), k, said(3, 2)]) is k


@pytest.mark.parametrize(
    ("degree", "heard"),
    [(5, [said(1, 5)]), (6, [said(1, 5)]), (1, [said(1, 5, PLAN)]), (1, [])],
    ids=["equal", "less", "same plan", "nobody"],
)
def test_the_own_plan_is_kept_without_a_stricter_influence(degree: int, heard: list[DemoRobot]) -> None:
    assert adopt(degree, PLAN, heard) is None


@pytest.mark.parametrize(("lowest", "chosen"), [(True, 1), (False, 7)])
def test_of_equally_influential_neighbours_the_id_decides(lowest: bool, chosen: int) -> None:
    k = adopt(1, PLAN, [said(7, 3), said(1, 3)], lowest=lowest)
    assert k is not None and k.sender == chosen


@pytest.mark.parametrize(("yields_to", "adopted"), [(0, False), (2, False), (3, True)])
def test_a_tie_with_a_lower_id_may_be_yielded(yields_to: int, adopted: bool) -> None:
    k = said(2, 5)
    assert adopt(5, PLAN, [k], yields_to=yields_to) is (k if adopted else None)
    assert adopt(5, OTHER, [k], yields_to=yields_to) is None


def test_the_nearest_available_place_is_taken() -> None:
    assert nearest_available((11.0, 0.0), PLAN) == 1
    assert nearest_available((11.0, 0.0), PLAN, {1}) == 2
    assert nearest_available((5.0, 0.0), PLAN) == 0
    assert nearest_available((11.0, 0.0), PLAN, {0, 1, 2}) == 1


@pytest.mark.parametrize(("reading", "taken"), [("nearest", 2), ("nearest-free", 3)])
def test_the_two_readings_differ_in_how_many_goals_are_taken(reading: str, taken: int) -> None:
    team = three_robots()
    for _ in range(3):
        team = [flown(robot, 6.0) for robot in consensus_round(team, RANGE, reading)]
    assert {robot.plan for robot in team} == {three_robots()[1].plan}
    assert len({robot.goal for robot in team}) == taken


def test_a_robot_flies_no_farther_than_its_step_limit_or_goal() -> None:
    robot = DemoRobot(sender=0, position=(0.0, 0.0), plan=PLAN, slot=1)
    assert flown(robot, 6.0).position == (6.0, 0.0)
    assert flown(flown(robot, 6.0), 6.0).position == (10.0, 0.0)
    assert flown(flown(flown(robot, 6.0), 6.0), 6.0).position == (10.0, 0.0)


def test_the_demonstration_says_what_each_robot_decides(capsys: pytest.CaptureFixture[str]) -> None:
    main(["nearest-free"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "  robot 0: I = 0.33, plan of 1 (adopted), place 2"
    assert lines[-1] == "1 plan, 3 of 3 goals taken (nearest-free)"
    with pytest.raises(SystemExit, match="must be nearest-free or nearest"):
        main(["best"])


def test_the_file_runs_by_itself() -> None:
    ran = subprocess.run([sys.executable, Path(algorithm1.__file__)], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0 and ran.stdout.endswith("1 plan, 3 of 3 goals taken (nearest-free)\n")
