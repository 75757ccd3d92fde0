"""The configuration of a run: one validated object from a file, whose fields flags override by name."""

from __future__ import annotations

import logging
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, model_validator

from llm_flock import graph, metrics
from llm_flock.bounds import DEEPEST, MAX_INTEGER, MAX_WAITING, TIME_OUT
from llm_flock.errors import FieldError, InputError, unknown
from llm_flock.links import LinkFaults
from llm_flock.llm._port import FrameName
from llm_flock.metrics import deadline
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.protocol._agreement.consensus import Ties
from llm_flock.protocol._breaker import Fallback
from llm_flock.record import RECORD_NAME
from llm_flock.runtime._rules import ASSIGNMENT, CONSENSUS, PRESETS, LeftOut, Rules, assignment_rule, consensus_rule
from llm_flock.runtime._schedule import (
    MAX_ROUNDS,
    Schedule,
    Sight,
    TrialConfig,
    build_schedule,
    load_points,
    read_points,
)
from llm_flock.validation import checked, fields_of, unknown_section

logger = logging.getLogger(__name__)

Count = Annotated[int, Field(ge=1, le=MAX_INTEGER)]
PerRobot = Annotated[str | None, BeforeValidator(lambda v: str(v) if isinstance(v, int | float) else v)]
"""One value for all robots ("0.2"), or a list by id ("0-4=0.2,5-9=0.7"); plain numbers are accepted too."""

_NO_NAME = re.compile("[\0\ud800-\udfff]")  # what neither the names of files nor the texts of a record can hold

_PLAIN = re.compile("shape|kill|join|battery|history|wish|temperature|reasoning_effort|model_seed|swarm")
"""Fields with free text that names no file, no code and no address."""


