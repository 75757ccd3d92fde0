"""Compare protocols: fly the same shapes with the same seeds, and sum up each cell in one row of figures."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from llm_flock.errors import InputError
from llm_flock.experiments.executors import Display, Session, fly_in_pool
from llm_flock.experiments.grid import Cell, TrialSpec, arena_of, models_of
from llm_flock.experiments.statistics import Estimate, mean_interval, median, wilson
from llm_flock.experiments.trial import TrialResult
from llm_flock.runtime.config import load_config

TOLERANCE = 1e-6
"""Robots nearer than the safe distance by more than this are a violation [units]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """The figures of one cell; field names are the keys of `--json`.

    Attributes:
        protocol: preset of rules.
        shape: the mission's shape.
        n_robots: team size N.
        simulated: whether any language model was a simulated stand-in.
        trials: all of them; those that broke off count as not formed.
        formed: share of formed trials (see `Summary.formed`), with Wilson's 95 % interval.
        broken: trials that broke off.
        rounds: median of rounds_to_formed over the formed trials; None without any.
        ratio: median of rounds_to_formed / lower_bound_rounds over the formed trials, a bound of 0 counted as 1.
        min_separation: smallest separation in any trial, along segments too [units]; None for teams of one.
        violations: trials in which two robots were nearer than safe_distance by more than `TOLERANCE`.
        unsafe_starts: trials in which two robots were nearer than safe_distance at the start.
        min_separation_after_start: as min_separation, but these pairs counted only once they had come apart [units].
        calls: model calls per robot and trial: mean with Student's 95 % interval; None if all trials broke off.
        waypoints: waypoints flown in all trials, by origin.
        failed_seeds: seeds of the trials that are not in `formed`.
        errors: what broke trials off, the first of each kind, with its seed.
    """

    protocol: str
    shape: str
    n_robots: int
    simulated: bool
    trials: int
    formed: Estimate
    broken: int
    rounds: float | None
    ratio: float | None
    min_separation: float | None
    violations: int
    unsafe_starts: int
    min_separation_after_start: float | None
    calls: Estimate | None
    waypoints: dict[str, int]
    failed_seeds: tuple[int, ...]
    errors: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def build_cells(
    teams: Iterable[tuple[str, int]],
    protocols: Sequence[str],
    *,
    file: Path | None = None,
    fit_arena: bool = False,
    **overrides: Any,
) -> list[Cell]:
    """One cell for each team and protocol, team by team.

    Args:
        teams: shape and size of each team.
        protocols: names of presets.
        file: configuration file.
        fit_arena: grow the arena of each team as `grid.fitted_arena` does.
        overrides: settings by name, the same for all; None means: not given.

    Raises:
        InputError: a value is not allowed, for any of the cells.
    """
    cells: list[Cell] = []
    load = partial(load_config, file)
    for shape, n_robots in teams:
        fields = {**overrides, "shape": shape, "n_robots": n_robots}
        if fit_arena:
            fields["arena"] = arena_of(load, fields)
        cells.extend(Cell(config=load(**{**fields, "protocol": protocol})) for protocol in protocols)
    return cells


OnResult = Callable[[Cell, int, TrialResult], None]
"""Called with a trial's cell, its seed and its result."""


class _InOrder(Display):
    """Passes results on in the order of the trials, whichever finishes first."""

    def __init__(self, trials: Sequence[tuple[Cell, int]], on_result: OnResult | None) -> None:
        self.results: list[TrialResult] = []
        self._trials = trials
        self._on_result = on_result
        self._early: dict[int, TrialResult] = {}

    def finished(self, spec: TrialSpec, result: TrialResult, *, fresh: bool) -> None:
        """See `Display`."""
        self._early[int(spec.id)] = result
        while (found := self._early.pop(len(self.results), None)) is not None:
            cell, seed = self._trials[len(self.results)]
            self.results.append(found)
            if self._on_result is not None:
                self._on_result(cell, seed, found)


def compare(
    cells: Sequence[Cell], *, trials: int, first_seed: int = 0, jobs: int = 1, on_result: OnResult | None = None
) -> list[Row]:
    """Fly every cell with the seeds first_seed .. first_seed + trials - 1; returns one row for each cell.

    All cells get the same seeds, so that protocols start from the same positions. Trials are flown as in a sweep, but
    nothing is stored. Workers are spawned: a script that calls this needs its `if __name__ == "__main__":` guard.

    Args:
        cells: the cells to compare.
        trials: number of trials of each cell, at least 1.
        first_seed: seed of the first trial of each cell.
        jobs: processes at most. With models on board it is one, because their engine uses all cores but one.
        on_result: called for each trial, cell by cell, in the order of seeds.

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
    display = _InOrder(pairs, on_result)
    specs = [cell.trial(seed, str(number)) for number, (cell, seed) in enumerate(pairs)]
    fly_in_pool(specs, Session(store=None, display=display), jobs)
    results = iter(display.results)
    return [row(cell, dict(zip(seeds, results, strict=False))) for cell in cells]


def row(cell: Cell, results: dict[int, TrialResult]) -> Row:
    """The figures of one cell from at least one trial; results are given by seed."""
    known = [r.summary for r in results.values() if r.summary is not None and r.error is None]
    flown = [(s["rounds_to_formed"] or 0, s["lower_bound_rounds"] or 0) for s in known if s["formed"]]
    separations = [s["min_separation"] for s in known if s["min_separation"] is not None]
    later = [s["min_separation_after_start"] for s in known if s["min_separation_after_start"] is not None]
    limit = cell.config.mission.safe_distance - TOLERANCE
    waypoints = Counter[str]()
    for summary in known:
        waypoints.update(summary["waypoints"])
    errors: dict[str, str] = {}
    for seed, result in results.items():
        if result.error is not None:
            errors.setdefault(result.error.partition(":")[0], f"seed {seed}: {result.error}")
    return Row(
        protocol=cell.protocol,
        shape=cell.shape,
        n_robots=cell.n_robots,
        simulated=any(s["simulated"] for s in known),
        trials=len(results),
        formed=wilson(len(flown), len(results)),
        broken=len(results) - len(known),
        rounds=median([rounds for rounds, _ in flown]),
        ratio=median([rounds / max(1, bound) for rounds, bound in flown]),
        min_separation=min(separations, default=None),
        violations=sum(separation < limit for separation in separations),
        unsafe_starts=sum(s["start_violations"] > 0 for s in known),
        min_separation_after_start=min(later, default=None),
        calls=mean_interval([s["model_calls"] / s["n_robots"] for s in known]),
        waypoints=dict(sorted(waypoints.items())),
        failed_seeds=tuple(seed for seed, result in results.items() if not result.formed),
        errors=tuple(errors.values()),
    )
