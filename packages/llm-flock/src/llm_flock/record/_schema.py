"""The channels of a record: a model for each, and the JSON schema that is written into the file."""

from __future__ import annotations

from typing import Annotated, Any, Protocol, Self, cast

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from llm_flock import bounds

RECORD_NAME = "run.mcap"  # name of a record in its folder
MAGIC = b"\x89MCAP0\r\n"  # how an MCAP file begins

Finite = Annotated[float, Field(ge=-bounds.MAX_FIGURE, le=bounds.MAX_FIGURE, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-bounds.MAX_DISTANCE, le=bounds.MAX_DISTANCE, allow_inf_nan=False)]

Row = Annotated[list[Coordinate], Field(min_length=2, max_length=3)]  # one position, d coordinates [units; world frame]

Rows = Annotated[list[Row], Field(max_length=bounds.MAX_ROBOTS)]

Length = Annotated[float, Field(ge=1e-6, le=bounds.MAX_DISTANCE, allow_inf_nan=False)]
"""A length that divides others [units]."""

Whole = Annotated[int, Field(ge=-bounds.MAX_INTEGER, le=bounds.MAX_INTEGER)]
Count = Annotated[int, Field(ge=0, le=bounds.MAX_INTEGER)]
Round = Annotated[int, Field(ge=0, le=bounds.MAX_ROUND)]
Robot = Annotated[int, Field(ge=0, le=10**6)]


Free = Annotated[dict[str, Any], AfterValidator(bounds.check_plain)]
"""Values by name, of a form that this format does not know."""


class _Obstacle(BaseModel):
    center: Row | None = None
    radius: Annotated[Coordinate, Field(ge=0)] | None = None
    polygon: (
        Annotated[list[Annotated[Row, Field(max_length=2)]], Field(min_length=3, max_length=bounds.MAX_CORNERS)] | None
    ) = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.polygon is None and (self.center is None or self.radius is None):
            raise ValueError("an obstacle is a polygon, or has center and radius")
        return self


class _MissionFields(BaseModel):
    """Fields of a mission on which readers of records rely; versions of this program may write more."""

    shape: str
    n_robots: Annotated[int, Field(ge=1, le=bounds.MAX_ROBOTS)]
    spacing: Length
    safe_distance: Length
    downwash: Annotated[float, Field(ge=1, le=100)] = 1.0
    comm_range: Length
    arena: Annotated[list[Row], Field(min_length=2, max_length=2)]
    places: Whole | None = None
    obstacles: Annotated[list[_Obstacle], Field(max_length=bounds.MAX_OBSTACLES)] = []

    @model_validator(mode="after")
    def _check(self) -> Self:
        low, high = self.arena
        if len(low) != len(high) or any(b - a < 1e-6 for a, b in zip(low, high, strict=True)):
            raise ValueError("arena is not two corners, each lower < upper")
        if any(one.center is not None and len(one.center) != len(low) for one in self.obstacles):
            raise ValueError("obstacles have another number of coordinates than the arena")
        if sum(len(one.polygon or ()) for one in self.obstacles) > bounds.MAX_CORNERS:
            raise ValueError(f"obstacles have more than {bounds.MAX_CORNERS} corners")
        return self


class _ConfigFields(BaseModel):
    """Sections of a configuration on which readers of records rely."""

    protocol: dict[str, Any] = {}
    model: dict[str, Any] = {}


_DETAILS: dict[str, tuple[type, ...]] = {
    **dict.fromkeys(("plan", "question", "by", "state", "shape", "about", "cause", "model", "proof"), (str,)),
    **dict.fromkeys(("from", "slot", "before", "wait", "refusals", "robot"), (int,)),
    **dict.fromkeys(("proposed", "flown", "vacant", "slots", "missing"), (list, tuple)),
}
"""Types of details of events, by name, on which readers rely; all may be null."""


def _details(detail: dict[str, Any]) -> dict[str, Any]:
    for name, value in detail.items():
        wanted = _DETAILS.get(name, object)
        if value is not None and (not isinstance(value, wanted) or (wanted == (int,) and isinstance(value, bool))):
            raise ValueError(f"{name} is not a value of type {type(value).__name__}")
    return bounds.check_plain(detail)


