"""Stand-ins by command."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from command_line import Done, flock

YAML = """
fileversion: 3
robots:
  a: {enabled: true, uri: "udp://127.0.0.1:PORT", initial_position: [0.5, 0, 0], type: cf}
  b: {enabled: true, uri: "URI", initial_position: [1.5, 0, 0], type: cf}
robot_types:
  cf: {}
"""


def stand_ins(*arguments: str) -> Done:
    return flock("stand-ins", *arguments, cwd=Path.cwd(), check=False)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_stand_ins_print_their_addresses_and_positions() -> None:
    port = free_port()
    done = stand_ins("3", "--port", str(port), "--spacing", "0.5", "--seconds", "0.1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        f"udp://127.0.0.1:{port} at 0, 0, 0",
        f"udp://127.0.0.1:{port + 1} at 0.5, 0, 0",
        f"udp://127.0.0.1:{port + 2} at 0, 0.5, 0",
    ]


def test_the_drones_of_a_file(tmp_path: Path) -> None:
    port = free_port()
    path = tmp_path / "crazyflies.yaml"
    path.write_text(YAML.replace("PORT", str(port)).replace("URI", f"udp://127.0.0.1:{port + 1}"))
    done = stand_ins("--crazyflies", str(path), "--seconds", "0.1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1] == f"udp://127.0.0.1:{port + 1} at 1.5, 0, 0"
    path.write_text(YAML.replace("PORT", str(port)).replace("URI", "radio://0/80/2M/E7E7E7E701"))
    done = stand_ins("--crazyflies", str(path), "--seconds", "0.1")
    assert done.returncode == 2 and "robots.b.uri" in done.stderr


def test_a_port_that_is_taken() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        done = stand_ins("1", "--port", str(taken.getsockname()[1]), "--seconds", "0.1")
    assert done.returncode == 2 and "port" in done.stderr


def test_autopilots_call_their_own_ports() -> None:
    pytest.importorskip("pymavlink")
    done = stand_ins("2", "--mavlink", "ardupilot", "--port", "14990", "--spacing", "6", "--seconds", "0.1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["udp://127.0.0.1:14990 at 0, 0, 0", "udp://127.0.0.1:14991 at 6, 0, 0"]
