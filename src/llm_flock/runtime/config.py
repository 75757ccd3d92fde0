"""One configuration file, one validated object; command-line flags override it by field name."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar, cast

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from llm_flock import formations, renamed
from llm_flock.errors import InputError
from llm_flock.llm.frame import FrameName
from llm_flock.mission import Coordinate, Mission, input_error
from llm_flock.protocol.membership.liveness import TIME_OUT
from llm_flock.runtime.rules import PRESETS
from llm_flock.runtime.schedule import Change, Schedule, build_schedule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.transport.memory import LinkFaults

Count = Annotated[int, Field(ge=1)]
PerRobot = Annotated[str | None, BeforeValidator(lambda v: str(v) if isinstance(v, int | float) else v)]
"""One value for all robots ("0.2"), or a list by id ("0-4=0.2,5-9=0.7"); plain numbers are taken too."""


class Section(BaseModel):
    """Common rules of all parts of the configuration."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ProtocolConfig(Section):
    """How the robots come to one plan and to distinct places."""

    protocol: Literal["flock", "paper", "baseline"] = Field(default="flock", description="Preset of the options below")
    consensus: str | None = Field(
        default=None, description="Plan consensus: none, influence, provenance, or package.module:Class [preset's]"
    )
    assignment: str | None = Field(
        default=None,
        description="Goal assignment: index, nearest, nearest-free, auction, or package.module:Class [preset's]",
    )
    shield: bool | None = Field(default=None, description="Buffered Voronoi safety shield [preset's]")
    verify: bool | None = Field(
        default=None, description="Check plans and steps before use, received plans too [preset's]"
    )
    fallback: Literal["hold", "geometry"] = Field(
        default="hold",
        description="When a model's plan or step stays unusable: hold (wait for a neighbour's plan), or plain geometry",
    )
    comm_rounds: Count | None = Field(default=None, description="Communication rounds per motion round [preset's]")
    gaps: Literal["report", "replan"] = Field(
        default="report",
        description="When fewer robots are alive than the plan has places: report the gaps, or plan again",
    )
    time_out: Count = Field(
        default=TIME_OUT, description="Rounds without a heartbeat, by whatever way, after which a robot counts as dead"
    )

    @model_validator(mode="after")
    def _resolve(self) -> Self:
        """Fill from the preset what was left open, so that the resolved configuration says everything."""
        for field, value in PRESETS[self.protocol].items():
            if getattr(self, field) is None:
                object.__setattr__(self, field, value)
        if self.fallback != "hold" and not self.verify:
            raise InputError("fallback", self.fallback, "hold while verify is off")
        return self


class ModelConfig(Section):
    """Who thinks for the robots."""

    model: str = Field(
        default="simulated:ideal", description="provider:model or local:MODEL for all robots, or by id: 0-4=A,5-9=B"
    )
    base_url: str | None = Field(default=None, description="Address of an OpenAI-compatible server")
    answers: Literal["text", "json"] = Field(
        default="text", description="Answer format: the paper's text, or a JSON schema"
    )
    history: str = Field(default="none", description="Conversation kept between questions: none, last:K or full")
    decide: Literal["every-round", "on-event"] = Field(
        default="every-round",
        description="When a model is asked for its way: a step every round, or a path and again if something comes up",
    )
    observe: Literal["in-range", "all"] = Field(
        default="in-range", description="Robots whose positions the model is told"
    )
    max_retries: int = Field(
        default=2, ge=0, le=20, description="How often a rejected answer is sent back to the model"
    )
    prompts: str | None = Field(
        default=None,
        description="Packaged prompts (full, brief), or a folder with templates that replace full ones "
        "[the model's: brief for local:smollm2, full for others]",
    )
    frame: FrameName | None = Field(
        default=None,
        description="Coordinates in which a model is asked: world, or own (plans around the origin in spacings, steps "
        "from the origin in step limits) [the model's: own for local:smollm2, world for others]",
    )
    temperature: PerRobot = Field(default=None, description="Sampling temperature, for all or by id")
    reasoning_effort: PerRobot = Field(default=None, description="Reasoning effort (minimal .. max), for all or by id")
    model_seed: PerRobot = Field(default=None, description="Sampling seed sent to the provider, for all or by id")
    record_llm: str | None = Field(default=None, description="File to record every model call in, for replay:FILE")


class LimitConfig(Section):
    """What a run may use."""

    max_concurrent: Count = Field(default=1000, description="Model calls in flight at once")
    timeout_s: float = Field(
        default=120.0, gt=0, allow_inf_nan=False, description="Time-out of one try of a model call [s]"
    )
    max_tries: Count = Field(default=8, description="Tries of one model call when the provider fails")
    max_calls: Count | None = Field(default=None, description="Budget: model calls of the whole run")
    max_tokens: Count | None = Field(default=None, description="Budget: tokens in and out of the whole run")
    max_cost: float | None = Field(
        default=None, gt=0, allow_inf_nan=False, description="Budget: cost of the whole run [US dollars]"
    )


