"""Readings of the paper beside each other, with and without consensus: docs/explanation/readings.md.

    python -m benchmarks.readings [--trials N] [--few N] [--jobs J] [--out FILE]     one process a core

A row of the four readings and of the default protocol has 1,000 trials, with random and with canonical plans; a row of
a variation, and of robots that all take the first place, has 100.

Each reading flies the paper's four shapes from the same seeded starts (uniform in the arena) with *simulated* ideal
models of three habits. Beside the share formed stands the mean error at the end, and how much lower it is than without
consensus, paired by seed. Only `flock` starts separated and has a shield: it refuses starts that are too near.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import figures

import llm_flock
from llm_flock_lab._experiments.statistics import Estimate, mean_interval, wilson

OUT = Path(__file__).parents[1] / "docs" / "data" / "readings.csv"
TEAMS = (("triangle", 3), ("triangle", 6), ("square", 8), ("circle", 10))
HABITS = {
    "random, own id": "simulated:ideal",
    "canonical, own id": "simulated:canonical",
    "canonical, first": "simulated:canonical,first",
}
MAIN = ("random, own id", "canonical, own id")
ROUNDS = 60
FORMED, LOWER = "formed (per cent)", "lower than without consensus (units)"

READINGS: dict[str, dict[str, Any]] = {
    "paper": {"protocol": "paper"},
    "paper, ties to the lowest id": {"protocol": "paper", "ties": "lowest-id"},
    "paper-literal": {"protocol": "paper-literal"},
    "released": {"protocol": "released"},
    "released, without its check": {"protocol": "released", "collision_check": "none"},
    "released, its parameters": {"protocol": "released", "spacing": 13, "safe_distance": 5, "comm_range": 30},
    "baseline": {"protocol": "baseline"},
    "flock": {"protocol": "flock", "start": "separated"},
}
"""Options of each reading; one with a comma in its name is a variation."""


@dataclass(frozen=True, kw_only=True)
class Flown:
    """The outcome of one trial; lengths in units."""

    formed: bool
    error: float
    min_separation: float


def fly(options: dict[str, Any], team: tuple[str, int], seed: int) -> Flown:
    shape, n = team
    given = {"start": "uniform", "rounds": ROUNDS, "trace": False} | options
    result = llm_flock.run(llm_flock.Mission(shape=shape, n_robots=n), seed=seed, **given).summary
    assert result.procrustes_mean is not None and result.min_separation is not None
    return Flown(formed=result.formed, error=result.procrustes_mean, min_separation=result.min_separation)


def text(estimate: Estimate | None, factor: float = 1.0, digits: int = 1) -> str:
    if estimate is None:
        return ""
    value, low, high = (
        "" if x is None else f"{factor * x:.{digits}f}" for x in (estimate.value, estimate.low, estimate.high)
    )
    return f"{value} [{low}, {high}]"


def rows(many: int, few: int, jobs: int) -> list[dict[str, str | int]]:
    """One row for each reading, habit and team, in this order."""
    table: list[dict[str, str | int]] = []
    with ProcessPoolExecutor(jobs) as pool:
        for habit, model in HABITS.items():
            for team in TEAMS:
                flown: dict[str, list[Flown]] = {}
                for reading, options in READINGS.items():
                    trial = partial(fly, options | {"model": model}, team)
                    seeds = range(many if habit in MAIN and "," not in reading else few)
                    flown[reading] = list(pool.map(trial, seeds, chunksize=5))
                alone = [one.error for one in flown["baseline"]]
                for reading, results in flown.items():
                    trials = len(results)
                    lower = [b - one.error for b, one in zip(alone, results, strict=False)]
                    table.append(
                        {
                            "plans and first places": habit,
                            "shape": team[0],
                            "robots": team[1],
                            "reading": reading,
                            "trials": trials,
                            FORMED: text(wilson(sum(one.formed for one in results), trials), 100),
                            "mean error (units)": text(mean_interval([one.error for one in results]), digits=2),
                            LOWER: ""
                            if reading in ("baseline", "released, its parameters")
                            else text(mean_interval(lower), digits=2),
                            "smallest separation (units)": f"{min(one.min_separation for one in results):.3f}",
                        }
                    )
                    print(*table[-1].values(), sep=" | ", flush=True)
    return table


def pivot(table: list[dict[str, str | int]], figure: str) -> list[dict[str, str | int]]:
    """One row for each habit and reading, one column for each team."""
    found: dict[tuple[str, str], dict[str, str | int]] = {}
    for row in table:
        key = str(row["plans and first places"]), str(row["reading"])
        line = found.setdefault(key, {"plans and first places": key[0], "reading": key[1], "trials": row["trials"]})
        line[f"{row['shape']} {row['robots']}"] = row[figure]
    return list(found.values())


def write(path: Path, table: list[dict[str, str | int]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, table[0])
        writer.writeheader()
        writer.writerows(table)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--few", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args(arguments)
    table = rows(given.trials, given.few, given.jobs)
    write(given.out, table)
    write(given.out.with_stem(f"{given.out.stem}-formed"), pivot(table, FORMED))
    write(given.out.with_stem(f"{given.out.stem}-error"), pivot(table, LOWER))
    if given.out == OUT:
        figures.stamp("readings.csv", "readings-formed.csv", "readings-error.csv")


if __name__ == "__main__":
    main()
