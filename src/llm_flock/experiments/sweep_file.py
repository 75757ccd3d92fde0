"""Read a sweep from one TOML file, and resolve every trial of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from llm_flock import renamed
from llm_flock.errors import InputError
from llm_flock.experiments.grid import Cell, TrialSpec, arena_of, parse_teams
from llm_flock.experiments.trial import KeepRecords
from llm_flock.llm.providers import PROVIDERS
from llm_flock.llm.simulated.profiles import parse_profile
from llm_flock.mission import Mission, input_error
from llm_flock.runtime.config import RunConfig, build_config, read_toml

MOST_TRIALS = 100_000
"""Most trials of a sweep; all of them are in memory."""

Positive = Annotated[int, Field(ge=1)]

OWN_COLUMNS = frozenset({"team", "shape", "n_robots", "protocol", "consensus", "assignment", "shield", "model", "seed"})
"""Axes that the tables have a column for; every other one gets a column `axis_NAME`."""


class _Table(BaseModel):
    """Common rules of all tables of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class SweepTable(_Table):
    """`[sweep]`: the sweep as a whole."""

    name: str = Field(pattern=r"^[\w.-]+$", max_length=100, description="Name; results go to runs/NAME by default")
    about: str = Field(default="", description="One sentence about the sweep; reports open with it")
    seeds: Positive | tuple[Annotated[int, Field(ge=0)], ...] = Field(
        description="Number of seeds for each cell, or a list of them; the same for all cells"
    )
    first_seed: int = Field(default=0, ge=0, description="The first seed, where `seeds` is a number")
    fit_arena: bool = Field(default=False, description="Grow the arena of a team until its formation and starts fit")
    keep_records: KeepRecords = Field(
        default="none", description="Trials whose record is kept: all, failed (those that did not form) or none"
    )


class BudgetTable(_Table):
    """`[budget]`: limits for all trials together, earlier sessions included."""

    max_calls: Positive | None = Field(default=None, description="Model calls")
    max_tokens: Positive | None = Field(default=None, description="Tokens in and out")
    max_cost: float | None = Field(default=None, gt=0, allow_inf_nan=False, description="Money [US dollars]")


class ProviderTable(_Table):
    """`[providers.NAME]`: the limits of one provider for all trials together."""

    max_concurrent: Positive | None = Field(default=None, description="Calls in flight at once")
    calls_per_minute: Positive | None = Field(default=None, description="Calls within any 60 s, retries included")
    tokens_per_minute: Positive | None = Field(default=None, description="Tokens in and out within any 60 s")


class ExpectTable(_Table):
    """`[expect]`: the assumptions of `--dry-run` about language models."""

    output_tokens: Positive = Field(default=400, description="Tokens of an answer, reasoning included")
    profile: str = Field(
        default="distorted@0.3,overshoot@0.3", description="Stand-in that rehearses the cells of real models"
    )


class SweepFile(_Table):
    """The whole file. `[run.*]` holds tables of a configuration file, `[grid]` the axes."""

    sweep: SweepTable
    grid: dict[str, list[Any] | str]
    run: dict[str, dict[str, Any]] = Field(default_factory=dict[str, dict[str, Any]])
    variables: dict[str, list[Any]] = Field(default_factory=dict[str, list[Any]])
    budget: BudgetTable = BudgetTable()
    providers: dict[str, ProviderTable] = Field(default_factory=dict[str, ProviderTable])
    expect: ExpectTable = ExpectTable()


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """A sweep, read and resolved; `text` is its file as it was given.

    Trials come seed by seed, so that a sweep that ends early has flown about as many trials of each cell.
    """

    file: SweepFile
    text: str
    trials: tuple[TrialSpec, ...]


def load_sweep(
    path: Path,
    *,
    variables: Mapping[str, Sequence[Any]] | None = None,
    budget: Mapping[str, float | None] | None = None,
    **overrides: Any,
) -> Sweep:
    """Read a sweep and resolve its trials.

    Values of `variables` and limits of `budget` replace those of the file, and overrides are fields of the
    configuration for all trials, which replace an axis of the same name. None means: not given.

    Raises:
        InputError: naming the first fault.
    """
    try:
        data = read_toml("sweep", path)
        text = path.read_text(encoding="utf-8")
        given = {name: value for name, value in (budget or {}).items() if value is not None}
        if isinstance(table := data.get("budget", {}), dict):
            data["budget"] = {**cast("dict[str, Any]", table), **given}
        file = SweepFile.model_validate(data)
    except ValidationError as error:
        raise input_error(error) from None
    for name in file.providers:
        if name not in {*PROVIDERS, "local", "simulated"}:
            raise InputError("providers", name, "a provider; `llm-flock models` lists them")
    parse_profile(file.expect.profile)
    return Sweep(file=file, text=text, trials=tuple(_trials(file, variables or {}, overrides)))


