"""Cassettes without an end or that cannot be read, and stand-ins that cannot be."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import flock

from llm_flock.llm import _replay as replay


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A short bound: at the real one the command reads 64 MB."""
    monkeypatch.setattr(replay, "MAX_LINE_LENGTH", 1 << 16)


def test_a_cassette_without_an_end_is_refused(tmp_path: Path) -> None:
    done = flock("run", "--no-record", "--model", "replay:/dev/zero", cwd=tmp_path, check=False)
    assert done.returncode in (1, 2) and "error: " in done.stderr and "Traceback" not in done.stderr, done.stderr


def test_a_cassette_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    """As on a disk that fails."""
    done = flock("run", "--no-record", "--model", "replay:/proc/self/mem", cwd=tmp_path, check=False)
    assert done.returncode == 2 and "a cassette that can be read" in done.stderr, done.stderr


def test_a_line_of_a_cassette_has_a_length(tmp_path: Path) -> None:
    path = tmp_path / "long.jsonl"
    path.write_text('{"llm_flock_cassette":1}\n' + "x" * (1 << 17), encoding="ascii")
    done = flock("run", "--no-record", "--model", f"replay:{path}", cwd=tmp_path, check=False)
    assert done.returncode == 1 and "line 2: damaged: a line of 65536 bytes or more" in done.stderr, done.stderr


def test_more_stand_ins_than_ports_are_refused_at_once(tmp_path: Path) -> None:
    done = flock("stand-ins", "30000000", cwd=tmp_path, check=False)
    assert done.returncode == 2 and "at most 65535" in done.stderr, done.stderr


@pytest.mark.parametrize("address", ["udp://127.0.0.1:99999", "udp://127.0.0.1:1e", "udp://[::1", "udp://127.0.0.1"])
def test_stand_ins_for_an_address_that_is_none_are_refused(address: str, tmp_path: Path) -> None:
    path = tmp_path / "drones.yaml"
    robot = f'{{enabled: true, type: t, uri: "{address}", initial_position: [0, 0, 0]}}'
    path.write_text(f"fileversion: 3\nrobot_types: {{t: {{}}}}\nrobots: {{a: {robot}}}\n", encoding="utf-8")
    done = flock("stand-ins", "--crazyflies", str(path), "--seconds", "0", cwd=tmp_path, check=False)
    assert done.returncode == 2 and "udp://HOST:PORT" in done.stderr, done.stderr
