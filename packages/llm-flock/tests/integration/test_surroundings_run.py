"""Whole runs among obstacles, and from raw starts that are too near."""

from pathlib import Path

import pytest
from command_line import typed

from llm_flock.errors import InputError
from llm_flock.mission import build_mission
from llm_flock.obstacles import clearance
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.record._reader import read_record
from llm_flock.runtime._api import run
from llm_flock.runtime._schedule import Stream, stream
from llm_flock.simulate import draw_start

DISC = {"center": [50, 50], "radius": 6}
WALL = {"polygon": [[20, 20], [45, 20], [45, 23], [20, 23]]}


@pytest.mark.parametrize("seed", range(4))
def test_a_circle_forms_around_an_obstacle(seed: int) -> None:
    result = run(shape="circle", n_robots=10, obstacles=[DISC, WALL], seed=seed, rounds=100)
    summary = result.summary
    assert summary.formed
    assert summary.min_clearance is not None and summary.min_clearance >= 1.5 - 1e-6
    assert summary.min_separation is not None and summary.min_separation >= 3 - 1e-6


@pytest.mark.parametrize("rule", ["separated", "uniform"])
def test_no_robot_starts_in_an_obstacle(rule: str) -> None:
    mission = build_mission(n_robots=60, shape="text:x", obstacles=[{"center": (50, 50), "radius": 40}])
    starts = draw_start(mission, "uniform" if rule == "uniform" else "separated", stream(1, Stream.START))
    assert min(clearance(tuple(row), mission.obstacles) for row in starts.tolist()) >= mission.body_radius


def test_starts_that_are_too_near_are_counted_and_separated(tmp_path: Path) -> None:
    starts = [[50, 50], [50, 50], [51, 50], [52.5, 51], [80, 20], [82, 20]]
    result = run(shape="triangle", n_robots=6, start_positions=starts, seed=1, out=str(tmp_path))
    summary = result.summary
    assert summary.formed
    # Of the four in the middle, the pair 0-3, its twin 1-3, and all nearer ones; and the two at the side.
    assert summary.start_violations == 7 and summary.min_separation == 0.0
    assert summary.rounds_to_separate is not None and 1 <= summary.rounds_to_separate <= 8
    assert summary.min_separation_after_start is not None and summary.min_separation_after_start >= 3 - 1e-6
    events = read_record(tmp_path / "run.mcap").events
    separating = {(e.round, e.robot) for e in events if e.kind == "separating"}
    assert {robot for number, robot in separating if number == 1} == set(range(6))
    assert max(number for number, _ in separating) == summary.rounds_to_separate


def test_unshielded_obstacles_and_near_starts_are_left_alone() -> None:
    result = run(
        protocol="paper", n_robots=3, shape="triangle", start_positions=[[50, 50], [50, 51], [60, 50]], rounds=3
    )
    assert {who for who, count in result.summary.waypoints.items() if count} <= {"model", "hold"}
    assert result.summary.start_violations == 1 and result.summary.min_clearance is None


def test_a_known_deadlock_is_resolved_and_recorded(tmp_path: Path) -> None:
    """Without exchanges of places and joint assignments, which resolve most of them earlier."""
    places = AuctionAssignment(swaps=False, joint=False)
    result = run(shape="square", n_robots=8, model="geometry", assignment=places, seed=48, out=str(tmp_path))
    assert result.formed and result.summary.waypoints["yield"] > 0
    events = read_record(tmp_path / "run.mcap").events
    assert any(event.kind == "deadlock" for event in events)


def test_obstacles_on_the_command_line(tmp_path: Path) -> None:
    text = '[{"center": [50, 50], "radius": 6}]'
    file = tmp_path / "obstacles.json"
    file.write_text(text, encoding="utf-8")
    assert typed("--obstacles", text) == typed("--obstacles", str(file)) == {"obstacles": [DISC]}
    for wrong, said in (
        ("[", "broken JSON: Expecting value: line 1"),
        (str(tmp_path / "nothing.json"), "the name of a file"),
    ):
        with pytest.raises(InputError, match=said):
            typed("--obstacles", wrong)
    file.write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="a JSON list"):
        typed("--obstacles", str(file))
