"""A sweep in one TOML file, and every trial that it stands for."""

from __future__ import annotations

import hashlib
import itertools
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from llm_flock import formations
from llm_flock.errors import InputError
from llm_flock.experiments.arena import fitted_arena
from llm_flock.experiments.compare import UNDISTURBED, parse_teams
from llm_flock.llm.limits import Budget
from llm_flock.llm.local.weights import find_weights
from llm_flock.llm.models import parse_models
from llm_flock.llm.prompting import PACKAGED
from llm_flock.llm.providers import known_providers, parse_model
from llm_flock.llm.sharing import Rate
from llm_flock.llm.simulated.profiles import parse_profile
from llm_flock.mission import input_error
from llm_flock.runtime.config import RunConfig, build_config

KeepRecords = Literal["all", "failed", "none"]
Positive = Annotated[int, Field(ge=1)]

OWN_COLUMNS = frozenset({"team", "shape", "n_robots", "protocol", "consensus", "assignment", "shield", "model", "seed"})
"""Axes that the tables have a column for; every other one gets a column `axis_NAME`."""

PLACES = {"trial": {"out"}, "model": {"record_llm"}}
"""Fields that say where files are put, which is no part of what is flown."""

ID_LENGTH = 20


class _Table(BaseModel):
    """Common rules of all tables of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class SweepTable(_Table):
    """`[sweep]`: the sweep as a whole."""

    name: str = Field(pattern=r"^[\w.-]+$", description="Name; results go to runs/NAME unless told otherwise")
    about: str = Field(default="", description="What it is about, in a sentence; reports begin with it")
    seeds: Positive | tuple[Annotated[int, Field(ge=0)], ...] = Field(
        description="So many seeds for each cell, or a list of them; all cells get the same"
    )
    first_seed: int = Field(default=0, ge=0, description="The first of so many seeds")
    fit_arena: bool = Field(default=False, description="Grow the arena of a team until its formation and starts fit")
    keep_records: KeepRecords = Field(
        default="none", description="Trials whose record is kept: all, failed (those that did not form) or none"
    )


class BudgetTable(_Table):
    """`[budget]`: what all trials together may use, earlier sessions included."""

    max_calls: Positive | None = Field(default=None, description="Model calls")
    max_tokens: Positive | None = Field(default=None, description="Tokens in and out")
    max_cost: float | None = Field(default=None, gt=0, allow_inf_nan=False, description="Money [US dollars]")

    def budget(self) -> Budget:
        """In the words of the gate."""
        return Budget(max_calls=self.max_calls, max_tokens=self.max_tokens, max_cost_usd=self.max_cost)


class ProviderTable(_Table):
    """`[providers.NAME]`: what one provider allows all trials together."""

    max_concurrent: Positive | None = Field(default=None, description="Calls under way at once")
    calls_per_minute: Positive | None = Field(default=None, description="Calls within any 60 s, retries included")
    tokens_per_minute: Positive | None = Field(default=None, description="Tokens in and out within any 60 s")

    def rate(self) -> Rate:
        """In the words of the gate."""
        return Rate(**self.model_dump())


class ExpectTable(_Table):
    """`[expect]`: what `--dry-run` assumes about language models."""

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
class TrialSpec:
    """One trial that is to be flown.

    Attributes:
        id: address, made of everything in the configuration that can change what happens.
        cell: everything but the seed, in a few words.
        axes: value of each further axis of the grid, in words.
        config: its resolved configuration.
    """

    id: str
    cell: str
    axes: Mapping[str, str]
    config: RunConfig

    @property
    def seed(self) -> int:
        """Seed of the trial."""
        return self.config.trial.seed

    @property
    def models(self) -> tuple[str, ...]:
        """The models in use, each once."""
        return tuple(dict.fromkeys(parse_models(self.config.model.model, self.config.mission.n_robots)))

    @property
    def waits(self) -> bool:
        """Whether it spends its time waiting for answers, so that many such trials fit into one process."""
        return any(_waits(model) for model in self.models)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """A file, read and resolved.

    Attributes:
        file: what it says.
        text: the file as it was given.
        trials: every trial, seed by seed: whatever has been flown when it ends early is spread over all cells.
    """

    file: SweepFile
    text: str
    trials: tuple[TrialSpec, ...]

    @property
    def cells(self) -> tuple[str, ...]:
        """The cells, in the order of the grid."""
        return tuple(dict.fromkeys(trial.cell for trial in self.trials))


def load_sweep(
    path: Path,
    *,
    variables: Mapping[str, Sequence[Any]] | None = None,
    budget: Mapping[str, float | None] | None = None,
    **overrides: Any,
) -> Sweep:
    """Read a sweep and state its trials.

    Args:
        path: the file.
        variables: values that replace those of `[variables]`.
        budget: limits that replace those of `[budget]`; None means: not given.
        overrides: fields of the configuration, for all trials; an axis of the same name is replaced.

    Raises:
        InputError: naming the first thing that is not allowed.
    """
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text)
        given = {name: value for name, value in (budget or {}).items() if value is not None}
        data["budget"] = {**data.get("budget", {}), **given}
        file = SweepFile.model_validate(data)
    except OSError as error:
        raise InputError("sweep", str(path), f"a readable file ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError("sweep", str(path), f"TOML ({error})") from None
    except ValidationError as error:
        raise input_error(error) from None
    for name in file.providers:
        if name not in {info.name for info in known_providers()} | {"local", "simulated"}:
            raise InputError("providers", name, "a provider; `llm-flock models` lists them")
    parse_profile(file.expect.profile)
    return Sweep(file=file, text=text, trials=tuple(_trials(file, variables or {}, overrides)))


def _trials(
    file: SweepFile, variables: Mapping[str, Sequence[Any]], overrides: Mapping[str, Any]
) -> Iterator[TrialSpec]:
    for name in variables:
        if name not in file.variables:
            raise InputError("set", name, f"one of the variables {', '.join(file.variables) or '(there are none)'}")
    given = {field: value for field, value in overrides.items() if value is not None}
    axes = {name: _axis(name, values, {**file.variables, **variables}) for name, values in file.grid.items()}
    axes.update({name: [_Point(str(value), {name: value})] for name, value in given.items() if name in axes})
    cells = [_cell(file, given, dict(zip(axes, point, strict=True))) for point in itertools.product(*axes.values())]
    count, first = file.sweep.seeds, file.sweep.first_seed
    seeds = range(first, first + count) if isinstance(count, int) else count
    known: dict[str, str] = {}
    for seed in seeds:
        for cell, labels, config in cells:
            trial = config.model_copy(update={"trial": config.trial.model_copy(update={"seed": seed})})
            spec = TrialSpec(id=trial_id(trial), cell=cell, axes=labels, config=trial)
            if spec.id in known:
                raise InputError("grid", f"{cell}, seed {seed}", f"each trial once; {known[spec.id]} is the same")
            known[spec.id] = f"{cell}, seed {seed}"
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
        return _Point(label, fields)
    if axis == "team":
        ((shape, n_robots),) = parse_teams(str(value))
        return _Point(str(value), {"shape": shape, "n_robots": n_robots})
    return _Point(str(value), {axis: value})


def _cell(
    file: SweepFile, overrides: Mapping[str, Any], point: Mapping[str, _Point]
) -> tuple[str, dict[str, str], RunConfig]:
    """Label, further axes and configuration of one point of the grid."""
    fields: dict[str, Any] = dict(overrides)
    for value in point.values():
        fields.update(value.fields)
    for refused in ("seed", "out", "record_llm"):
        if refused in fields or any(refused in table for table in file.run.values()):
            raise InputError(refused, "...", "not given: seeds are in [sweep], and results have their own directory")
    if file.sweep.fit_arena and "arena" not in fields:
        fields["arena"] = _fitted(file.run, fields)
    words = [v.label if name in OWN_COLUMNS else f"{name}={v.label}" for name, v in point.items()]
    axes = {name: value.label for name, value in point.items() if name not in OWN_COLUMNS}
    return " ".join(words), axes, build_config(file.run, **fields)


def _fitted(base: Mapping[str, Any], fields: Mapping[str, Any]) -> Any:
    """The arena of one team, grown until its formation and its starts fit."""
    mission = {**base.get("mission", {}), **fields}
    defaults = build_config().mission
    shape, n_robots = mission.get("shape", defaults.shape), mission.get("n_robots", defaults.n_robots)
    # A team of one without a shape fits everywhere: this reads what was given, and nothing of it is refused.
    team = build_config(base, **{**fields, "shape": "text:anything", "n_robots": 1, **UNDISTURBED}).mission
    points = formations.load_points(Path(shape.partition(":")[2])) if shape.startswith("points:") else None
    return fitted_arena(team, shape if points is None else "points", n_robots, points)


def trial_id(config: RunConfig) -> str:
    """The address of a trial: a hash of its resolved configuration, and of the files that it names."""
    plain = config.model_dump(mode="json", exclude=cast("Any", PLACES))
    words = config.model.prompts
    files = [] if words is None or words in PACKAGED else [_digest(Path(words))]
    for model in dict.fromkeys(parse_models(config.model.model, config.mission.n_robots)):
        name = parse_model(model)
        if name.kind == "replay":
            files.append(_digest(Path(name.model)))
        elif name.kind == "local":
            files.extend(find_weights(name.model).digests().values())
    text = json.dumps([plain, files], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:ID_LENGTH]


def _digest(path: Path) -> str:
    """What a file holds, or the files of a folder; they are missed when they are used, not here."""
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            digest.update(f"{file.relative_to(path)}\0".encode() + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _waits(model: str) -> bool:
    name = parse_model(model)
    if name.kind != "simulated":
        return name.kind in ("provider", "local")
    profile = parse_profile(name.model)
    return profile.slow > 0 or profile.flaky > 0
