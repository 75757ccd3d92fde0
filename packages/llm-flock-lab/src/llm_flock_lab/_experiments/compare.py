"""Compare protocols: fly the same shapes with the same seeds, and sum up each cell in one row of a table."""

from __future__ import annotations

import csv
import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from llm_flock.errors import InputError
from llm_flock.metrics import ROUNDING
from llm_flock.printable import csv_cell
from llm_flock.record import check_new
from llm_flock.runtime import load_config
from llm_flock_lab._experiments.executors import Display, Session, fly_in_pool
from llm_flock_lab._experiments.grid import Cell, TrialSpec, arena_of, models_of, naming_team
from llm_flock_lab._experiments.statistics import (
    Estimate,
    duration,
    horizon,
    interval,
    mean_interval,
    number,
    restricted_mean,
    wilson,
)
from llm_flock_lab._experiments.tex import tex_table
from llm_flock_lab._experiments.trial import TrialResult

FIGURES = (
    "formed",
    "formed_by_models",
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
    "plan_robot",
    "plan_by",
    "plan_taught",
    "breakers_opened",
    "model_calls",
    "calls_rejected",
    "calls_failed",
    "tokens",
    "bytes_per_robot_round",
    "wall_s",
)
"""Fields of `Summary` in a line of the CSV file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """The figures of one cell; field names are the keys of `--json`."""

    protocol: str
    shape: str
    n_robots: int
    simulated: bool
    trials: int
    formed: Estimate  # share, broken trials too, with Wilson's 95 % interval
    by_models: Estimate  # share formed without help from geometry, likewise
    broken: int
    rounds: Estimate | None  # restricted mean of rounds_to_formed, up to `horizon`; None if all broke off
    ratio: Estimate | None  # the same of rounds_to_formed / lower_bound_rounds, a bound of 0 counted as 1
    horizon: float  # the shortest deadline [rounds] that a trial of this team missed, or else the longest success
    min_separation: float | None  # in any trial, along segments too [units]; None for teams of one
    violations: int  # trials with a separation below safe_distance - `metrics.ROUNDING`
    unsafe_starts: int  # trials with a start nearer than safe_distance
    min_separation_after_start: float | None  # these pairs counted once they had come apart
    calls: Estimate | None  # a robot and trial: mean with Student's 95 % interval; None if all broke off
    waypoints: dict[str, int]  # flown in all trials, by origin
    failed_seeds: tuple[int, ...]  # of the trials not in `formed`
    errors: tuple[str, ...]  # the first of each kind, with its seed


def build_cells(
    teams: Iterable[tuple[str, int]],
    protocols: Sequence[str],
    *,
    file: Path | None = None,
    fit_arena: bool = False,
    **overrides: Any,
) -> list[Cell]:
    """One cell for each team (a shape and a size) and preset, team by team.

    The configuration file and the overrides hold for all of them; None means: not given. With `fit_arena`, the arena of
    each team grows as `grid.fitted_arena` describes.

    Raises:
        InputError: a value is not allowed, for any of the cells.
    """
    cells: list[Cell] = []
    load = partial(load_config, file)
    for shape, n_robots in teams:
        fields = {**overrides, "shape": shape, "n_robots": n_robots}
        with naming_team("cells", f"{shape}/{n_robots}"):
            if fit_arena:
                fields["arena"] = arena_of(load, fields)
            cells.extend(Cell(config=load(**{**fields, "protocol": protocol})) for protocol in protocols)
    return cells


OnResult = Callable[[Cell, int, TrialResult], None]  # called with a trial's cell, its seed and its result


class _Collected(Display):
    def __init__(self, trials: Sequence[tuple[Cell, int]], on_result: OnResult | None) -> None:
        self.results: list[TrialResult] = []
        self._trials = trials
        self._on_result = on_result

    def finished(self, spec: TrialSpec, result: TrialResult) -> None:
        cell, seed = self._trials[len(self.results)]
        self.results.append(result)
        if self._on_result is not None:
            self._on_result(cell, seed, result)


def compare(
    cells: Sequence[Cell], *, trials: int, first_seed: int = 0, jobs: int = 1, on_result: OnResult | None = None
) -> list[Comparison]:
    """Fly every cell with the seeds first_seed .. first_seed + trials - 1; returns one row for each cell.

    All cells get the same seeds, so that protocols start from the same positions. Trials are flown as in a sweep, but
    nothing is stored; `on_result` is called for each, cell by cell, in the order of seeds. With models on board there
    is one job, because their engine uses all cores but one. Workers are spawned: a script that calls this needs its
    `if __name__ == "__main__":` guard.

    Raises:
        InputError: a number is out of its range, or a trial was refused.
        FlockError: a worker was killed.
        KeyboardInterrupt: after all workers were stopped.
    """
    for field, value in (("trials", trials), ("jobs", jobs)):
        if value < 1:
            raise InputError(field, value, "at least 1")
    if any(model.startswith("local:") for cell in cells for model in models_of(cell.config)):
        jobs = 1
    seeds = range(first_seed, first_seed + trials)
    pairs = list(itertools.product(cells, seeds))
    display = _Collected(pairs, on_result)
    specs = [cell.trial(seed, str(number)) for number, (cell, seed) in enumerate(pairs)]
    fly_in_pool(specs, Session(store=None, display=display), jobs)
    results = iter(display.results)
    flown = [dict(zip(seeds, results, strict=False)) for _ in cells]
    beside: defaultdict[tuple[str, int], list[TrialResult]] = defaultdict(list)
    for cell, one in zip(cells, flown, strict=True):
        beside[cell.shape, cell.n_robots].extend(one.values())
    return [row(cell, one, beside[cell.shape, cell.n_robots]) for cell, one in zip(cells, flown, strict=True)]


def row(cell: Cell, results: dict[int, TrialResult], beside: Sequence[TrialResult] | None = None) -> Comparison:
    """The figures of one cell from at least one trial, by seed; all trials of the team, `beside`, share a horizon."""
    known = [r.summary for r in results.values() if r.summary is not None and r.error is None]
    formed = sum(s["formed"] for s in known)
    own, every = ([_figures(r) for r in found] for found in (results.values(), beside or results.values()))
    until, most = horizon(every), horizon(every, over_bound=True)
    separations = [s["min_separation"] for s in known if s["min_separation"] is not None]
    later = [s["min_separation_after_start"] for s in known if s["min_separation_after_start"] is not None]
    limit = cell.config.mission.safe_distance - ROUNDING
    waypoints = Counter[str]()
    for summary in known:
        waypoints.update(summary["waypoints"])
    errors: dict[str, str] = {}
    for seed, result in results.items():
        if result.error is not None:
            errors.setdefault(result.error.partition(":")[0], f"seed {seed}: {result.error}")
    return Comparison(
        protocol=cell.protocol,
        shape=cell.shape,
        n_robots=cell.n_robots,
        simulated=any(s["simulated"] for s in known),
        trials=len(results),
        formed=wilson(formed, len(results)),
        by_models=wilson(sum(s["formed_by_models"] for s in known), len(results)),
        broken=len(results) - len(known),
        rounds=restricted_mean([duration(s) for s in own], until),
        ratio=restricted_mean([duration(s, over_bound=True) for s in own], most),
        horizon=until,
        min_separation=min(separations, default=None),
        violations=sum(separation < limit for separation in separations),
        unsafe_starts=sum(s["start_violations"] > 0 for s in known),
        min_separation_after_start=min(later, default=None),
        calls=mean_interval([s["model_calls"] / s["n_robots"] for s in known], least=0.0),
        waypoints=dict(sorted(waypoints.items())),
        failed_seeds=tuple(seed for seed, result in results.items() if not result.formed),
        errors=tuple(errors.values()),
    )


def _figures(result: TrialResult) -> Mapping[str, Any]:
    """The summary of a trial; one that broke off has formed nothing, whatever it had come to."""
    broken = {"stopped": "failed", "formed": False, "lower_bound_rounds": None, "rounds": None}
    return broken if result.summary is None or result.error is not None else result.summary


COLUMNS: tuple[tuple[str, Callable[[Comparison], str]], ...] = (
    ("protocol", lambda row: row.protocol),
    ("shape", lambda row: row.shape),
    ("N", lambda row: str(row.n_robots)),
    ("formed % [95 %]", lambda row: interval(row.formed, 1, 100.0)),
    ("by models %", lambda row: f"{100.0 * row.by_models.value:.1f}"),
    ("rounds [95 %]", lambda row: interval(row.rounds, 1)),
    ("ratio [95 %]", lambda row: interval(row.ratio, 2)),
    ("min sep.", lambda row: number(row.min_separation, 3)),
    ("violations", lambda row: str(row.violations)),
    ("calls/robot [95 %]", lambda row: interval(row.calls, 2)),
    ("waypoints %", lambda row: _shares(row.waypoints)),
)


def markdown(rows: Sequence[Comparison]) -> str:
    """The rows as a table with aligned columns, and below it the failed seeds and a note on simulated models."""
    lines = [[name for name, _ in COLUMNS], *([text(row) for _, text in COLUMNS] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = ["| " + " | ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)) + " |" for line in lines]
    texts.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join([*texts, *notes(rows)])


def latex(rows: Sequence[Comparison]) -> str:
    """The rows as a table in LaTeX for a page of two columns, in footnotesize; what it has no room for is commented."""
    *columns, (_, shares) = COLUMNS
    table = tex_table([name for name, _ in columns], [[text(row) for _, text in columns] for row in rows], 2)
    told = [f"waypoints of {row.protocol} {row.shape} {row.n_robots}: {shares(row)} %" for row in rows]
    return "\n".join([table, *(f"% {note}" for note in [*told, *notes(rows)] if note)])


def notes(rows: Sequence[Comparison]) -> list[str]:
    """The lines below a table of these rows: failed seeds, unsafe starts, and whether models were simulated."""
    simulated = ["simulated language models"] if any(row.simulated for row in rows) else []
    limits = {f"{row.shape} {row.n_robots}": row.horizon for row in rows if row.rounds is not None}
    ends = ", ".join(f"{number(until, 0)} ({team})" for team, until in limits.items())
    simulated += [f"rounds are restricted means, in which longer ones and failures count as {ends}"] if limits else []
    found = [*simulated, *itertools.chain.from_iterable(map(_notes, rows))]
    return [line for note in found for line in ("", note)]


def _shares(counts: dict[str, int]) -> str:
    total = sum(counts.values())
    return ", ".join(f"{who} {100 * count / total:.2f}" for who, count in counts.items() if count) or "-"


def _notes(row: Comparison) -> Iterator[str]:
    name = f"{row.protocol} {row.shape} {row.n_robots}"
    if row.unsafe_starts:
        later = number(row.min_separation_after_start, 6)
        yield (
            f"{name}: {row.unsafe_starts} of {row.trials} began with two robots too near each other;"
            f" smallest separation once they had come apart: {later}"
        )
    if row.failed_seeds:
        seeds, more = ", ".join(map(str, row.failed_seeds[:20])), len(row.failed_seeds) - 20
        others = f", and {more} more" if more > 0 else ""
        yield f"{name}: {len(row.failed_seeds)} of {row.trials} not formed, seeds {seeds}{others}"
    if row.broken:
        yield f"{name}: {row.broken} of these broke off: {'; '.join(row.errors)}"


@contextmanager
def trial_file(path: Path) -> Generator[OnResult]:
    """A new CSV file; yields what adds a trial's line, and hands it to the system. Broken trials have no figures."""
    check_new(path)
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("protocol", "shape", "n_robots", "seed", *FIGURES, "waypoints", "error"))

        def add(cell: Cell, seed: int, result: TrialResult) -> None:
            summary = {} if result.summary is None or result.error is not None else result.summary
            figures = [summary.get(name) for name in FIGURES]
            waypoints = " ".join(f"{who}={count}" for who, count in summary.get("waypoints", {}).items())
            row = (cell.protocol, cell.shape, cell.n_robots, seed, *figures, waypoints, result.error)
            writer.writerow(map(csv_cell, row))
            file.flush()

        yield add
