"""The results of a sweep, read from its two tables: cells, their trials, and each trial's error over time."""

from __future__ import annotations

import tomllib
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self, cast

import numpy as np
import polars as pl
from numpy.typing import NDArray

from llm_flock.errors import InputError, RecordError
from llm_flock.metrics import ROUNDING
from llm_flock.protocol import PRESET_RULES
from llm_flock.record import ENDINGS, ending, protocol_text
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.statistics import horizon
from llm_flock_lab._experiments.store import is_inside, read_json
from llm_flock_lab._experiments.sweep import PLAN_NAME, SWEEP_NAME


@dataclass(frozen=True, slots=True, order=True)
class Team:
    """A shape and a team size; each has its own panel in figures."""

    n_robots: int
    shape: str

    def __str__(self) -> str:
        return f"{self.shape} · {self.n_robots} robots" if self.n_robots != 1 else f"{self.shape} · 1 robot"


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultCell:
    """A cell of the grid; `condition` is the value of every further axis as text, empty without any."""

    team: Team
    protocol: str
    model: str
    condition: str

    def __str__(self) -> str:
        return " · ".join(part for part in (str(self.team), self.protocol, self.model, self.condition) if part)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRow:
    """One trial; its outcome is one of `ENDINGS`, and `figures` is its row in the table."""

    id: str
    cell: ResultCell
    seed: int
    outcome: str
    figures: Mapping[str, Any] = field(repr=False)

    @property
    def formed(self) -> bool:
        return self.outcome == "formed"

    @property
    def too_near(self) -> bool:
        separation, safe = self.figures["min_separation"], self.figures["safe_distance"]
        return separation is not None and safe is not None and separation < safe - ROUNDING

    @property
    def beside_centre(self) -> bool:
        """Whether the team ended more than a tenth of the spacing beside the centre of its mission."""
        off = self.figures.get("center_distance")
        return off is not None and off > self.figures["spacing"] / 10

    @property
    def ratio(self) -> float | None:
        """Rounds to the formation over the fewest possible, of which 0 counts as 1; None where it did not form."""
        rounds, bound = self.figures["rounds_to_formed"], self.figures["lower_bound_rounds"]
        return rounds / max(1, bound) if self.formed and rounds is not None and bound is not None else None

    @property
    def error(self) -> float | None:
        """Distance to the ideal shape at the end [units]."""
        return self.figures["procrustes_mean"]

    @property
    def detour(self) -> float | None:
        """Distance flown by all robots over the least possible; None where it did not form, or that is not known."""
        flown, least = self.figures["distance_flown"], self.figures["distance_least"]
        return flown / least if self.formed and flown is not None and least else None

    def per_robot(self, column: str) -> float | None:
        """A figure of the whole team, shared out."""
        value = self.figures[column]
        return None if value is None else value / self.cell.team.n_robots


