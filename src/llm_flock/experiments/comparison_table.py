"""Write a comparison: a table in Markdown, and a CSV file with a line for each trial."""

from __future__ import annotations

import csv
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.experiments.compare import OnResult, Row
from llm_flock.experiments.grid import Cell
from llm_flock.experiments.statistics import Estimate
from llm_flock.experiments.trial import TrialResult

SHOWN_SEEDS = 20
"""Most failed seeds that are listed for a row; JSON has all of them."""

HEADER = (
    "protocol",
    "shape",
    "N",
    "formed % [95 %]",
    "rounds",
    "ratio",
    "min sep.",
    "violations",
    "calls/robot [95 %]",
    "waypoints %",
)

FIGURES = (
    "formed",
    "rounds_to_formed",
    "lower_bound_rounds",
    "stopped",
    "rounds",
    "procrustes_mean",
    "min_separation",
    "start_violations",
    "min_separation_after_start",
    "plans_in_use",
    "distinct_goals",
    "model_calls",
    "calls_rejected",
    "calls_failed",
    "tokens",
    "bytes_per_robot_round",
    "wall_s",
)
"""Fields of `Summary` in a line of the CSV file."""


def markdown(rows: Sequence[Row]) -> str:
    """The rows as a table with aligned columns, and below it the failed seeds and a note on simulated models."""
    lines = [HEADER, *map(_cells, rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(HEADER))]
    texts = ["| " + " | ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)) + " |" for line in lines]
    texts.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    if any(row.simulated for row in rows):
        texts += ["", "simulated language models"]
    return "\n".join([*texts, *(note for row in rows for note in _notes(row))])


def _cells(row: Row) -> tuple[str, ...]:
    return (
        row.protocol,
        row.shape,
        str(row.n_robots),
        _interval(row.formed, 1, factor=100.0),
        _number(row.rounds, "g"),
        _number(row.ratio, ".2f"),
        _number(row.min_separation, ".6f"),
        str(row.violations),
        _interval(row.calls, 2),
        _shares(row.waypoints),
    )


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _interval(estimate: Estimate | None, digits: int, factor: float = 1.0) -> str:
    if estimate is None:
        return "-"
    value = f"{factor * estimate.value:.{digits}f}"
    if estimate.low is None or estimate.high is None:
        return value
    return f"{value} [{factor * estimate.low:.{digits}f}, {factor * estimate.high:.{digits}f}]"


def _shares(counts: dict[str, int]) -> str:
    total = sum(counts.values())
    return ", ".join(f"{who} {100 * count / total:.2f}" for who, count in counts.items()) or "-"


def _notes(row: Row) -> list[str]:
    name = f"{row.protocol} {row.shape} {row.n_robots}"
    lines: list[str] = []
    if row.unsafe_starts:
        later = _number(row.min_separation_after_start, ".6f")
        lines += ["", f"{name}: {row.unsafe_starts} of {row.trials} began with two robots too near each other;"]
        lines[-1] += f" smallest separation once they had come apart: {later}"
    if not row.failed_seeds:
        return lines
    seeds = ", ".join(map(str, row.failed_seeds[:SHOWN_SEEDS]))
    more = len(row.failed_seeds) - SHOWN_SEEDS
    lines += ["", f"{name}: {len(row.failed_seeds)} of {row.trials} not formed, seeds {seeds}"]
    lines[-1] += f", and {more} more" if more > 0 else ""
    if row.broken:
        lines += ["", f"{name}: {row.broken} of these broke off: {'; '.join(row.errors)}"]
    return lines


@contextmanager
def trial_file(path: Path) -> Generator[OnResult]:
    """A CSV file with a line for each trial; yields the function that adds one.

    Each line is handed to the operating system at once. The figures of a trial that broke off stay empty.

    Args:
        path: the file; missing folders are created, an existing file is never overwritten.

    Raises:
        InputError: the file exists, or cannot be created.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("x", newline="", encoding="utf-8")
    except OSError as error:
        if path.exists():
            raise InputError("out", str(path), "a file that is not there yet: none is overwritten") from None
        raise InputError("out", str(path), f"a place that can be written to ({error.strerror})") from None
    with file:
        writer = csv.writer(file)
        writer.writerow(("protocol", "shape", "n_robots", "seed", *FIGURES, "waypoints", "error"))

        def add(cell: Cell, seed: int, result: TrialResult) -> None:
            summary = {} if result.summary is None or result.error is not None else result.summary
            figures = [summary.get(name) for name in FIGURES]
            waypoints = " ".join(f"{who}={count}" for who, count in summary.get("waypoints", {}).items())
            writer.writerow((cell.protocol, cell.shape, cell.n_robots, seed, *figures, waypoints, result.error))
            file.flush()

        yield add
