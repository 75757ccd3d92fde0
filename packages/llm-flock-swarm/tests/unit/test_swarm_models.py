"""The configuration of a swarm says whether its models are simulated, and whether a record can repeat them."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

import pytest
from typer.testing import CliRunner

from llm_flock import plugins
from llm_flock.cli import app
from llm_flock.errors import InputError
from llm_flock_swarm import SwarmConfig
from llm_flock_swarm._network import watch
from llm_flock_swarm._network.mission_orders import changed_mission, mission_order


@pytest.mark.parametrize(
    ("model", "simulated"),
    [
        ("simulated:ideal", True),
        ("geometry", False),
        ("stands:in", True),
        ("0=stands:in,1-2=stands:up", True),
        ("stands:up", False),
    ],
)
def test_swarm_says_whether_a_model_is_simulated(model: str, simulated: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("stands", "own_models:SOURCE", "llm_flock.models")
    monkeypatch.setattr(plugins, "entries", lambda kind: {"stands": entry} if kind == "models" else {})
    assert SwarmConfig.build(model=model, n_robots=3).simulated == simulated


@pytest.mark.parametrize(("flags", "says"), [(["--id", "9"], "--id 9: no such robot"), ([], "no swarm answers there")])
def test_a_robot_that_does_not_answer_is_named(flags: list[str], says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def nobody(*given: object) -> list[int]:
        return []

    monkeypatch.setattr(watch, "give_mission", nobody)
    found = CliRunner().invoke(app, ["mission", "--set", "shape=line", *flags])
    assert says in f"{found.output}{found.exception}"


def test_record_of_a_swarm_cannot_repeat_code_of_the_user() -> None:
    config = SwarmConfig.build(model="0=own_models:Echo,1-9=geometry")
    assert not config.simulated and config.unrepeatable


@pytest.mark.parametrize(
    "fields", [{"protocol": "released"}, {"relay": True}, {"noise": 0.1}, {"kill": "1@3"}, {"velocity": [1, 1]}]
)
def test_what_needs_all_robots_in_one_process_is_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="cannot be used in a swarm of processes"):
        SwarmConfig.build({}, **fields)


def test_no_order_makes_a_swarm_of_processes_move() -> None:
    config = SwarmConfig.build({}, shape="square", n_robots=4)
    with pytest.raises(InputError, match=r"velocity.*cannot be used in a swarm of processes"):
        mission_order(config, {"velocity": [1.0, 1.0]}, 1)
    assert changed_mission(config.mission, {"shape": "line"}).shape == "line"


def test_an_order_to_a_swarm_is_checked_against_its_rules() -> None:
    config = SwarmConfig.build({}, shape="square", n_robots=4, assignment="nearest-free")
    with pytest.raises(InputError, match=r"assignment.*auction"):
        mission_order(config, {"prefer": [{"robot": 1, "way": "edge"}]}, 1)
