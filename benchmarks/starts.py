"""How long each command takes to start: to its help, and to an error. Processor time too, which load changes less."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

MISSING = "no-such-file"
LINES: tuple[str, ...] = (
    "",
    "--help",
    "no-such-command",
    "models",
    "shapes",
    "doctor --no-drones",
    "distill --help",
    "view --help",
    f"view {MISSING}",
    "run --help",
    "run --shape triangle --robots 10",
    "compare --cells nothing",
    f"sweep {MISSING}",
    f"report {MISSING}",
    f"export {MISSING}",
    "fly --config no-such-file",
    "swarm --robots 0",
    "robot --id 99",
    "mission --set nothing",
    f"inspect {MISSING}",
    f"figure {MISSING}",
    f"animate {MISSING}",
    "keys . --robots 2",
)
"""A line for each command. None of them flies, draws or writes anything."""

RUNS = 3


def measure() -> None:
    """Print a line for each command: the smallest wall and processor time of some starts, and its exit code."""
    print(f"{'llm-flock ...':40} {'wall [s]':>8} {'processor [s]':>14} {'code':>5}")
    for line in LINES:
        walls: list[float] = []
        works: list[float] = []
        code = 0
        for _ in range(RUNS + 1):  # the first one may write byte code
            before, began = os.times(), time.perf_counter()
            command = [sys.executable, "-m", "llm_flock", *line.split()]
            code = subprocess.run(command, capture_output=True, check=False, cwd=Path(__file__).parents[1]).returncode
            after = os.times()
            walls.append(time.perf_counter() - began)
            works.append(after.children_user + after.children_system - before.children_user - before.children_system)
        print(f"{line or '(none)':40} {min(walls[1:]):8.2f} {min(works[1:]):14.2f} {code:5}", flush=True)
