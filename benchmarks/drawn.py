"""Formations that programs draw: letters read by a stranger, and bodies in space flown.

    python -m benchmarks drawn [--seeds N] [--robots N] [--only letters|space] [--downwash 1,2,3]

`letters`  Each letter and digit is placed on a number of robots and compared with the outlines of all 36 in typefaces
           that matplotlib brings. The nearest one, by the mean distance both ways (Chamfer), is what is read. Both are
           centred and scaled to one height. Nothing is shared with the placement, which draws its own single strokes.
           O and 0 count as one, and so do I and 1. The judge is DejaVu Sans; the other typefaces show how much depends
           on it.
`space`    Bodies in space are flown with ideal *simulated* models: how many teams formed, in how many rounds over the
           lower bound, and how near two robots came, along the segments too. With a downwash the safe distance of 3 is
           an ellipsoid that many times as tall, in whose norm they come near, and sensors reach as far as it asks for.

Writes docs/data/drawn-letters.csv and docs/data/drawn-space.csv, of the latter a row as soon as it is measured.
"""

from __future__ import annotations

import argparse
import csv
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from benchmarks import figures
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from scipy.spatial.distance import cdist

import llm_flock
from llm_flock import shapes
from llm_flock.arrays import Points
from llm_flock.formation import parse_program
from llm_flock.printable import shape_title

DATA = Path(__file__).parents[1] / "docs" / "data"
NAMES = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"
SAME = {"0": "O", "1": "I"}
TYPEFACES = ("DejaVu Sans", "cmss10", "DejaVu Serif", "DejaVu Sans Mono")
LAYERS = parse_program(
    {"name": "two layers", "draw": [{"shape": "circle", "repeat": {"times": 2, "move": [0, 0, 0.8]}}]}
)
BODIES = (("sphere", 12), ("sphere", 30), ("cube", 27), ("helix", 20), ("pyramid", 14), (LAYERS.spec, 20))


def outline(letter: str, typeface: str) -> Points:
    """Points of a printed letter's outlines, one for each two hundredth of its size, shape (m, 2)."""
    path = TextPath((0, 0), letter, size=100, prop=FontProperties(family=typeface))
    rows: list[Points] = []
    for corners in path.to_polygons(closed_only=True):
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
        steps = np.arange(0.0, at[-1], 0.5)
        rows.append(np.column_stack([np.interp(steps, at, axis) for axis in np.asarray(corners).T]))
    return np.concatenate(rows)


def framed(points: Points) -> Points:
    """The points centred, with a height of 1."""
    low, high = points.min(axis=0), points.max(axis=0)
    return (points - (low + high) / 2) / (high[1] - low[1])


def read_as(points: Points, outlines: Mapping[str, Points]) -> str:
    """The letter whose outlines are nearest to some points."""

    def apart(name: str) -> float:
        each = cdist(framed(points), outlines[name])
        return float(each.min(axis=0).mean() + each.min(axis=1).mean())

    return min(outlines, key=apart)


def letters(robots: int) -> list[dict[str, str | int]]:
    table: list[dict[str, str | int]] = []
    placed = {name: shapes.ideal_points(f"letters:{name}", robots, (0.0, 0.0), 10.0) for name in NAMES}
    for typeface in TYPEFACES:
        outlines = {name: framed(outline(name, typeface)) for name in NAMES}
        read = {name: read_as(points, outlines) for name, points in placed.items() if points is not None}
        wrong = [f"{name} as {got}" for name, got in read.items() if SAME.get(name, name) != SAME.get(got, got)]
        right = len(NAMES) - len(wrong)
        row = {"Typeface of the judge": typeface, "Robots": robots, "Read right": f"{right} of {len(NAMES)}"}
        table.append({**row, "Read as another": ", ".join(wrong)})
        print(*table[-1].values(), sep=" · ", flush=True)
    return table


def space(seeds: int, downwash: float) -> Iterator[dict[str, str | int]]:
    for shape, n in BODIES:
        mission = llm_flock.Mission(shape=shape, n_robots=n, downwash=downwash)
        mission = mission.change(sense_range=mission.height_apart + 2 * mission.max_step)
        over, nearest = list[float](), list[float]()
        for seed in range(seeds):
            flown = llm_flock.run(mission, seed=seed, trace=False).summary
            nearest.append(flown.min_separation or 0.0)
            if flown.rounds_to_formed is not None and flown.lower_bound_rounds:
                over.append(flown.rounds_to_formed / flown.lower_bound_rounds)
        row = {"Formation": shape_title(shape).removeprefix("program:"), "Robots": n, "Downwash": f"{downwash:g}"}
        row |= {"Formed": f"{len(over)} of {seeds}"}
        middle = f"{statistics.median(over):.2f}, {max(over):.2f}" if over else ""
        row |= {"Over the bound: median, largest": middle, "Smallest separation": f"{min(nearest):.6f}"}
        print(*row.values(), sep=" · ", flush=True)
        yield row


def beside(row: Mapping[str, str | int]) -> list[Mapping[str, str | int]]:
    """All rows of the file, with this one in place of that of the same body, robots and downwash."""
    with (DATA / "drawn-space.csv").open(encoding="utf-8", newline="") as file:
        rows: list[Mapping[str, str | int]] = [*csv.DictReader(file)]
    of = [tuple(str(one[name]) for name in ("Formation", "Robots", "Downwash")) for one in (*rows, row)]
    at = of.index(of[-1])
    return [*rows[:at], row, *rows[at + 1 :]]


def write(name: str, table: Sequence[Mapping[str, str | int]]) -> None:
    with (DATA / name).open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, table[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    figures.stamp(name)


def main(arguments: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks drawn", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=200, help="flights of each body")
    parser.add_argument("--robots", type=int, default=30, help="robots of a letter")
    parser.add_argument("--downwash", default="1,2,3", help="how many times as tall as wide the safe distance is")
    parser.add_argument("--only", choices=("letters", "space"), help="one of the two")
    parser.add_argument("--print", action="store_true", help="write no files")
    chosen = parser.parse_args(arguments)
    if chosen.only != "space":
        table = letters(chosen.robots)
        if not chosen.print:
            write("drawn-letters.csv", table)
    for downwash in map(float, chosen.downwash.split(",") if chosen.only != "letters" else ()):
        for row in space(chosen.seeds, downwash):
            if not chosen.print:
                write("drawn-space.csv", beside(row))
