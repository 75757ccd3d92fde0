"""What happens in flight: how it is written, what is drawn, and what is refused before anything is flown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import typed

from llm_flock.errors import InputError
from llm_flock.runtime._config import build_config, load_config
from llm_flock.runtime._schedule import RANDOM_ROUNDS, Schedule

SPACE = {
    "points": [[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]],
    "center": [50, 50, 50],
    "arena": [[0, 0, 0], [100, 100, 100]],
}


def schedule(**fields: Any) -> Schedule:
    return build_config(**{"n_robots": 6, **fields}).schedule()


def test_nothing_happens_unless_it_is_asked_for() -> None:
    assert schedule() == Schedule(asleep=frozenset(), kills={}, joins={}, missions={}, weak={}, orders={})
    assert schedule(kill="", join=" ").last == 0


def test_robots_die_join_late_and_begin_again() -> None:
    found = schedule(kill="3@12, 1@4,2@4", join="3@20,5@7")
    assert found.kills == {4: (1, 2), 12: (3,)} and found.joins == {7: (5,), 20: (3,)}
    assert found.asleep == {5} and found.last == 20
    assert schedule(join="5@7,5@20", kill="5@9").asleep == {5}


@pytest.mark.parametrize(
    ("fields", "field", "words"),
    [
        ({"kill": "3"}, "kill", "ID@ROUND"),
        ({"kill": "3@x"}, "kill", "ID@ROUND"),
        ({"join": "-1@3"}, "join", "ID@ROUND"),
        ({"kill": "6@3"}, "kill", "there is no robot 6"),
        ({"kill": "3@0"}, "kill", "rounds from 1 to 100000"),
        ({"join": "3@31", "rounds": 30}, "join", "rounds from 1 to 30"),
        ({"kill": "3@4,3@9"}, "kill", "a robot that is awake"),
        ({"join": "3@4,3@9"}, "join", "killed before"),
        ({"kill": "3@9", "join": "3@9"}, "kill", "later round than round 9"),
        ({"kill": "0@1,1@2,2@3,3@4,4@5,5@6"}, "kill", "at least one robot"),
        ({"kill": "0@3", "join": "1@9,2@9,3@9,4@9,5@9"}, "kill", "at least one robot"),
        ({"join": "0@1,1@1,2@1,3@1,4@1,5@1"}, "join", "at least one robot"),
        ({"kill_random": 6}, "kill_random", "at most 5"),
        ({"join_random": 6}, "join_random", "at most 5"),
        ({"kill_random": 2, "kill": "0@1,1@1,2@1", "join": "4@5,5@5"}, "kill_random", "at most 1"),
        ({"kill_random": -1}, "kill_random", "at least 0"),
    ],
)
def test_schedule_rejects_impossible_events(fields: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        schedule(**fields)
    assert caught.value.field == field and words in caught.value.says


def test_random_deaths_and_joins_follow_seed_among_the_unnamed() -> None:
    fields: dict[str, Any] = {
        "kill": "0@5",
        "kill_random": 2,
        "join_random": 1,
        "changes": [{"round": 3, "robot": 1, "set": {"spacing": 11}}],
    }
    drawn = [schedule(seed=seed, **fields) for seed in range(40)]
    assert drawn[7] == schedule(seed=7, **fields) != drawn[8]
    rounds: set[int] = set()
    for found in drawn:
        killed = sorted(robot for robots in found.kills.values() for robot in robots)
        assert len(killed) == 3 and killed[0] == 0 and 1 not in killed and not found.asleep & {0, 1, *killed}
        assert len(found.asleep) == 1 and len(found.joins) == 1
        rounds.update(found.kills, found.joins)
    assert min(rounds) == 1 and max(rounds) == RANDOM_ROUNDS
    assert all(schedule(seed=seed, kill_random=3, rounds=4).last <= 4 for seed in range(10))


def test_missions_change_one_after_another() -> None:
    found = schedule(
        velocity=(1, 0),
        changes=[
            {"round": 30, "robot": 2, "set": {"shape": "line", "places": 5}},
            {"round": 11, "robot": 4, "set": {"shape": "triangle"}},
            {"round": 40, "robot": 2, "set": {"center": [50, 50], "velocity": None}},
        ],
    )
    first, second, third = (found.missions[when][0] for when in (11, 30, 40))
    assert (first[0], second[0]) == (4, 2) and found.last == 40
    assert first[1].shape == "triangle" and first[1].center == (61, 50) and first[1].since == 11
    assert (second[1].shape, second[1].n_places, second[1].n_robots) == ("line", 5, 6)
    assert second[1].center == (80, 50), "it went on with the velocity of before, until it touched the wall"
    assert (third[1].center, third[1].velocity, third[1].n_places) == ((50, 50), None, 5)


def test_points_of_a_changed_mission_come_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("0,0\n10,0\n20,0\n")
    found = schedule(changes=[{"round": 3, "robot": 0, "set": {"shape": f"points:{tmp_path / 'p.csv'}"}}])
    mission = found.missions[3][0][1]
    assert (mission.shape, mission.n_places, mission.n_robots) == ("points", 3, 6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"round": 5, "robot": 6, "set": {}}, "robot from 0 to 5"),
        ({"round": 100_001, "robot": 0, "set": {}}, "round from 1 to 100000"),
        ({"round": 5, "robot": 3, "set": {}}, "awake in round 5"),
        ({"round": 5, "robot": 4, "set": {}}, "awake in round 5"),
        ({"round": 5, "robot": 0, "set": {"shape": "square"}}, "a square takes 4, 8"),
        ({"round": 5, "robot": 0, "set": {"colour": "red"}}, "colour"),
        ({"round": 5, "robot": 0, "set": {"since": 3}}, "since"),
        ({"round": 5, "robot": 0, "set": {"n_robots": 7}}, "by radio .*not n_robots"),
        ({"round": 5, "robot": 0, "set": {"safe_distance": 2}}, "by radio .*not safe_distance"),
        ({"round": 5, "robot": 0, "set": {"max_step": 4}}, "by radio .*not max_step"),
        ({"round": 5, "robot": 0, "set": {"comm_range": 20}}, "by radio .*not comm_range"),
        ({"round": 5, "robot": 0, "set": {"sense_range": 20}}, "by radio .*not sense_range"),
        ({"round": 5, "robot": 0, "set": {"arena": [[0, 0], [200, 200]]}}, "by radio .*not arena"),
        ({"round": 5, "robot": 0, "set": {"obstacles": [{"center": [0, 0], "radius": 1}]}}, "not obstacles"),
        ({"round": 5, "robot": 0, "set": SPACE}, "by radio .*not arena"),
        ({"round": 5, "robot": 0, "set": {"center": [99, 50]}}, "arena"),
    ],
)
def test_a_change_that_cannot_be_is_refused(change: dict[str, Any], words: str) -> None:
    later = {"round": 9, "robot": 0, "set": {"spacing": 11}}
    with pytest.raises(InputError, match=words) as caught:
        schedule(kill="3@4", join="4@6", changes=[later, change])
    assert caught.value.field == "changes"


def test_several_orders_in_a_round_are_given_one_after_the_other() -> None:
    changes = [
        {"round": 9, "robot": 1, "set": {"spacing": 11}},
        {"round": 5, "robot": 3, "set": {"spacing": 12}},
        {"round": 9, "robot": 1, "set": {"spacing": 13}},
        {"round": 9, "robot": 0, "set": {"center": [40, 40]}},
    ]
    found = schedule(changes=changes).missions
    assert {when: [(robot, mission.spacing) for robot, mission in orders] for when, orders in found.items()} == {
        5: [(3, 12.0)],
        9: [(1, 11.0), (1, 13.0), (0, 13.0)],
    }
    assert found[9][-1][1].center == (40.0, 40.0)


def test_a_robot_takes_a_change_in_the_round_in_which_it_begins() -> None:
    change = {"round": 6, "robot": 4, "set": {"spacing": 11}}
    assert schedule(join="4@6", changes=[change]).missions[6][0][0] == 4


def test_changes_come_from_a_file_of_the_run_or_from_a_flag(tmp_path: Path) -> None:
    file = tmp_path / "flock.toml"
    file.write_text(
        "[mission]\nn_robots = 8\n[[trial.changes]]\nround = 20\nrobot = 3\n"
        'set = {shape = "square", center = [60, 50]}\n'
    )
    config = load_config(file)
    assert config.schedule().missions[20][0][1].shape == "square"
    assert build_config(config.model_dump(mode="json")) == config
    table = {"round": 20, "robot": 3, "set": {"shape": "square", "center": [60, 50]}}
    (tmp_path / "changes.json").write_text(json.dumps([table]))
    for text in (json.dumps([table]), str(tmp_path / "changes.json")):
        given = typed("--robots", "8", "--changes", text)
        assert build_config(**given).trial.changes == config.trial.changes
    with pytest.raises(InputError, match="a JSON list"):
        typed("--changes", str(_object(tmp_path)))


def _object(folder: Path) -> Path:
    path = folder / "object.json"
    path.write_text("{}")
    return path
