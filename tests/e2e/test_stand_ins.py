"""Stand-ins by command."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

ENV = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
YAML = """
fileversion: 3
robots:
  a: {enabled: true, uri: "udp://127.0.0.1:PORT", initial_position: [0.5, 0, 0], type: cf}
  b: {enabled: true, uri: "URI", initial_position: [1.5, 0, 0], type: cf}
robot_types:
  cf: {}
"""


def flock(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "llm_flock", "stand-ins", *arguments],
        env=ENV,
        capture_output=True,
        text=True,
        timeout=60,
    )


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_they_say_where_they_are() -> None:
    port = free_port()
    done = flock("3", "--port", str(port), "--spacing", "0.5", "--seconds", "0.1")
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
    done = flock("--crazyflies", str(path), "--seconds", "0.1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1] == f"udp://127.0.0.1:{port + 1} at 1.5, 0, 0"
    path.write_text(YAML.replace("PORT", str(port)).replace("URI", "radio://0/80/2M/E7E7E7E701"))
    done = flock("--crazyflies", str(path), "--seconds", "0.1")
    assert done.returncode == 2 and "robots.b.uri" in done.stderr


def test_a_port_that_is_taken() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        done = flock("1", "--port", str(taken.getsockname()[1]), "--seconds", "0.1")
    assert done.returncode == 2 and "port" in done.stderr