class _ResultFields(BaseModel):
    """Figures of a summary on which readers rely."""

    formed: bool | None = None
    stopped: str | None = None
    rounds_to_formed: Whole | None = None
    plan_robot: Robot | None = None
    plan_by: str | None = None
    plan_taught: bool | None = None
    waypoint_shares: dict[str, Finite] | None = None
    breakers_opened: list[Robot] | None = None
    min_separation: Finite | None = None
    steps_over_limit: Whole | None = None
    obstacle_violations: Whole | None = None
    center_distance: Finite | None = None


def _with(known: type[BaseModel]) -> AfterValidator:
    """Checks free values of which some fields are known."""

    def check(values: dict[str, Any]) -> dict[str, Any]:
        known.model_validate(values)
        return bounds.check_plain(values)

    return AfterValidator(check)


Config = Annotated[dict[str, Any], _with(_ConfigFields)]  # a configuration under current names, section by section

MissionFields = Annotated[dict[str, Any], _with(_MissionFields)]
Figures = Annotated[dict[str, Any], _with(_ResultFields)]
Details = Annotated[dict[str, Any], AfterValidator(_details)]


FORMAT_VERSION = 1  # increased whenever a reader of older records would misread a newer one
ROUND_NS = 1_000_000_000  # log time of one round [ns]: a record plays one round a second, however long the run took
_VOLATILE: dict[str, Any] = {"volatile": True}  # marks fields that may differ between two runs of one seed
DEAD, ASLEEP = "dead", "asleep"  # phase of a robot after it died, and before it began

SILENT = frozenset({DEAD, ASLEEP})


