"""Read a sweep from one TOML file, and resolve every trial of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import BaseModel, ConfigDict, Field

from llm_flock import plugins
from llm_flock.errors import FieldError, InputError, unknown
from llm_flock.llm import PROVIDERS, parse_profile
from llm_flock.mission import Mission
from llm_flock.runtime import OUTPUT_TOKENS, PROFILE, RunConfig, build_config, read_toml
from llm_flock.validation import checked
from llm_flock_lab._experiments.grid import Cell, TrialSpec, arena_of, naming_team, parse_teams
from llm_flock_lab._experiments.trial import KeepRecords

MAX_TRIALS = 100_000  # most trials of a sweep; all of them are in memory

Positive = Annotated[int, Field(ge=1)]

OWN_COLUMNS = frozenset({"team", "shape", "n_robots", "protocol", "consensus", "assignment", "shield", "model", "seed"})
"""Axes that the tables have a column for; every other one gets a column `axis_NAME`."""


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SweepTable(_Table):
    """`[sweep]`: the sweep as a whole."""

    name: str = Field(
        pattern=r"^[\w.-]*[\w-][\w.-]*$",
        max_length=100,
        json_schema_extra={"expected": "letters, digits, '.', - and _, not only dots"},
        description="Name; results go to runs/NAME by default",
    )
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

    output_tokens: Positive = Field(default=OUTPUT_TOKENS, description="Tokens of an answer, reasoning included")
    profile: str = Field(default=PROFILE, description="Stand-in that rehearses the cells of real models")


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
    seeds: int | None = None,
    budget: Mapping[str, float | None] | None = None,
    **overrides: Any,
) -> Sweep:
    """Read a sweep and resolve its trials.

    Values of `variables`, the number of `seeds` and limits of `budget` replace those of the file. A name in `variables`
    that is an axis keeps only these of its values. Overrides are fields of the configuration for all trials, which
    replace an axis of the same name. None means: not given.

    Raises:
        InputError: naming the first fault.
    """
    given = {name: value for name, value in (budget or {}).items() if value is not None}
    try:
        data = read_toml("file", path)
        text = path.read_text(encoding="utf-8")
        if isinstance(table := data.get("budget", {}), dict):
            data["budget"] = {**cast("dict[str, Any]", table), **given}
        if seeds is not None and isinstance(table := data.get("sweep"), dict):
            data["sweep"] = {**cast("dict[str, Any]", table), "seeds": seeds}
        file = checked(SweepFile, data)
    except InputError as found:
        if found.field in given:  # in the words of the command line, which has a --max-cost for each trial too
            raise InputError(found.field.replace("max_", "budget_"), found.value, says=found.says) from None
        raise
    for name in file.providers:
        if name not in (known := (*PROVIDERS, *plugins.entries("models"), "simulated")):
            raise FieldError("providers", name, says=unknown(f"provider [providers.{name}]", name, known))
    parse_profile(file.expect.profile)
    return Sweep(file=file, text=text, trials=tuple(_trials(file, variables or {}, overrides)))


def _trials(
    file: SweepFile, variables: Mapping[str, Sequence[Any]], overrides: Mapping[str, Any]
) -> Iterator[TrialSpec]:
    for name in variables:
        if name not in {**file.variables, **file.grid}:
            raise InputError("set", name, says=unknown("variable or axis", name, (*file.variables, *file.grid)))
    given = {field: value for field, value in overrides.items() if value is not None}
    axes = {name: _axis(name, values, {**file.variables, **variables}) for name, values in file.grid.items()}
    for name in axes.keys() & variables.keys() - file.variables.keys():
        axes[name] = _keep_points(name, axes[name], variables[name])
    axes.update({name: [_Point(str(value), {name: value})] for name, value in given.items() if name in axes})
    seeds = file.sweep.seeds if isinstance(file.sweep.seeds, int) else len(file.sweep.seeds)
    if (number := seeds * math.prod(map(len, axes.values()))) > MAX_TRIALS:
        raise InputError("grid", f"{number} trials", f"a grid of at most {MAX_TRIALS:,} trials")
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


def _keep_points(name: str, points: Sequence[_Point], values: Sequence[Any]) -> list[_Point]:
    """The points of an axis that have these labels."""
    labels = [point.label for point in points]
    for value in map(str, values):
        if value not in labels:
            raise InputError("set", f"{name}={value}", says=unknown(f"value of axis {name}", value, labels))
    return [point for point in points if point.label in map(str, values)]


def _point(axis: str, value: Any) -> _Point:
    if isinstance(value, Mapping):
        fields = dict(cast("Mapping[str, Any]", value))
        label = fields.pop("name", None)
        if not isinstance(label, str) or not label:
            raise InputError(f"grid.{axis}", fields, "tables with a `name`")
        return _Point(label, fields)
    if axis == "team":
        ((shape, n_robots),) = parse_teams(str(value))
        return _Point(str(value), {"shape": shape, "n_robots": n_robots})
    return _Point(str(value), {axis: value})


def _cell(file: SweepFile, overrides: Mapping[str, Any], point: Mapping[str, _Point]) -> Cell:
    fields: dict[str, Any] = dict(overrides)
    for value in point.values():
        fields.update(value.fields)
    for name in fields:
        RunConfig.section_of(name)  # refuses an unknown one
    for refused in ("seed", "out", "record_llm"):
        if refused in fields or any(refused in table for table in file.run.values()):
            where = "seeds are in [sweep], and results have their own directory"
            raise FieldError(refused, says=f"field {refused!r} cannot be set in a sweep: {where}")
    axis = {"base_url"} & (fields.keys() - overrides.keys())  # the file's word, not the operator's
    model = {**file.run.get("model", {}), **{name: fields.pop(name) for name in axis}}
    load = partial(build_config, {**file.run, "model": model})
    with naming_team("grid.team", point["team"].label) if "team" in point else nullcontext():
        if file.sweep.fit_arena and "arena" not in fields:
            team = {"shape": Mission().shape, "n_robots": Mission().n_robots, **file.run.get("mission", {}), **fields}
            fields["arena"] = arena_of(load, team)
        config = load(**fields)
    label = " ".join(v.label if name in OWN_COLUMNS else f"{name}={v.label}" for name, v in point.items())
    axes = {name: value.label for name, value in point.items() if name not in OWN_COLUMNS}
    return Cell(config=config, label=label, axes=axes)