class ConfigSection(BaseModel):
    """A part of the configuration: immutable, and without unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


def number(default: float | None, description: str, *, least: float = 0, most: float | None = None) -> Any:
    """A field for a finite number from `least` on."""
    return Field(default=default, ge=least, le=most, allow_inf_nan=False, description=description)


def seconds(default: float, description: str, *, most: float | None = None) -> Any:
    """A field for a positive time [s]."""
    return Field(default=default, gt=0, le=most, allow_inf_nan=False, description=f"{description} [s]")


def metres(default: float | None, description: str, *, most: float = 1000) -> Any:
    """A field for a positive length [m]."""
    return Field(default=default, gt=0, le=most, allow_inf_nan=False, description=f"{description} [m]")


class ProtocolConfig(ConfigSection):
    """Rules by which the robots agree on one plan and on distinct places."""

    protocol: Literal["flock", "paper", "paper-literal", "released", "baseline"] = Field(
        default="flock", description="Preset for the rules, checks and fallback"
    )
    consensus: str | None = Field(
        default=None,
        description="Plan consensus: none, influence, provenance, medoid, or package.module:Class [preset's]",
    )
    assignment: str | None = Field(
        default=None,
        description="Goal assignment: index, nearest, nearest-free, auction, or package.module:Class [preset's]",
    )
    ties: Ties | None = Field(
        default=None,
        description="If the most influential neighbour is only as influential, with influence: keep the own plan, or "
        "adopt that of a neighbour of lowest-id [keep]",
    )
    without: LeftOut | None = Field(default=None, description="Part to leave out, for an ablation")
    relay: bool | None = Field(
        default=None, description="Pass broadcasts on to all robots that others can reach [preset's]"
    )
    collision_check: str | None = Field(
        default=None,
        description="Check of all steps of a round in one place before they are flown: none, or central, which "
        "llm-flock-lab brings [preset's]",
    )
    shield: bool | None = Field(default=None, description="Buffered Voronoi safety shield [preset's]")
    verify: bool | None = Field(
        default=None, description="Check plans and steps before use, also plans received [preset's]"
    )
    fallback: Fallback | None = Field(
        default=None,
        description="If answers stay unusable: breaker (the model is asked rarely; geometry flies, but makes no plan), "
        "geometry (computes plan and steps), or hold (no help, and no limit to asking) [preset's; hold without verify]",
    )
    comm_rounds: Annotated[int, Field(ge=1, le=1_000)] | None = Field(
        default=None, description="Communication rounds per motion round [preset's]"
    )
    gaps: Literal["report", "replan"] = Field(
        default="report", description="If fewer robots are alive than the plan has places: report the gaps, or replan"
    )
    judge: Literal["rule", "models"] = Field(
        default="rule",
        description="After a death that leaves a gap, with a weak battery or a blocked way: do as --gaps says and fly "
        "on (rule), or ask all models once, and do what most of them choose (models)",
    )
    time_out: int = Field(
        default=TIME_OUT,
        ge=1,
        le=MAX_ROUNDS,
        description="Rounds without a heartbeat, direct or relayed, after which a robot counts as dead",
    )

    @model_validator(mode="after")
    def _resolve(self) -> Self:
        """Fill fields that were left open from the preset, so that the resolved configuration is complete."""
        for field, value in PRESETS[self.protocol].items():
            if getattr(self, field) is None:
                object.__setattr__(self, field, value if field != "fallback" or self.verify else "hold")
        if self.fallback != "hold" and not self.verify:
            raise InputError("fallback", self.fallback, "'hold' while verify is off")
        if self.without is not None and (self.assignment, self.shield) != ("auction", True):
            raise InputError("without", self.without, says="takes something away from the auction and the shield only")
        if self.judge == "models" and self.assignment != "auction":
            raise InputError("judge", self.judge, "'rule' unless places are given by the auction")
        return self

    def rules(self) -> Rules:
        """The consensus and assignment rules by these names. InputError for an unknown one."""
        consensus = consensus_rule(self.consensus or "", self.ties or "keep")
        return consensus, assignment_rule(self.assignment or "", self.without)


class ModelConfig(ConfigSection):
    """Language models that plan for the robots, and how they are asked."""

    model: str = Field(
        default="simulated:ideal",
        description="provider:model, local:MODEL or package.module:Class for all robots, or by id: 0-4=A,5-9=B",
    )
    base_url: str | None = Field(default=None, description="Address of an OpenAI-compatible server")
    answers: Literal["text", "json"] = Field(
        default="text", description="Answer format: the paper's text, or JSON by a schema"
    )
    history: str = Field(default="none", description="Conversation to keep between questions: none, last:K or full")
    decide: Literal["every-round", "on-event"] = Field(
        default="every-round",
        description="When to ask a model: for a step every round, or for a path, and again when something changes",
    )
    observe: Literal["in-range", "all"] = Field(
        default="in-range", description="Robots whose positions the model is given"
    )
    max_retries: int = Field(
        default=2, ge=0, le=20, description="Send a rejected answer back to the model up to this many times"
    )
    prompts: str | None = Field(
        default=None,
        description="Packaged prompts (full, brief, program, brief-program, letters), or a folder with templates that "
        "replace full ones [the model's: brief-program for local:smollm2, letters for local:smollm2+letters, full for "
        "others]",
    )
    wish: str | None = Field(
        default=None,
        description="What is wished, in words: of steps with --prompts letters, of judgements with --judge models",
    )
    frame: FrameName | None = Field(
        default=None,
        description="Coordinates in a model's prompts: world, or own (plans around the origin in spacings, steps "
        "from the origin in step limits) [the model's: own for local:smollm2, world for others]",
    )
    temperature: PerRobot = Field(default=None, description="Sampling temperature, for all or by id")
    reasoning_effort: PerRobot = Field(default=None, description="Reasoning effort (minimal .. max), for all or by id")
    model_seed: PerRobot = Field(default=None, description="Sampling seed sent to the provider, for all or by id")
    record_llm: str | None = Field(default=None, description="Record every model call in this file, for replay:FILE")
    _typed: bool = PrivateAttr(default=False)

    def vouch(self) -> None:
        """Note that `base_url` is the operator's own word and no file's, so that his key may go there."""
        self._typed = True

    @property
    def typed_url(self) -> str | None:
        """`base_url` where the operator gave it; None where a file did."""
        return self.base_url if self._typed else None


class LimitConfig(ConfigSection):
    """Limits of a run's model calls, and its budget."""

    max_concurrent: Count = Field(default=1000, description="Maximum number of concurrent model calls")
    timeout_s: float = seconds(120.0, "Time-out of one try of a model call")
    max_tries: Count = Field(default=8, description="Maximum attempts per model call if the provider fails")
    max_answer_tokens: Count | None = Field(
        default=None,
        description="Maximum tokens of one answer, thoughts included; a longer one is cut off and rejected",
    )
    max_calls: Count | None = Field(default=None, description="Budget: model calls of the whole run")
    max_tokens: Count | None = Field(default=None, description="Budget: tokens in and out of the whole run")
    max_cost: float | None = Field(
        default=None, gt=0, allow_inf_nan=False, description="Budget: cost of the whole run [US dollars]"
    )


