"""Flags made from the configuration: one for each field, few in the help, all in the long one and in the shell."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import typer.main
from command_line import flock, typed
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import InputError
from llm_flock.runtime._config import RunConfig
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_swarm._network.config import SwarmConfig

MOST = {
    "run": 20,
    "fly": 30,
    "swarm": 20,
    "compare": 20,
    "sweep": 20,
    "watch": 20,
    "robot": 20,
    "world": 20,
    "ros2": 20,
}
"""Flags that the help of each command with a configuration may list."""

CONFIGS = {"run": RunConfig, "swarm": SwarmConfig, "fly": FlightConfig}
LISTED = re.compile(r"^  (?:-\w, )?(--[a-z0-9-]+)", re.MULTILINE)


def listed(*line: str) -> list[str]:
    return LISTED.findall(CliRunner().invoke(app, line).stdout)


def parameters(name: str) -> dict[str, Any]:
    group: Any = typer.main.get_command(app)
    return {param.name: param for param in group.commands[name].params}


@pytest.mark.parametrize("name", MOST)
def test_help_is_short_and_the_long_one_has_every_flag(name: str) -> None:
    short, long = listed(name, "--help"), listed(name, "--help-all")
    assert 8 <= len(short) <= MOST[name]
    assert set(short) < set(long) and len(long) == len(set(long))
    assert {flag.opts[-1] for flag in parameters(name).values() if flag.param_type_name == "option"} <= {
        *long,
        "-q",
    }
    text = CliRunner().invoke(app, [name, "--help"]).stdout
    assert f"{len(long) - len(short)} more flags: " in text


@pytest.mark.parametrize("name", CONFIGS)
def test_each_field_has_a_flag_or_is_refused(name: str) -> None:
    fields = {field for info in CONFIGS[name].model_fields.values() for field in info.annotation.model_fields}
    left_out = fields - parameters(name).keys()
    expected = {
        "run": {"points"},
        "swarm": {
            *("points", "kill", "join", "kill_random", "join_random", "changes", "noise", "velocity", "rounds"),
            *("relay", "collision_check", "drift", "sensing_delay", "moving_obstacles"),
            *("ros_poses", "ros_pose_topic"),
        },
        "fly": {
            *("points", "kill", "join", "battery", "kill_random", "join_random", "noise", "start_positions"),
            *("drift", "sensing_delay", "moving_obstacles"),
            *("unit_m", "use_sim_time", "ros_missions", "ros_poses"),
        },
    }
    assert left_out == expected[name]


def test_a_command_without_hidden_flags_has_one_help() -> None:
    assert "--help-all" not in CliRunner().invoke(app, ["export", "--help"]).stdout


def test_the_shell_completes_hidden_flags() -> None:
    env = {"_LLM_FLOCK_COMPLETE": "complete_bash", "COMP_WORDS": "llm-flock run --comm-r", "COMP_CWORD": "2"}
    done = CliRunner().invoke(app, [], env=env, prog_name="llm-flock")
    assert done.stdout.split() == ["--comm-range", "--comm-rounds"]


def test_values_are_read_by_the_type_of_their_field(tmp_path: Path) -> None:
    (points := tmp_path / "points.csv").write_text("1,2\n3,4\n")
    assert typed("--robots", "7", "--noise", "0.5", "--temperature", "0.2") == {
        "n_robots": 7,
        "noise": "0.5",
        "temperature": "0.2",
    }
    assert typed("--velocity", "1,-0.5", "--no-shield") == {"velocity": (1.0, -0.5), "shield": False}
    assert typed("--arena", "60,80") == {"arena": ((0.0, 0.0), (60.0, 80.0))}
    assert typed("--arena", "1,2,60,80") == {"arena": ((1.0, 2.0), (60.0, 80.0))}
    assert len(typed("--start-positions", str(points))["start_positions"]) == 2
    with pytest.raises(InputError, match=r"center = '1;2': expected numbers with commas"):
        typed("--center", "1;2")


@pytest.mark.parametrize("value", ["x", "1.5", "", "9" * 5000])
def test_a_number_that_cannot_be_read_names_its_flag(value: str, tmp_path: Path) -> None:
    done = flock("run", "--robots", value, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: --robots ") and ": expected a whole number" in done.stderr
