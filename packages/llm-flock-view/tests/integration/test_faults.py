"""Robots that die, join late and begin again, missions that change: who is driven, what is recorded and measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

import llm_flock
from llm_flock.agent import Agent
from llm_flock.cli._display import summary_table
from llm_flock.events import Event, MissionGiven
from llm_flock.record._reader import read_record
from llm_flock.runtime._result import MissionOutcome
from llm_flock_view._figures.figures import comparison, error_over_time, save, snapshots

NEAR = llm_flock.Mission(shape="line", n_robots=4, comm_range=60)
STARTS = ((30.0, 60.0), (43.0, 64.0), (57.0, 58.0), (72.0, 62.0))


def fly(mission: llm_flock.Mission = NEAR, **options: Any) -> llm_flock.RunResult:
    given: dict[str, Any] = {"start_positions": STARTS, "model": "geometry", "seed": 1, **options}
    return llm_flock.run(mission, **given)


def test_only_awake_robots_are_driven_and_their_bodies_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    handled: list[tuple[int, str]] = []
    handle = Agent.handle

    def spy(agent: Agent, event: Event) -> Any:
        handled.append((agent.robot, type(event).__name__))
        return handle(agent, event)

    monkeypatch.setattr(Agent, "handle", spy)
    result = fly(kill="3@4", join="0@6", rounds=12, out=str(tmp_path / "o"), stop_when_formed=False)
    rounds = {robot: handled.count((robot, "RoundBegan")) for robot in range(4)}
    assert rounds == {0: 7, 1: 12, 2: 12, 3: 3}
    received = [event for robot, event in handled if robot == 3]
    assert received.count("Arrived") == 3 and received[-1] == "Stopped"
    positions = result.positions
    assert (positions[:6, 0] == STARTS[0]).all() and (positions[6, 0] != STARTS[0]).any()
    assert (positions[3:, 3] == positions[3, 3]).all()
    record = read_record(tmp_path / "o" / "run.mcap")
    assert [s.phases[3] for s in record.states[2:6]] == ["idle", "idle", "dead", "dead"]
    assert [s.phases[0] for s in record.states[4:7]] == ["asleep", "asleep", "idle"]
    silent = record.states[5]
    assert silent.goals[0] is silent.goals[3] is silent.slots[3] is silent.plan_ids[3] is silent.waypoints[3] is None
    assert silent.origins[3] == "hold" and silent.influence[3] == silent.influence[0] == 0.0
    assert silent.influence[1] == 0.25, "the radio hears no silent robot"
    kinds = [(e.round, e.robot, e.kind) for e in record.events if e.kind in ("killed", "joined")]
    assert kinds == [(4, 3, "killed"), (6, 0, "joined")]
    assert sum(result.summary.waypoints.values()) == 7 + 12 + 12 + 3
    assert result.summary.killed == ("3@4",) and result.summary.joined == ("0@6",)


def test_a_dead_body_counts_for_separation() -> None:
    near = ((30.0, 60.0), (30.0, 61.0), (57.0, 58.0), (72.0, 62.0))
    result = fly(start_positions=near, kill="0@1,1@1", rounds=5)
    assert result.summary.min_separation == 1.0 and result.summary.start_violations == 1


def test_a_robot_that_begins_again_remembers_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    init = Agent.__init__

    def spy(self: Agent, robot: int, *args: Any, **options: Any) -> None:
        made.append(robot)
        init(self, robot, *args, **options)

    monkeypatch.setattr(Agent, "__init__", spy)
    result = fly(kill="2@5", join="2@9")
    assert made == [0, 1, 2, 3, 2]
    assert result.summary.robots_without_plan == 0 and result.summary.plans_in_use == 1


def test_run_goes_on_until_all_has_happened_and_forms_again() -> None:
    still = fly()
    assert still.formed and still.summary.rounds < 20
    late = fly(join="3@25", kill="3@20", rounds=40)
    assert late.summary.stopped == "formed" and late.summary.rounds >= 27
    (mission,) = late.summary.missions
    assert mission.formed is not None and mission.formed >= 25 and late.summary.rounds_to_formed == mission.formed
    assert late.formed, "in time, counted from when the last robot joined"


def test_others_form_without_a_dead_robot_leaving_a_gap() -> None:
    result = fly(kill="3@1", rounds=30)
    figures = result.summary
    assert figures.formed and (figures.gaps, figures.spares) == (1, 0)
    assert figures.procrustes_mean is None and np.isnan(result.errors[1:]).all() and result.errors[0] > 0
    assert figures.missions == (
        MissionOutcome(
            round=0,
            shape="line",
            places=4,
            formed=figures.rounds_to_formed,
            lower_bound_rounds=figures.lower_bound_rounds,
        ),
    )


def test_changed_mission_goes_to_one_robot_and_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[int, llm_flock.Mission]] = []
    handle = Agent.handle

    def spy(agent: Agent, event: Event) -> Any:
        if isinstance(event, MissionGiven):
            given.append((agent.robot, event.mission))
        return handle(agent, event)

    monkeypatch.setattr(Agent, "handle", spy)
    change = {"round": 18, "robot": 2, "set": {"shape": "square", "center": [60, 50]}}
    result = fly(changes=[change], rounds=22, out=str(tmp_path / "o"))
    ((robot, mission),) = given
    assert robot == 2 and mission == NEAR.change(shape="square", center=(60, 50), since=18)
    first, second = result.summary.missions
    assert first.formed is not None and first.formed < 18 and first.lower_bound_rounds is not None
    assert (second.round, second.shape, second.places) == (18, "square", 4)
    record = read_record(tmp_path / "o" / "run.mcap")
    assert [(info.version, info.round) for info in record.missions] == [(0, 0), (1, 18)]
    assert record.mission.ideal is not None and record.mission.mission["shape"] == "square"
    assert record.metrics[17].procrustes_mean is not None and record.metrics[17].procrustes_mean < 0.5
    assert record.metrics[18].procrustes_mean is not None and record.metrics[18].procrustes_mean > 2
    assert result.summary.stopped != "formed" or result.summary.rounds >= 20


def test_the_team_must_follow_the_last_mission() -> None:
    """A mission that only one robot follows has not formed, even if the others hold a formation."""
    change = {"round": 12, "robot": 0, "set": {"center": [50, 49]}}
    result = fly(changes=[change], rounds=13, stop_when_formed=False)
    assert not result.formed and result.summary.missions[0].formed is not None
    assert result.summary.missions[1] == MissionOutcome(
        round=12, shape="line", places=4, formed=None, lower_bound_rounds=result.summary.lower_bound_rounds
    )


def test_figures_show_dead_and_late_robots_and_another_ideal(tmp_path: Path) -> None:
    change = {"round": 8, "robot": 2, "set": {"shape": "square"}}
    fly(kill="3@4", join="0@6", changes=[change], rounds=12, out=str(tmp_path / "o"))
    record = read_record(tmp_path / "o" / "run.mcap")
    figure = snapshots(record)
    save(figure, tmp_path / "snapshots.png")
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert {"dead (×), with its number", "has not begun yet"} <= set(labels)
    assert "line, then square" in figure.get_suptitle()
    save(comparison([record], ["one"]), tmp_path / "comparison.png")
    with pytest.raises(llm_flock.InputError, match="known after every round"):
        error_over_time([record], ["one"])
    plain = fly(out=str(tmp_path / "p"))
    assert plain.formed
    figure = snapshots(read_record(tmp_path / "p" / "run.mcap"))
    assert not any("dead" in text.get_text() for legend in figure.legends for text in legend.get_texts())


def test_the_table_of_a_run_says_what_happened_on_the_way() -> None:
    change = {"round": 12, "robot": 0, "set": {"center": [50, 49]}}
    result = fly(changes=[change], kill="3@2", join="1@3", rounds=13)
    console = Console(width=200)
    with console.capture() as shown:
        console.print(summary_table(result))
    rows = [[cell.strip() for cell in line.split("│")[1:3]] for line in shown.get().splitlines() if "│" in line]
    told = dict(rows)
    assert told["missions"].endswith("line not formed (given in round 12)")
    assert (told["died"], told["joined"]) == ("3@2", "1@3")
    with console.capture() as shown:
        console.print(summary_table(fly()))
    assert not any(word in shown.get() for word in ("missions", "died", "joined", "empty places", "spare robots"))
