"""Flags that would have no effect are refused by their name; what a file says beside its switch stays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_line import flock


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        ("run --foxglove-port 8766", "--foxglove-port 8766: has no effect without --foxglove"),
        ("view --foxglove-port 1", "--foxglove-port 1: has no effect without --foxglove"),
        ("swarm --foxglove-port 0", "--foxglove-port 0: has no effect without --foxglove"),
        ("watch --foxglove-port 1", "--foxglove-port 1: has no effect without --foxglove"),
        ("fly --dry-run --foxglove-port 1", "--foxglove-port 1: has no effect without --foxglove"),
        ("run --dry-run --pace 5", "--pace 5: has no effect in a dry run"),
        ("run --dry-run --foxglove", "--foxglove: has no effect in a dry run"),
        ("fly --dry-run --foxglove", "--foxglove: has no effect in a dry run"),
        ("swarm --ros-missions", "--ros-missions: has no effect without --ros2"),
        ("watch --ros-rate-hz 5", "--ros-rate-hz 5: has no effect without --ros2"),
        ("watch --unit-m 2", "--unit-m 2: has no effect without --ros2"),
        ("fly --config {} --ros-frame map", "--ros-frame map: has no effect without --ros2"),
        ("view --swarm flock", "--swarm flock: has no effect without --connect or --config"),
        ("view --base-url http://localhost:1", "--base-url http://localhost:1: has no effect without --model"),
        ("run --no-record --out demo", "--out demo: has no effect with --no-record"),
        ("swarm --no-record --out demo", "--out demo: has no effect with --no-record"),
        ("compare --json --markdown", "--markdown: has no effect with --json"),
        ("compare --json --latex", "--latex: has no effect with --json"),
        ("compare --markdown --latex", "--markdown: has no effect with --latex"),
        ("fly --dry-run --ros2 tcp/127.0.0.1:1", "--ros2 tcp/127.0.0.1:1: has no effect in a dry run"),
    ],
)
def test_a_flag_without_its_switch_is_refused(argv: str, says: str, tmp_path: Path) -> None:
    example = Path(__file__).parents[2] / "examples" / "flight.toml"
    done = flock(*argv.format(example).split(), cwd=tmp_path, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"error: {says}\n")
    assert list(tmp_path.iterdir()) == []


def test_a_file_may_say_how_ros_would_be_shown(tmp_path: Path) -> None:
    (tmp_path / "flight.toml").write_text('[ros2]\nrouter = "tcp/127.0.0.1:1"\nros_frame = "map"\n')
    flock("fly", "--config", "flight.toml", "--dry-run", "--robots", "3", "--shape", "triangle", cwd=tmp_path)


def test_a_swarm_says_that_it_starts_once_it_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Started(Exception):
        pass

    async def stop(*words: str, **_: Any) -> None:
        raise Started

    monkeypatch.setattr("asyncio.create_subprocess_exec", stop)
    for flags, says in (
        (("--connect", "nowhere"), "--connect nowhere: expected endpoints such as tcp/127.0.0.1:7447"),
        (("--listen", "tcp/127.0.0.1:99999"), "--listen tcp/127.0.0.1:99999: expected endpoints such as tcp"),
        (("--ros2", "tcp/127.0.0.1"), "--ros2 tcp/127.0.0.1: expected an endpoint such as tcp/127.0.0.1:7447"),
        (("--keys", "nofolder"), "--keys nofolder/team.json: expected the public keys"),
    ):
        done = flock("swarm", "--robots", "3", "--shape", "triangle", *flags, cwd=tmp_path, check=False)
        assert done.stderr.startswith(f"error: {says}") and done.stderr.count("\n") == 1
    with pytest.raises(Started):
        flock("swarm", "--robots", "3", "--shape", "triangle", cwd=tmp_path, check=False)


def test_a_token_that_is_refused_is_not_shown(tmp_path: Path) -> None:
    for token in ("hunter2", "sixteen-or-more\x1b[31m"):
        done = flock("view", "--no-browser", "--token", token, cwd=tmp_path, check=False)
        assert done.returncode == 2 and "--token" in done.stderr and "16 characters or more" in done.stderr
        assert token[:7] not in done.stderr + done.stdout


def test_the_help_keeps_its_units(tmp_path: Path) -> None:
    text = " ".join(flock("swarm", "--help-all", cwd=tmp_path).stdout.replace("│", " ").split())
    assert "Length of one mission unit [m]; 1 if unset" in text and "End the swarm after this time [s]" in text
