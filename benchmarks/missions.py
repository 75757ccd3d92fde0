"""Missions in words of the kinds that others publish (GenSwarm, npj Robotics 2026; LAN2CB), flown and judged by code.

    python -m benchmarks missions [--seeds N] [--print]     10 seeds

A *simulated* reader knows the sentences of this module and their typed answers: nobody reads them. What it answers is
compiled, said back and flown by the team with ideal *simulated* models, as `llm-flock run --words` does it. The judge
looks at true positions only, and shares nothing with the placement of robots. Thresholds are those of GenSwarm where it
has one: Procrustes below 0.1 for a shape, 10 % of the distance around a target, 80 % of an area.

Writes docs/data/missions.csv.
"""

from __future__ import annotations

import argparse
import asyncio
import csv
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import figures
from scipy.spatial import procrustes
from scipy.spatial.distance import cdist

import llm_flock
from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.llm import MissionReader
from llm_flock.runtime import RunResult

DATA = Path(__file__).parents[1] / "docs" / "data"
Judge = Callable[[RunResult], float]


@dataclass(frozen=True, kw_only=True)
class Task:
    """A sentence, its typed answer, and how its flights are judged."""

    kind: str
    words: str
    answer: dict[str, Any]
    measure: str = ""  # what the judge measures, and the threshold
    judge: Judge | None = None
    passes: Callable[[float], bool] = bool
    radio: float = 15.0


def _parts(*stages: Sequence[dict[str, Any]] | dict[str, Any], robots: int, hold: int = 0) -> dict[str, Any]:
    """A typed answer with these stages; a stage of one part may leave out the list."""
    given: list[dict[str, Any]] = [{"parts": [stage] if isinstance(stage, dict) else list(stage)} for stage in stages]
    given[-1]["hold"] = hold
    return {"answer": "mission", "robots": robots, "stages": given}


def _seen(rows: Points, low: float, high: float, reach: float) -> float:
    """Share of a square field within reach of any of some positions."""
    axis = np.arange(low, high + 0.5)
    field = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return float((cdist(field, rows).min(axis=1) <= reach).mean())


def _around(rows: Points, target: Sequence[float], distance: float) -> float:
    """Largest error of the distance from a target, as a share; infinite where a gap is wider than twice the mean."""
    offset = rows - np.array(target)
    angles = np.sort(np.arctan2(offset[:, 1], offset[:, 0]))
    gaps = np.diff([*angles, angles[0] + 2 * np.pi])
    even = bool(gaps.max() <= 4 * np.pi / len(rows))
    return float(np.abs(np.linalg.norm(offset, axis=1) / distance - 1).max()) if even else np.inf


def _bridge(flown: RunResult) -> float:
    rows = flown.positions[-1][np.argsort(flown.positions[-1][:, 0])]
    ends = max(np.linalg.norm(rows[0] - [20, 50]), np.linalg.norm(rows[-1] - [80, 50]))
    return float(max(ends, np.linalg.norm(np.diff(rows, axis=0), axis=1).max() - 60 / 9))


