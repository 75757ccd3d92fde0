"""Swarms from the command line: they end as a whole, and robots started one by one find each other."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import flock

from llm_flock.errors import RecordError
from llm_flock.record._reader import read_record
from llm_flock_swarm._network import watch
from llm_flock_swarm._network.swarm import free_port

MARK = "LLM_FLOCK_TEST"
TEAM = ["--shape", "circle", "--start", "connected", "--seed", "1"]


@pytest.fixture
def mark() -> Iterator[str]:
    """Marks every process that a test starts, by its environment; none may be left."""
    mark = uuid.uuid4().hex
    yield mark
    for pid in marked(mark):
        os.kill(pid, signal.SIGKILL)


def marked(mark: str) -> list[int]:
    """Living processes with this mark."""
    found: list[int] = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes():
                    found.append(int(folder.name))
            except OSError:
                continue  # it has gone meanwhile, or is somebody else's
    return found


def start(mark: str, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "llm_flock", *arguments]
    environment = {**os.environ, MARK: mark}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(count: int, mark: str, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while len(marked(mark)) != count:
        assert time.monotonic() < deadline, f"{len(marked(mark))} processes, not {count}"
        time.sleep(0.1)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_process_is_left_behind(how: signal.Signals, mark: str) -> None:
    swarm = start(
        mark, "swarm", *TEAM, "--robots", "4", "--no-record", "--connect", "", "--model", "simulated:slow", "--quiet"
    )
    wait_for(7, mark)  # the launcher, the one that forks, the world, and four robots
    os.kill(sorted(marked(mark))[-2], signal.SIGSTOP)  # one that cannot listen, and surely runs
    swarm.send_signal(how)
    _, said = swarm.communicate(timeout=20)
    wait_for(0, mark, 10.0)
    if how is not signal.SIGKILL:
        assert swarm.returncode == 130 and "interrupted" in said


def test_a_swarm_reports_as_json(mark: str, tmp_path: Path) -> None:
    swarm = start(mark, "swarm", *TEAM, "--robots", "4", "--connect", "", "--out", str(tmp_path), "--json")
    out, said = swarm.communicate(timeout=100)
    told = json.loads(out)
    assert swarm.returncode == 0 and told["formed"] and told["simulated"] and told["min_separation"] > 3.0 - 1e-6, said
    assert read_record(tmp_path / "run.mcap").states
    assert marked(mark) == []


def test_robots_that_are_started_one_by_one(mark: str, tmp_path: Path) -> None:
    config = tmp_path / "swarm.toml"
    network = f'[network]\nswarm = "one-by-one"\nconnect = "tcp/127.0.0.1:{free_port()}"\n'
    config.write_text(
        f'[mission]\nshape = "circle"\nn_robots = 3\n\n[trial]\nstart = "connected"\n\n{network}', encoding="utf-8"
    )
    world = start(mark, "world", "--config", str(config))
    assert world.stderr is not None and "listens" in world.stderr.readline()
    robots = [start(mark, "robot", "--id", str(k), "--config", str(config)) for k in range(3)]
    watcher = start(mark, "watch", "--config", str(config), "--out", str(tmp_path / "seen"), "--quiet")
    record = tmp_path / "seen" / "run.mcap"
    wait_for_places(record, missions=1)
    mission = start(mark, "mission", "--set", "shape=line", "--set", "center=45,55", "--config", str(config))
    out, said = mission.communicate(timeout=100)
    assert mission.returncode == 0 and "given to robot" in out, said
    wait_for_places(record, missions=2)
    for process in (watcher, *robots, world):
        process.send_signal(signal.SIGTERM)
    for process in (watcher, *robots, world):
        _, said = process.communicate(timeout=20)
        assert process.returncode == 0, said
    found = read_record(record)
    assert [info.mission["shape"] for info in found.missions] == ["circle", "line"]
    assert found.result is not None and found.result["min_separation"] > 3.0 - 1e-6


def wait_for_places(record: Path, *, missions: int) -> None:
    """Wait until the record has this number of missions, and every robot has a place."""
    deadline = time.monotonic() + 100.0
    while time.monotonic() < deadline:
        time.sleep(0.5)
        if record.exists() and record.stat().st_size > 20_000:
            try:
                found = read_record(record)
            except RecordError:  # its start is not yet written
                continue
            if len(found.missions) == missions and None not in found.states[-1].slots:
                return
    raise AssertionError("no robot took a place")


def test_missing_swarm_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watch, "MEET_S", 0.5)
    done = flock(
        "mission", "--set", "shape=line", "--connect", f"tcp/127.0.0.1:{free_port()}", cwd=tmp_path, check=False
    )
    assert done.returncode == 2 and "no swarm answers there" in done.stderr