class TrialConfig(Section):
    """One seeded run."""

    rounds: int = Field(default=60, ge=0, le=100_000, description="Motion rounds at most")
    stop_when_formed: bool = Field(default=True, description="End as soon as the formation has been held")
    seed: int = Field(default=0, ge=0, lt=2**63, description="Seed of starts, links, noise and simulated models")
    start: Literal["separated", "uniform", "connected"] = Field(
        default="separated",
        description="Random starts: never nearer than safe_distance; the paper's raw draw; or all in radio contact",
    )
    start_positions: tuple[tuple[Coordinate, ...], ...] | None = Field(
        default=None, description="Given start positions instead of random ones [units]"
    )
    kill: str | None = Field(
        default=None, description="Robots that die, each from the start of a round on: ID@ROUND,ID@ROUND,..."
    )
    join: str | None = Field(
        default=None, description="Robots that are silent until the start of a round, or start again: ID@ROUND,..."
    )
    kill_random: int = Field(default=0, ge=0, description="So many robots more die, drawn from the seed")
    join_random: int = Field(default=0, ge=0, description="So many robots more join late, drawn from the seed")
    changes: tuple[Change, ...] = Field(
        default=(), description="Missions given in flight to one robot: {round, robot, set: {field: value, ...}}"
    )
    noise: float = Field(default=0.0, ge=0, allow_inf_nan=False, description="Largest localisation error [units]")
    out: str | None = Field(default=None, description="Folder for the record (run.mcap) and all that is drawn from it")


class RunConfig(Section):
    """Everything that defines a run. Field names are unique over all sections, so a flag needs no section."""

    mission: Mission = Field(default_factory=Mission)
    protocol: ProtocolConfig = Field(default_factory=ProtocolConfig)
    model: ModelConfig = Field(default_factory=ModelConfig)
    limits: LimitConfig = Field(default_factory=LimitConfig)
    links: LinkFaults = Field(default_factory=LinkFaults)
    trial: TrialConfig = Field(default_factory=TrialConfig)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.protocol.shield:
            self.mission.check_sensing()
            if self.trial.noise > self.mission.safe_distance / 4:
                raise InputError(
                    "noise",
                    self.trial.noise,
                    f"at most safe_distance / 4 = {self.mission.safe_distance / 4:g} while the shield is on",
                )
        self.schedule()
        return self

    def schedule(self) -> Schedule:
        """What is to happen to the robots in flight; what is random of it is drawn from the seed.

        Raises:
            InputError: it cannot happen like that.
        """
        trial = self.trial
        return build_schedule(
            self.mission,
            kill=trial.kill,
            join=trial.join,
            kill_random=trial.kill_random,
            join_random=trial.join_random,
            changes=trial.changes,
            rounds=trial.rounds,
            rng=stream(trial.seed, Stream.FAULTS),
        )


Config = TypeVar("Config", bound=RunConfig)


def section_of(field: str, kind: type[RunConfig] = RunConfig) -> str:
    """The section that holds a field.

    Raises:
        InputError: there is no such field.
    """
    for name, info in kind.model_fields.items():
        section = info.annotation
        assert isinstance(section, type) and issubclass(section, BaseModel)
        if field in section.model_fields:
            return name
    raise InputError(field, "...", "a field of the configuration; `llm-flock run --help` lists them")


def build_config(base: Mapping[str, Any] | None = None, **overrides: Any) -> RunConfig:
    """A configuration from nested sections, with flat overrides by field name (None means: not given).

    `shape = "points:FILE"` is resolved here: the file's points become the mission's.

    Raises:
        InputError: naming the first offending field, its value, and what is allowed.
    """
    return build_config_of(RunConfig, base, **overrides)


def build_config_of(kind: type[Config], base: Mapping[str, Any] | None = None, **overrides: Any) -> Config:
    """As `build_config`, for a configuration with more sections."""
    data: dict[str, Any] = {}
    for name, section in (base or {}).items():
        if name not in kind.model_fields:
            raise InputError(name, "...", f"one of the sections {', '.join(kind.model_fields)}")
        if not isinstance(section, Mapping):
            raise InputError(name, section, "a table")
        data[name] = renamed.current(cast("Mapping[str, Any]", section))
    for field, value in renamed.current(overrides).items():
        if value is not None:
            data.setdefault(section_of(field, kind), {})[field] = value
    _load_points(data.get("mission", {}))
    try:
        return kind(**data)
    except ValidationError as error:
        raise input_error(error) from None


def _load_points(mission: dict[str, Any]) -> None:
    shape = mission.get("shape")
    if isinstance(shape, str) and shape.startswith("points:"):
        points = formations.load_points(Path(shape.removeprefix("points:")))
        mission.update(shape="points", points=points)
        mission.setdefault("n_robots", len(points))
        if points and "center" not in mission and len(points[0]) != 2:
            raise InputError("center", "not given", f"a centre with {len(points[0])} coordinates, as the points have")


def load_config(path: Path | None, **overrides: Any) -> RunConfig:
    """A configuration from a TOML file (or none), with flat overrides.

    Raises:
        InputError: the file cannot be read or is not TOML, or a value is not allowed.
    """
    return load_config_of(RunConfig, path, **overrides)


def load_config_of(kind: type[Config], path: Path | None, **overrides: Any) -> Config:
    """As `load_config`, for a configuration with more sections."""
    if path is None:
        return build_config_of(kind, {}, **overrides)
    try:
        base = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError("config", str(path), f"a readable file ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError("config", str(path), f"TOML ({error})") from None
    return build_config_of(kind, base, **overrides)