def _crossed(flown: RunResult) -> float:
    """Share of the robots of each half that end on the other side."""
    start, end = flown.positions[0][:, 0], flown.positions[-1][:, 0]
    west = np.zeros(len(start), dtype=bool)
    west[np.argsort(start)[: len(start) // 2]] = True
    return float(((end > 50) == west).mean())


def _aligned(flown: RunResult) -> float:
    """Largest difference of a robot's way in the last ten rounds from the one that the words say, as a share."""
    wanted = 10 * np.array([1.0, 1.0])
    moved = flown.positions[-1] - flown.positions[-11]
    return float(np.linalg.norm(moved - wanted, axis=1).max() / np.linalg.norm(wanted))


def _star(flown: RunResult) -> float:
    """Procrustes distance from a star of twenty, each robot matched with the tip or dent in its direction."""
    rows = flown.positions[-1] - flown.positions[-1].mean(axis=0)
    turn = np.arctan2(*rows[np.linalg.norm(rows, axis=1).argmax()][::-1])
    edge = 1 / (2 * np.sin(np.pi / 5))  # radius of the inner pentagon with sides of 1
    tips = [(edge * np.cos(np.pi / 5) + np.sqrt(0.75)) * np.exp(1j * (turn + k * 2 * np.pi / 5)) for k in range(5)]
    dents = [edge * np.exp(1j * (turn + (2 * k + 1) * np.pi / 5)) for k in range(5)]
    corners = [corner for pair in zip(tips, dents, strict=True) for corner in pair]
    ideal = np.array(
        [a + share * (b - a) for a, b in zip(corners, corners[1:] + corners[:1], strict=True) for share in (0, 0.5)]
    )
    points: Points = np.column_stack([np.real(ideal), np.imag(ideal)])
    scaled = points * np.linalg.norm(rows, axis=1).max() / np.linalg.norm(points, axis=1).max()
    return float(procrustes(scaled[cdist(rows, scaled).argmin(axis=1)], rows)[2])


def _in_turn(flown: RunResult) -> float:
    """The error around the target at the end; infinite unless both stages formed, the first in two places."""
    first, last = flown.summary.missions[0], flown.summary.missions[-1]
    if first.formed is None or last.formed is None or len(flown.summary.missions) != 2:
        return np.inf
    then, start = flown.positions[last.round - 1], flown.positions[0]
    west = set(np.argsort(start[:, 0])[:3].tolist())
    there = set(np.flatnonzero(np.linalg.norm(then - [30, 50], axis=1) < 10).tolist())
    return _around(flown.positions[-1], (50, 50), 20.0) if there == west else np.inf


TASKS = (
    Task(
        kind="aggregate",
        words="Ten of you, come together in the middle as close as eight units.",
        answer=_parts({"shape": "circle", "fill": True, "center": [50, 50], "spacing": 8}, robots=10),
        measure="farthest from the middle <= 15",
        passes=lambda far: far <= 15,
        judge=lambda flown: float(np.linalg.norm(flown.positions[-1] - 50, axis=1).max()),
    ),
    Task(
        kind="bridge",
        words="Ten robots make a bridge from 20, 50 to 80, 50.",
        answer=_parts({"shape": "line", "point": "east", "center": [50, 50], "size": 60}, robots=10),
        measure="ends and gaps off by <= 1",
        passes=lambda off: off <= 1,
        judge=_bridge,
    ),
    Task(
        kind="cover",
        words="Sixteen robots spread over the square from 20, 20 to 80, 80.",
        answer=_parts({"shape": "square", "fill": True, "center": [50, 50], "size": 50, "turn": 0}, robots=16),
        measure="area within 10 of a robot >= 0.8",
        passes=lambda share: share >= 0.8,
        radio=25.0,
        judge=lambda flown: _seen(flown.positions[-1], 20, 80, 10.0),
    ),
    Task(
        kind="cross",
        words="Ten robots: the left half goes over to the right, and the right half to the left.",
        answer=_parts(
            [
                {"who": {"count": 5, "side": "left"}, "shape": "line", "point": "north", "center": [80, 50]},
                {"who": {"count": 5, "side": "right"}, "shape": "line", "point": "north", "center": [20, 50]},
            ],
            robots=10,
        ),
        measure="robots on the other side = 1",
        passes=lambda share: share == 1,
        judge=_crossed,
        radio=100.0,
    ),
    Task(
        kind="encircle",
        words="Eight drones, surround the target at 60, 40 at a distance of 15.",
        answer=_parts({"shape": "circle", "center": [60, 40], "size": 30}, robots=8),
        measure="error of the distance <= 0.1",
        passes=lambda error: error <= 0.1,
        judge=lambda flown: _around(flown.positions[-1], (60, 40), 15.0),
    ),
    Task(
        kind="explore",
        words="Ten robots in a line from south to north sweep the field to the east, two units a round.",
        answer=_parts(
            {"shape": "line", "point": "north", "center": [10, 50], "spacing": 9, "velocity": [2, 0]},
            robots=10,
            hold=45,
        ),
        measure="area within 6 of a robot's way >= 0.8",
        passes=lambda share: share >= 0.8,
        judge=lambda flown: _seen(flown.positions.reshape(-1, 2), 10, 90, 6.0),
    ),
    Task(
        kind="flock",
        words="Nine robots travel together to the north-east, one unit each way a round, eight apart.",
        answer=_parts({"shape": "grid", "center": [30, 30], "spacing": 8, "velocity": [1, 1]}, robots=9, hold=15),
        measure="ways off by <= 0.05",
        passes=lambda off: off <= 0.05,
        judge=_aligned,
    ),
    Task(
        kind="shape",
        words="Twenty of you show a five-pointed star.",
        answer=_parts({"shape": "star"}, robots=20),
        measure="Procrustes < 0.1",
        passes=lambda error: error < 0.1,
        judge=_star,
    ),
    Task(
        kind="sub-teams in sequence",
        words="The left three of nine to 30, 50 as a triangle, the others a line at 70, 50; then enclose 50, 50 at 20.",
        answer=_parts(
            [
                {"who": {"count": 3, "side": "left"}, "shape": "triangle", "center": [30, 50], "spacing": 8},
                {"shape": "line", "point": "north", "center": [70, 50], "spacing": 8},
            ],
            {"shape": "circle", "center": [50, 50], "size": 40},
            robots=9,
        ),
        measure="error of the distance <= 0.1",
        passes=lambda error: error <= 0.1,
        judge=_in_turn,
        radio=100.0,
    ),
    Task(
        kind="herd",
        words="Drive the sheep into the pen at 80, 80.",
        answer={"answer": "refuse", "because": "Robots that know positions of each other only cannot see sheep."},
    ),
    Task(
        kind="pursue",
        words="Follow the intruder wherever it flies.",
        answer={
            "answer": "refuse",
            "because": "A formation has a centre that is given, and cannot follow what it does not know.",
        },
    ),
)


def fly(task: Task, reader: MissionReader, seeds: int) -> dict[str, str | int]:
    """One line of the table: how many of the seeds the judge passed, and the worst value."""
    row: dict[str, str | int] = {
        "Kind": task.kind,
        "Words": task.words,
        "Radio": f"{task.radio:g}",
        "Judged by": task.measure or "-",
    }
    try:
        draft = asyncio.run(reader.read(task.words, llm_flock.Mission(comm_range=task.radio)))
    except InputError as error:
        return {**row, "Passed": "cannot be expressed", "Worst": "-", "Smallest separation": str(error.says)}
    assert task.judge is not None, f"{task.words} was to be refused"
    found, nearest = list[float](), list[float]()
    for seed in range(seeds):
        flown = llm_flock.run(draft.mission, seed=seed, trace=False)
        found.append(task.judge(flown) if flown.formed else np.nan)
        nearest.append(flown.summary.min_separation or 0.0)
    passed = sum(bool(task.passes(value)) for value in found)
    worst = max(found, key=lambda value: (np.isnan(value), not task.passes(value), value))
    if task.measure.endswith((">= 0.8", "= 1")):
        worst = min(found)
    said = "not formed" if np.isnan(worst) else f"{worst:.3g}"
    return {**row, "Passed": f"{passed} of {seeds}", "Worst": said, "Smallest separation": f"{min(nearest):.3f}"}


def main(arguments: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks missions", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--seeds", type=int, default=10, help="flights of each mission")
    parser.add_argument("--print", action="store_true", help="write no file")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sentences.json"
        path.write_text(json.dumps({task.words: task.answer for task in TASKS}), encoding="utf-8")
        reader = MissionReader(f"simulated:reader:{path}")
        table: list[dict[str, str | int]] = []
        for task in TASKS:
            table.append(fly(task, reader, given.seeds))
            print(*table[-1].values(), sep=" · ", flush=True)
    if given.print:
        return
    with (DATA / "missions.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, table[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    figures.stamp("missions.csv")