class Entry(BaseModel):
    """Base of all recorded messages. Optional fields that are None are left out of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=(), defer_build=True)

    def encoded(self) -> bytes:
        """The message as it is written: compact JSON in UTF-8."""
        return self.__pydantic_serializer__.to_json(self, exclude_none=True)


class RunInfo(Entry):
    """Where the run came from. Written once, first."""

    format_version: Whole = Field(default=FORMAT_VERSION, description="Version of this format")
    config: Config = Field(description="The resolved configuration, every field of it")
    versions: dict[str, str] = Field(description="Versions of the packages that can change a result")
    git_revision: str | None = Field(default=None, description="Revision of the code, +dirty with local changes")
    seed: Whole = Field(description="Seed of the run")
    simulated: bool = Field(description="Whether any language model was a simulated stand-in")
    unrepeatable: list[str] | None = Field(
        None, description="What of the run this configuration cannot repeat, in sentences; left out where it can"
    )
    created_at: str = Field(description="Start of the run, UTC, ISO 8601", json_schema_extra=_VOLATILE)
    environment: dict[str, str] = Field(description="Interpreter and machine", json_schema_extra=_VOLATILE)


class MissionInfo(Entry):
    """What the team is asked to do. Written before the first state, and again whenever it changes."""

    version: Whole = Field(description="Counts the missions of a run from 0")
    round: Round = Field(description="First round of the mission")
    mission: MissionFields = Field(description="Every field of the mission")
    ideal: Rows | None = Field(default=None, description="Ideal points in reference orientation (n, d) [units]")


class PlanInfo(Entry):
    """A plan, once, in the round in which it is first seen."""

    round: Round = Field(description="Round in which it was first seen")
    plan_id: str = Field(description="Stands for the plan's content: equal plans have equal ids")
    proposer: Robot = Field(description="Robot that proposed it")
    points: Rows = Field(description="Its N places in order of their slots (n, d) [units]")


class State(Entry):
    """Every robot after a round; round 0 is the start. All lists are by robot id."""

    round: Round = Field(description="Motion round, 0 before the first")
    positions: Annotated[Rows, Field(min_length=1)] = Field(description="True positions (n, d) [units; world frame]")
    goals: list[Row | None] = Field(description="The place each robot heads for [units], null without one")
    slots: list[Whole | None] = Field(description="Its number in the plan, null without one")
    plan_ids: list[str | None] = Field(description="The plan each robot follows, null without one")
    influence: list[Finite] = Field(description="Share of the team within radio range, |N_i| / N")
    waypoints: list[Row | None] = Field(description="Commanded this round [units], null at the start")
    origins: list[str] = Field(
        description="Origin of the waypoint: start, model, clipped, shield, yield, geometry or hold"
    )
    phases: list[str] = Field(description="Phase of each robot's state machine; dead or asleep without one")
    open_breakers: list[list[str]] = Field(
        default=[],
        description="Questions, plan or step, that each robot's model is not asked, because its answers were unusable",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        n, dim = len(self.positions), {len(row) for row in self.positions}
        lists = (self.goals, self.slots, self.plan_ids, self.influence, self.waypoints, self.origins, self.phases)
        if {len(one) for one in lists} != {n} or len(self.open_breakers) not in (0, n):
            raise ValueError(f"not all lists have an item for each of {n} robots")
        if len(dim | {len(row) for row in (*self.goals, *self.waypoints) if row is not None}) > 1:
            raise ValueError("positions have different numbers of coordinates")
        return self


class ProtocolEvent(Entry):
    """Something that a robot decided or met, when it happened."""

    round: Round = Field(description="Motion round")
    comm_round: Whole | None = Field(
        None,
        description="Communication round within the motion round; left out between two of them",
    )
    robot: Robot = Field(description="Whose event it is")
    kind: str = Field(description="What happened: proposed, adopted, claimed, shielded, ...")
    detail: Details = Field(description="What belongs to this kind of event")


class ChatLine(Entry):
    """One message of a conversation."""

    role: str = Field(description="system, user or assistant")
    text: str = Field(description="Its whole text")


class CallUsage(Entry):
    """Tokens of one call."""

    input: Count = Field(0, description="Tokens in")
    output: Count = Field(0, description="Tokens out")
    cached: Count = Field(0, description="The part of the input that the provider had in its cache")


class LlmEntry(Entry):
    """One call of a language model and what came of it."""

    round: Round = Field(description="Motion round")
    robot: Robot = Field(description="Whose model was asked")
    kind: str = Field(description="plan or step")
    attempt: Whole = Field(description="Number of the call in this round of this robot, from 0")
    model: str = Field(description="provider:model")
    request_hash: str = Field(description="Stands for everything that the model saw")
    messages: list[ChatLine] = Field(description="The whole conversation that the model saw")
    text: str | None = Field(None, description="The raw answer; left out when none came")
    parsed: Free | None = Field(None, description="What was understood; left out when not accepted")
    rejected: str | None = Field(None, description="Why the answer was not accepted, as the model was told")
    clipped: str | None = Field(None, description="Why the answer was clipped before it was flown; left out if not")
    probe: bool | None = Field(None, description="True if the circuit breaker was open before: one try only")
    error: str | None = Field(None, description="Kind and detail of the provider's failure")
    finish_reason: str | None = Field(
        None, description="Why the model stopped: stop, length (cut off), ...; left out where the provider does not say"
    )
    thought: bool | None = Field(
        None, description="True where the model thought apart from its text, which may be all it did; else left out"
    )
    settings: Free = Field(description="Sampling settings that were sent")
    usage: CallUsage = Field(description="Tokens of this call")
    cost_usd: Finite | None = Field(None, description="Price [US dollars]; left out when not known")
    latency_s: Finite = Field(description="Duration, waits for retries included [s]", json_schema_extra=_VOLATILE)
    faults: list[str] = Field(description="Kinds of the transport faults met on the way, in order")


class MetricsRow(Entry):
    """The figures of one round. Counts of calls, tokens, cost and messages run from the start."""

    round: Round = Field(description="Motion round, 0 before the first")
    procrustes_mean: Finite | None = Field(None, description="Mean distance to the ideal shape [units]")
    procrustes_mean_squared: Finite | None = Field(None, description="Mean squared distance to it [units^2]")
    min_separation: Finite | None = Field(None, description="Smallest distance of two robots now [units]")
    segment_separation: Finite | None = Field(None, description="Smallest distance while moving this round [units]")
    plans_in_use: Whole = Field(description="Different plans followed")
    distinct_goals: Whole = Field(description="Different goals headed for")
    robots_at_goal: Whole = Field(description="Robots within 0.05 spacing of their goal")
    in_order_since: Round | None = Field(
        None, description="First of the rounds in order up to this one; left out when the team is not in order"
    )
    connected: bool = Field(description="Whether the radio graph is one piece")
    model_calls: Whole = Field(description="Model calls so far")
    tokens: Whole = Field(description="Tokens in and out so far")
    cost_usd: Finite | None = Field(None, description="Cost so far [US dollars]; left out when not known")
    messages_sent: Whole = Field(description="Broadcasts so far")
    bytes_sent: Whole = Field(description="Bytes broadcast so far")
    messages_rejected: dict[str, Whole] = Field(description="Messages refused on receipt so far, by reason")


class BodySample(Entry):
    """Every body of a flight at a time: where it is, and where it was told to be. Some ten of them a second."""

    round: Round = Field(description="Motion round; 0 before the first")
    time_s: Finite = Field(description="Since the flight began [s]", json_schema_extra=_VOLATILE)
    measured: list[Row] = Field(
        description="The position estimate of each drone, x, y, z [m; world frame]", json_schema_extra=_VOLATILE
    )
    commanded: list[Row] = Field(
        description="Its moving set-point when that estimate was made, x, y, z [m; world frame]",
        json_schema_extra=_VOLATILE,
    )
    flying: list[bool] = Field(description="Whether it is in the air", json_schema_extra=_VOLATILE)
    battery_v: list[Finite | None] = Field(
        description="Battery voltage [V], null if unknown", json_schema_extra=_VOLATILE
    )
    link: list[Finite | None] = Field(
        description="Share of packets that were acknowledged, 0 when the link is lost, null if unknown",
        json_schema_extra=_VOLATILE,
    )


class FlightEvent(Entry):
    """What happened to a flight as a whole, or to the body of one of its drones."""

    round: Round = Field(description="Motion round")
    time_s: Finite = Field(description="Since the flight began [s]", json_schema_extra=_VOLATILE)
    kind: str = Field(description="What happened: connected, take_off, landing, landed, cut, link_lost, ...")
    robot: Robot | None = Field(None, description="The drone's robot; left out where the event is about the whole team")
    detail: Details = Field(description="What belongs to this kind of event", json_schema_extra=_VOLATILE)


class RoundEnd(Entry):
    """The last message of a round: when it is there, the whole round is there."""

    round: Round = Field(description="The round that is complete")


class SummaryMessage(Entry, title="Summary"):
    """What the run reports. Written at a clean end only, also after an interruption."""

    result: Figures = Field(description="The figures of the run, as `llm-flock run --json` prints them")


CHANNELS: dict[str, type[Entry]] = {
    "/run": RunInfo,
    "/mission": MissionInfo,
    "/plan": PlanInfo,
    "/state": State,
    "/protocol": ProtocolEvent,
    "/llm": LlmEntry,
    "/metrics": MetricsRow,
    "/body": BodySample,
    "/flight": FlightEvent,
    "/round": RoundEnd,
    "/summary": SummaryMessage,
}
"""Model of every channel except `/scene`, whose messages Foxglove defines."""

TOPICS: dict[type[Entry], str] = {model: topic for topic, model in CHANNELS.items()}

SCENE_TOPIC = "/scene"


class RecordSink(Protocol):
    """Takes the entries of a run as they happen: `RunInfo` and `MissionInfo` first, at a clean end `SummaryMessage`."""

    def write(self, entry: Entry, /) -> None:
        """Take one entry."""
        ...


class NullWriter:
    """A sink that ignores everything, for runs without a record."""

    def write(self, entry: Entry) -> None:
        """Ignore an entry."""


def channel_schema(model: type[Entry]) -> dict[str, Any]:
    """JSON schema of a channel, in the subset that viewers understand as far as the data allow it."""
    schema = model.model_json_schema()
    definitions = cast("dict[str, Any]", schema.pop("$defs", {}))
    return _plain(schema, definitions, in_list=False)


def _plain(node: dict[str, Any], definitions: dict[str, Any], *, in_list: bool) -> dict[str, Any]:
    # Readers take no references, no alternatives and no objects without properties; what may be None may be left out.
    plain = {key: value for key, value in node.items() if key not in ("$ref", "default")}
    if "$ref" in node:
        plain = definitions[node["$ref"].rpartition("/")[2]] | plain
    if "anyOf" in plain and not in_list:
        (kind,) = (branch for branch in plain.pop("anyOf") if branch != {"type": "null"})
        plain |= kind
    if plain.get("type") == "object":
        properties = cast("dict[str, Any]", plain.get("properties", {}))
        plain["properties"] = {name: _plain(value, definitions, in_list=False) for name, value in properties.items()}
    if "items" in plain:
        plain["items"] = _plain(plain["items"], definitions, in_list=True)
    return plain