class RunConfig(ConfigSection):
    """Everything that defines a run. Field names are unique over all sections, so a flag needs no section."""

    mission: Mission = Field(default_factory=Mission)
    protocol: ProtocolConfig = Field(default_factory=ProtocolConfig)
    model: ModelConfig = Field(default_factory=ModelConfig, title="Language models")
    limits: LimitConfig = Field(default_factory=LimitConfig, title="Limits and budget")
    links: LinkFaults = Field(default_factory=LinkFaults, title="Messages")
    trial: TrialConfig = Field(default_factory=TrialConfig, title="Run")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.protocol.shield:
            self.mission.check_sensing()
            most, error = self.mission.safe_distance / 4, self.trial.noise + self.trial.drift
            if error > most:
                allowed = f"at most safe_distance / 4 = {most:g}, noise and drift together, while the shield is on"
                raise InputError("noise" if self.trial.noise else "drift", error, allowed)
            rounds = 1 + self.sight.rests + self.trial.sensing_delay
            reach = self.mission.sensing - self.mission.body_radius - self.mission.max_step
            for one in self.trial.moving_obstacles:
                if one.speed * rounds > reach + 1e-9:
                    allowed = f"a speed of at most {reach / rounds:.4g}: robots must see an obstacle before it is there"
                    raise InputError("moving_obstacles", one.model_dump(), allowed)
        if self.protocol.judge == "rule" and any(change.words for change in self.trial.changes):
            raise InputError("judge", "rule", "'models', who judge the orders in words among the changes")
        given = [mission for orders in self.schedule().missions.values() for _, mission in orders]
        self.check_missions(self.mission, *given)
        if self.trial.changes and any(mission.then for mission in (self.mission, *given)):
            raise InputError(
                "changes", len(self.trial.changes), "none beside `then`, whose stages may begin in a round"
            )
        return self

    def check_missions(self, *missions: Mission) -> None:
        """InputError unless these rules and sensors can fly such missions. Call for every order, also in flight."""
        protocol = self.protocol
        if protocol.assignment != "auction" and any(mission.then or mission.prefer for mission in missions):
            allowed = "auction, by which robots tell each other who stands where, for a mission with then or prefer"
            raise InputError("assignment", protocol.assignment, allowed)
        if any(mission.prefer for mission in missions):
            if self.mission.n_robots > MAX_WAITING:
                allowed = f"none in a team of more than {MAX_WAITING} robots, whose places are not given together"
                raise InputError("prefer", len(missions[-1].prefer), allowed)
            if protocol.without == "joint-assignment":
                raise InputError("without", protocol.without, says="takes away what preferences are part of")
        if self.sight.rests and any(mission.velocity is not None for mission in missions):
            says = "cannot be used with a formation that travels: robots that rest to be seen would fall behind"
            raise InputError("sensing_delay", self.trial.sensing_delay, says=says)

    def schedule(self) -> Schedule:
        """Deaths, joins and mission changes in flight, random ones drawn from the seed. InputError if impossible."""
        return build_schedule(self.mission, self.trial)

    def flying(self, mission: Mission, gaps: Literal["report", "replan"] | None = None) -> Self:
        """The same with another mission, checked as a whole; `gaps` replaces the protocol's, if given."""
        protocol = self.protocol.model_copy(update={} if gaps is None else {"gaps": gaps})
        return checked(type(self), dict(self) | {"mission": mission, "protocol": protocol})

    def check_orders(self) -> None:
        """Refuse a stage that waits for an order. Call where nobody can give one."""
        if any(stage.when == "order" for stage in self.mission.then) and self.trial.rounds is None:
            says = "a stage waits for an order, which nobody can give to this run: start it in llm-flock view"
            raise InputError("then", None, says=f"{says}, or limit its --rounds")

    @property
    def sight(self) -> Sight:
        """What each robot may assume of positions; without the shield it assumes nothing, and never rests."""
        error = self.trial.noise + self.trial.drift
        return Sight.of(self.mission, error, self.trial.sensing_delay) if self.protocol.shield else Sight(error=error)

    @property
    def start_scene(self) -> Mission:
        """The mission with all obstacles where they are at the start, for random start positions."""
        moving = tuple(Obstacle(center=one.center, radius=one.radius) for one in self.trial.moving_obstacles)
        return self.mission.model_copy(update={"obstacles": (*self.mission.obstacles, *moving)})

    @property
    def record(self) -> Path | None:
        """The record to write; None without `out`."""
        return None if self.trial.out is None else Path(self.trial.out) / RECORD_NAME

    @property
    def most_rounds(self) -> int:
        """The largest number of rounds that a run of this configuration can take."""
        if self.trial.rounds is not None:
            return self.trial.rounds
        across = math.ceil(math.dist(*self.mission.arena) / self.mission.max_step)
        then = self.mission.then
        begun = max([self.schedule().last, *(stage.when for stage in then if isinstance(stage.when, int))])
        held = sum([self.mission.hold, *(stage.set.get("hold", 0) for stage in then)])
        flown = deadline(across * (1 + self.sight.rests)) + (self.mission.n_robots if then else 0)
        return begun + held + flown * (1 + len(then))

    @classmethod
    def section_of(cls, field: str) -> str:
        """The section that holds a field; `InputError` if none does."""
        sections = {known: name for name, info in cls.model_fields.items() for known in fields_of(info.annotation)}
        if field not in sections:
            raise FieldError(field, says=unknown(f"field {field!r}", field, sections))
        return sections[field]

    @classmethod
    def build(cls, base: Mapping[str, Any] | None = None, /, **overrides: Any) -> Self:
        """A configuration from nested sections, with overrides by field name (None means: not given).

        Only here `shape = "points:FILE"` is resolved, also in changes: the file's points become the mission's.
        """
        data: dict[str, Any] = {}
        check_values("config", base or {})
        check_values("config", overrides)
        for name, section in (base or {}).items():
            if name not in cls.model_fields:
                raise unknown_section(name, cls)
            if not isinstance(section, Mapping):
                raise InputError(name, section, f"a section: [{name}], and below it FIELD = VALUE")
            data[name] = dict(cast("Mapping[str, Any]", section))
        for field, value in overrides.items():
            if value is not None:
                data.setdefault(cls.section_of(field), {})[field] = value
        trial, mission = data.get("trial", {}), data.get("mission", {})
        if isinstance(changes := trial.get("changes"), list | tuple):
            trial["changes"] = [read_points(change) for change in cast("Sequence[Any]", changes)]
        if load_points(mission):
            points = mission["points"]
            mission.setdefault("n_robots", len(points))
            if points and "center" not in mission and len(points[0]) != 2:
                raise InputError("center", None, f"a centre with {len(points[0])} coordinates, as the points have")
        config = checked(cls, data)
        if overrides.get("base_url") is not None:
            config.model.vouch()
        return config

    @classmethod
    def stored(cls, data: Mapping[str, Any]) -> tuple[Self, list[str]]:
        """The configuration of a record or of results, and the fields left out. InputError if it is none.

        It may come from anywhere, so it is data: texts that could name a file, code or an address keep their defaults.
        It opens, imports and calls nothing, nor does a run of it.
        """
        from llm_flock.llm._models import parse_models
        from llm_flock.llm._prompting import PACKAGED
        from llm_flock.llm._providers import parse_model

        check_values("config", data)
        config = checked(cls, data)
        models = parse_models(config.model.model, config.mission.n_robots)
        free = [config.model.model] * all(parse_model(name).kind in ("simulated", "geometry") for name in models)
        known: dict[str, Any] = {"model": free, "prompts": PACKAGED, "consensus": CONSENSUS, "assignment": ASSIGNMENT}
        known["collision_check"] = [preset["collision_check"] for preset in PRESETS.values()]
        out: dict[str, set[str]] = {}
        for name in cls.model_fields:
            section: BaseModel = getattr(config, name)
            for field, info in type(section).model_fields.items():
                value = getattr(section, field)
                text = str in (info.annotation, *get_args(info.annotation)) and not _PLAIN.fullmatch(field)
                if text and value not in (None, info.default, *known.get(field, ())):
                    out.setdefault(name, set()).add(field)
        return checked(cls, config.model_dump(exclude=out)), sorted(one for fields in out.values() for one in fields)

    @classmethod
    def load(cls, path: Path | None, **overrides: Any) -> Self:
        """A configuration from a TOML file (or none), with overrides by field name."""
        return cls.build(None if path is None else read_toml("config", path), **overrides)


