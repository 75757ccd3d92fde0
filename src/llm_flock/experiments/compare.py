"""Protocols side by side: the same shapes, the same seeds, and one row of figures for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from llm_flock import formations
from llm_flock.errors import InputError
from llm_flock.experiments.arena import fitted_arena
from llm_flock.experiments.statistics import Estimate, mean_interval, median, wilson
from llm_flock.experiments.trials import Outcome, run_trials
from llm_flock.runtime.config import RunConfig, load_config

TOLERANCE = 1e-6
"""Robots nearer than the safe distance by more than this are a violation [units]."""


UNDISTURBED: Mapping[str, Any] = {"kill": "", "join": "", "kill_random": 0, "join_random": 0, "changes": ()}
"""A run in which nothing happens in flight."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What one row of the table is about: many trials that differ in their seed only."""

    config: RunConfig

    @property
    def protocol(self) -> str:
        """Name of the preset."""
        return self.config.protocol.protocol

    @property
    def shape(self) -> str:
        """The mission's shape."""
        return self.config.mission.shape

    @property
    def n_robots(self) -> int:
        """Team size N."""
        return self.config.mission.n_robots

    def with_seed(self, seed: int) -> RunConfig:
        """The configuration of one trial."""
        return self.config.model_copy(update={"trial": self.config.trial.model_copy(update={"seed": seed})})


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
        violations: trials in which two robots were nearer than safe_distance by more than 1e-6.
        unsafe_starts: trials in which two robots were too near each other before they began.
        min_separation_after_start: as min_separation, but these pairs counted only once they had come apart [units].
        calls: model calls per robot and trial: mean with Student's 95 % interval; None if all trials broke off.
        waypoints: waypoints flown in all trials, by who made them.
        failed_seeds: every trial that is not in `formed`.
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


def parse_teams(text: str) -> list[tuple[str, int]]:
    """Read `SHAPE/N,SHAPE/N,...`: `triangle/6,circle/10`.

    Raises:
        InputError: for field `cells`.
    """
    teams: list[tuple[str, int]] = []
    for part in text.split(","):
        shape, slash, count = part.strip().rpartition("/")
        if not (slash and shape and count.isascii() and count.isdecimal() and len(count) <= 9):
            raise InputError("cells", text, "SHAPE/N with commas between them, such as triangle/6,circle/10")
        teams.append((shape, int(count)))
    return teams


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
        teams: shape and team size of each.
        protocols: names of presets.
        file: configuration file.
        fit_arena: grow the arena of each team as `arena.fitted_arena` does.
        overrides: fields of the configuration, the same for all; None means: not given.

    Raises:
        InputError: a value is not allowed, for any of the cells.
    """
    cells: list[Cell] = []
    for shape, n_robots in teams:
        given = {**overrides, "shape": shape, "n_robots": n_robots}
        if fit_arena:
            # A team of one without a shape fits everywhere: this reads what was given, and nothing of it is refused.
            team = load_config(file, **{**overrides, "shape": "text:anything", "n_robots": 1, **UNDISTURBED}).mission
            points = formations.load_points(Path(shape.partition(":")[2])) if shape.startswith("points:") else None
            name = shape if points is None else "points"
            given["arena"] = fitted_arena(team, name, n_robots, points)
        cells.extend(Cell(config=load_config(file, **given, protocol=protocol)) for protocol in protocols)
    return cells


def compare(
    cells: Sequence[Cell],
    *,
    trials: int,
    first_seed: int = 0,
    jobs: int = 1,
    on_outcome: Callable[[Cell, Outcome], None] | None = None,
) -> list[Row]:
    """Fly every cell with the seeds first_seed .. first_seed + trials - 1; returns one row for each.

    Args:
        cells: what is compared.
        trials: for each cell, at least 1.
        first_seed: the same seeds for all cells, so that protocols start from the same positions.
        jobs: processes at most.
        on_outcome: told of each trial, cell by cell, in the order of seeds.

    Raises:
        InputError: a number is out of its range, or a trial was refused.
        FlockError: a worker was killed.
        KeyboardInterrupt: after all workers were stopped.
    """
    if trials < 1:
        raise InputError("trials", trials, "at least 1")
    configs = [cell.with_seed(seed) for cell in cells for seed in range(first_seed, first_seed + trials)]
    seen = 0

    def tell(outcome: Outcome) -> None:
        nonlocal seen
        if on_outcome is not None:
            on_outcome(cells[seen // trials], outcome)
        seen += 1

    outcomes = run_trials(configs, jobs=jobs, on_outcome=tell)
    return [row(cell, outcomes[k * trials : (k + 1) * trials]) for k, cell in enumerate(cells)]


def row(cell: Cell, outcomes: Sequence[Outcome]) -> Row:
    """The figures of one cell from at least one outcome."""
    known = [o.summary for o in outcomes if o.summary is not None]
    formed = [s for s in known if s.formed]
    flown = [(s.rounds_to_formed or 0, s.lower_bound_rounds or 0) for s in formed]
    separations = [s.min_separation for s in known if s.min_separation is not None]
    later = [s.min_separation_after_start for s in known if s.min_separation_after_start is not None]
    limit = cell.config.mission.safe_distance - TOLERANCE
    errors: dict[str, str] = {}
    for outcome in outcomes:
        if outcome.error is not None:
            errors.setdefault(outcome.error.partition(":")[0], f"seed {outcome.seed}: {outcome.error}")
    return Row(
        protocol=cell.protocol,
        shape=cell.shape,
        n_robots=cell.n_robots,
        simulated=any(s.simulated for s in known),
        trials=len(outcomes),
        formed=wilson(len(formed), len(outcomes)),
        broken=len(outcomes) - len(known),
        rounds=median([rounds for rounds, _ in flown]),
        ratio=median([rounds / max(1, bound) for rounds, bound in flown]),
        min_separation=min(separations, default=None),
        violations=sum(separation < limit for separation in separations),
        unsafe_starts=sum(s.start_violations > 0 for s in known),
        min_separation_after_start=min(later, default=None),
        calls=mean_interval([s.model_calls / s.n_robots for s in known]),
        waypoints=dict(sorted(sum((Counter(s.waypoints) for s in known), Counter[str]()).items())),
        failed_seeds=tuple(o.seed for o in outcomes if not o.formed),
        errors=tuple(errors.values()),
    )