def _trials(
    file: SweepFile, variables: Mapping[str, Sequence[Any]], overrides: Mapping[str, Any]
) -> Iterator[TrialSpec]:
    for name in variables:
        if name not in file.variables:
            raise InputError("set", name, f"one of the variables {', '.join(file.variables) or '(there are none)'}")
    given = renamed.current({field: value for field, value in overrides.items() if value is not None})
    grid = renamed.current(file.grid)
    axes = {name: _axis(name, values, {**file.variables, **variables}) for name, values in grid.items()}
    axes.update({name: [_Point(str(value), {name: value})] for name, value in given.items() if name in axes})
    seeds = file.sweep.seeds if isinstance(file.sweep.seeds, int) else len(file.sweep.seeds)
    if (number := seeds * math.prod(map(len, axes.values()))) > MOST_TRIALS:
        raise InputError("grid", f"{number} trials", f"a grid of at most {MOST_TRIALS:,} trials")
    cells = [_cell(file, given, dict(zip(axes, point, strict=True))) for point in itertools.product(*axes.values())]
    count, first = file.sweep.seeds, file.sweep.first_seed
    seeds = range(first, first + count) if isinstance(count, int) else count
    known: dict[str, str] = {}
    for seed in seeds:
        for cell in cells:
            spec = cell.trial(seed)
            if spec.id in known:
                raise InputError("grid", f"{cell.label}, seed {seed}", f"each trial once; {known[spec.id]} is the same")
            known[spec.id] = f"{cell.label}, seed {seed}"
            yield spec


@dataclass(frozen=True, slots=True)
class _Point:
    """One value of an axis: its label, and the fields that it sets."""

    label: str
    fields: Mapping[str, Any]


def _axis(name: str, values: list[Any] | str, variables: Mapping[str, Sequence[Any]]) -> list[_Point]:
    if isinstance(values, str):
        if not values.startswith("$") or values[1:] not in variables:
            raise InputError(f"grid.{name}", values, f"a list, or $NAME of {', '.join(variables) or '[variables]'}")
        values = list(variables[values[1:]])
    if not values:
        raise InputError(f"grid.{name}", "[]", "at least one value")
    points = [_point(name, value) for value in values]
    labels = [point.label for point in points]
    twice = next((label for k, label in enumerate(labels) if label in labels[:k]), None)
    if twice is not None:
        raise InputError(f"grid.{name}", twice, "each value once")
    return points


def _point(axis: str, value: Any) -> _Point:
    if isinstance(value, Mapping):
        fields = dict(cast("Mapping[str, Any]", value))
        label = fields.pop("name", None)
        if not isinstance(label, str) or not label:
            raise InputError(f"grid.{axis}", fields, "tables with a `name`")
        return _Point(label, renamed.current(fields))
    if axis == "team":
        ((shape, n_robots),) = parse_teams(str(value))
        return _Point(str(value), {"shape": shape, "n_robots": n_robots})
    fields = renamed.current({axis: value})
    return _Point(str(fields[axis]), fields)


def _cell(file: SweepFile, overrides: Mapping[str, Any], point: Mapping[str, _Point]) -> Cell:
    """The cell at one point of the grid."""
    fields: dict[str, Any] = dict(overrides)
    for value in point.values():
        fields.update(value.fields)
    for name in fields:
        RunConfig.section_of(name)  # refuses an unknown one
    for refused in ("seed", "out", "record_llm"):
        if refused in fields or any(refused in table for table in file.run.values()):
            raise InputError(refused, "...", "not given: seeds are in [sweep], and results have their own directory")
    load = partial(build_config, file.run)
    if file.sweep.fit_arena and "arena" not in fields:
        team = {"shape": Mission().shape, "n_robots": Mission().n_robots, **file.run.get("mission", {}), **fields}
        fields["arena"] = arena_of(load, team)
    label = " ".join(v.label if name in OWN_COLUMNS else f"{name}={v.label}" for name, v in point.items())
    axes = {name: value.label for name, value in point.items() if name not in OWN_COLUMNS}
    return Cell(config=load(**fields), label=label, axes=axes)