def read_toml(field: str, path: Path) -> dict[str, Any]:
    """The values of a TOML file, checked as by `check_values`; `field` names the file in errors."""
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(field, str(path), f"a file that can be read ({error.strerror})") from None
    except ValueError as error:
        raise InputError(field, str(path), says=f"this is not TOML: {error}") from None
    check_values(field, values)
    return values


def check_values(field: str, value: object, depth: int = DEEPEST) -> None:
    """Check that values of any fields, as a file may nest them, can be shown, compared and handed to the system."""
    if isinstance(value, Mapping | list | tuple):
        if depth == 0:
            raise InputError(field, None, f"values in at most {DEEPEST} levels")
        named = isinstance(value, Mapping)
        items = cast("Mapping[str, object]", value).items() if named else [(field, v) for v in cast("list[Any]", value)]
        for name, item in items:
            check_values(str(name), item, depth - 1)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        allowed = f"less than {2**63}" if value > 0 else f"at least {-(2**63)}"
        raise InputError(field, value if value.bit_length() <= 256 else None, allowed)
    elif isinstance(value, str) and _NO_NAME.search(value) is not None:
        raise InputError(field, value, "text without the character NUL, and without half characters")


@cache
def warn_of_mission(mission: Mission, noise: float = 0.0) -> None:
    """Log a warning, once for each mission, if it may not form because robots lack radio contact, room, or precision.

    `noise` is the largest error of a position [units].
    """
    ideal, tolerance = mission.ideal, metrics.AT_GOAL * mission.spacing
    if noise > tolerance:
        logger.warning(
            "noise and drift, together %g, are more than a robot may be away from its place, %g: the team may stand in "
            "its shape as it sees itself, and hardly ever count as formed.",
            noise,
            tolerance,
        )
    if ideal is not None and not graph.is_connected(graph.distances(ideal) <= mission.comm_range):
        logger.warning(
            "comm_range = %g is too short for this formation: robots at its places, %g apart, are not all in radio "
            "contact. The team may take long to agree or never form, and cannot notice a dead robot.",
            mission.comm_range,
            mission.spacing,
        )
    room = 1.05 * mission.safe_distance  # see docs/explanation/safe-motion.md
    if ideal is not None and mission.downwash != 1.0:  # places above each other may be nearer than they are apart
        room *= max(1.0, mission.spacing / metrics.min_separation(ideal, mission.downwash))
    if mission.n_places > 1 and mission.spacing < room and not math.isclose(mission.spacing, room):
        logger.warning(
            "spacing = %g leaves robots no room to move: they keep %g apart%s. The team may take long to form, or "
            "never do; a spacing of %g would do.",
            mission.spacing,
            mission.safe_distance,
            mission.by_height,
            room,
        )


build_config = RunConfig.build
load_config = RunConfig.load