@dataclass(frozen=True)
class Results:
    """Everything in a directory of results; `planned` are the trials of the whole sweep, None where not known."""

    folder: Path
    frame: pl.DataFrame = field(repr=False)
    rounds: pl.DataFrame = field(repr=False)
    name: str = ""
    about: str = ""
    planned: int | None = None

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read a directory of results; it may be one that is still being filled."""
        frame, rounds = tables.read_tables(folder)
        if frame.is_empty():
            raise InputError("dir", str(folder), "a directory with at least one finished trial")
        name, about = _title(folder)
        planned = _read_plan(folder)
        if planned is not None:
            # The grid's own order: models and conditions are shown as the file of the sweep has them.
            order = pl.DataFrame({"trial": planned}, {"trial": pl.String}).with_row_index("place")
            frame = frame.join(order, on="trial", how="left").sort("place", nulls_last=True, maintain_order=True)
            frame = frame.drop("place")
        count = None if planned is None else len(planned)
        return cls(folder, frame, rounds, name, about, count)

    @cached_property
    def trials(self) -> tuple[TrialRow, ...]:
        rows = list(self.frame.iter_rows(named=True))
        axes = [name for name in self.frame.columns if name.startswith(tables.AXIS)]
        return tuple(
            TrialRow(
                id=row["trial"],
                cell=ResultCell(
                    team=Team(row["n_robots"], row["shape"]),
                    protocol=protocol_text({"protocol": row}),
                    model=row["model"] or "",
                    condition=", ".join(
                        f"{name.removeprefix(tables.AXIS)} {row[name]}" for name in axes if row[name] is not None
                    ),
                ),
                seed=row["seed"],
                outcome=ending(None if row["error"] is not None or row["stopped"] is None else row),
                figures=row,
            )
            for row in rows
        )

    @cached_property
    def cells(self) -> dict[ResultCell, list[TrialRow]]:
        found: defaultdict[ResultCell, list[TrialRow]] = defaultdict(list)
        for trial in self.trials:
            found[trial.cell].append(trial)

        def place(cell: ResultCell) -> tuple[Any, ...]:
            order = (self.conditions, cell.condition), (self.models, cell.model), (self.protocols, cell.protocol)
            return (cell.team, *(names.index(name) for names, name in order))

        return {cell: found[cell] for cell in sorted(found, key=place)}

    @cached_property
    def teams(self) -> tuple[Team, ...]:
        return tuple(sorted({trial.cell.team for trial in self.trials}))

    @cached_property
    def protocols(self) -> tuple[str, ...]:
        """Every protocol, presets in their own order."""
        seen = dict.fromkeys(trial.cell.protocol for trial in self.trials)
        known = {name: k for k, name in enumerate(PRESET_RULES)}
        return tuple(sorted(seen, key=lambda name: known.get(name.split(" ")[0], len(known))))

    @cached_property
    def models(self) -> tuple[str, ...]:
        """Every model, as configured, in the order of the table."""
        return tuple(dict.fromkeys(trial.cell.model for trial in self.trials))

    @cached_property
    def conditions(self) -> tuple[str, ...]:
        """The values of the further axes that occur together, in the order of the table; `("",)` without such axes."""
        return tuple(dict.fromkeys(trial.cell.condition for trial in self.trials))

    @cached_property
    def axes(self) -> dict[str, tuple[str, ...]]:
        """The further axes that have more than one value, and their values: numbers by size, words as they come."""
        found: dict[str, tuple[str, ...]] = {}
        for name in self.frame.columns:
            values = [value for value in dict.fromkeys(self.frame[name].to_list()) if value is not None]
            if name.startswith(tables.AXIS) and len(values) > 1:
                numeric = all(as_number(value) is not None for value in values)
                found[name.removeprefix(tables.AXIS)] = tuple(sorted(values, key=float) if numeric else values)
        return found

    def needs(self, name: Literal["protocol", "model"]) -> bool:
        """Whether cells of one condition differ in it; otherwise the condition tells it, as where an axis sets it."""
        return len({(cell.condition, getattr(cell, name)) for cell in self.cells}) > len(self.conditions)

    def axes_of(self, cell: ResultCell) -> dict[str, str | None]:
        """The value of every further axis in a cell."""
        row = self.cells[cell][0].figures
        return {name.removeprefix(tables.AXIS): row[name] for name in row if name.startswith(tables.AXIS)}

    @property
    def references(self) -> tuple[str, ...]:
        """What cells can be compared with: a protocol, or a value of an axis as AXIS=VALUE."""
        return (*self.protocols, *(f"{axis}={value}" for axis, values in self.axes.items() for value in values))

    @cached_property
    def horizons(self) -> dict[Team, tuple[float, float]]:
        """Of each team, the `horizon` of its trials in rounds, and over the lower bound."""
        rows = {team: [trial.figures for trial in self.trials if trial.cell.team == team] for team in self.teams}
        return {team: (horizon(found), horizon(found, over_bound=True)) for team, found in rows.items()}

    @property
    def simulated(self) -> bool:
        return any(trial.figures["simulated"] for trial in self.trials)

    def outcomes(self) -> dict[str, int]:
        """Number of trials by outcome; every outcome is there, and they add up to all trials."""
        counts = Counter(trial.outcome for trial in self.trials)
        return {name: counts[name] for name in ENDINGS}

    @cached_property
    def _errors(self) -> dict[tuple[str, str], NDArray[np.float64]]:
        """The error after each round of every trial that has rounds, by trial and column [units, or their square]."""
        ordered = self.rounds.sort("trial", "round", maintain_order=True)
        columns = ("error", "error_squared")
        grouped = ordered.group_by("trial", maintain_order=True).agg(pl.col(*columns).cast(pl.Float64))
        return {
            (name, column): np.array([np.nan if value is None else value for value in values], dtype=np.float64)
            for column in columns
            for name, values in zip(grouped["trial"].to_list(), grouped[column].to_list(), strict=True)
        }

    def curves(self, trials: Sequence[TrialRow], length: int, figure: str = "error") -> NDArray[np.float64]:
        """Error over rounds of the trials that have one [units], shape (k, length); the last one stands to the end.

        The figure may be `error_squared` [units^2].
        """
        rows: list[NDArray[np.float64]] = []
        for trial in trials:
            curve = self._errors.get((trial.id, figure))
            if curve is None or np.isnan(curve).all():
                continue
            last = curve[~np.isnan(curve)][-1]
            rows.append(np.concatenate([curve, np.full(max(0, length - len(curve)), last)])[:length])
        return np.array(rows, dtype=np.float64).reshape(len(rows), length)

    @property
    def longest(self) -> int:
        """Rounds of the longest trial, the start counted too; 0 without any."""
        return max((len(self._errors.get((trial.id, "error"), ())) for trial in self.trials), default=0)


def as_number(text: str) -> float | None:
    """A value of an axis as a number; None where it is words."""
    try:
        return float(text)
    except ValueError:
        return None


def _title(folder: Path) -> tuple[str, str]:
    """Name of the sweep, and what it is about, from its file; the folder's name where there is no such file."""
    try:
        text = path.read_text(encoding="utf-8") if is_inside(path := folder / SWEEP_NAME, folder) else ""
        found = cast("dict[str, Any]", tomllib.loads(text)["sweep"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        found = {}
    return str(found.get("name") or folder.resolve().name), str(found.get("about") or "")


def _read_plan(folder: Path) -> list[str] | None:
    """Ids of all trials of the sweep, in the order of its grid; None where that is not known."""
    try:
        return list(read_json(folder / PLAN_NAME, dict[str, list[str]], "a plan"))
    except RecordError:
        return None
