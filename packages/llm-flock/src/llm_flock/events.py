"""Events that a robot takes, effects that it returns, and the phases in which each event is legal.

`TRANSITIONS` is the table of the state machine in `llm_flock.agent`; the documentation draws it.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, TypeAlias

import msgspec

from llm_flock.arrays import Point
from llm_flock.message import Authorization
from llm_flock.mission import Mission
from llm_flock.obstacles import Mover
from llm_flock.planner import (
    JudgementAnswer,
    JudgementQuestion,
    NoAnswer,
    PlanAnswer,
    PlanQuestion,
    StepAnswer,
    StepQuestion,
)


class Phase(StrEnum):
    """Phase of a robot's motion round."""

    IDLE = "idle"
    PLANNING = "planning"
    AGREEING = "agreeing"
    DECIDING = "deciding"
    MOVING = "moving"
    STOPPED = "stopped"


class Origin(StrEnum):
    """The source of a waypoint that is flown."""

    START = "start"
    MODEL = "model"
    CLIPPED = "clipped"
    SHIELD = "shield"
    YIELD = "yield"
    GEOMETRY = "geometry"
    HOLD = "hold"


# Events that happen to a robot.


class Sensed(msgspec.Struct, frozen=True, kw_only=True):
    """Sensor values; between two rounds, for a robot that is not in step with the others."""

    position: Point  #: Own believed position [units; world frame].
    degree: int  #: Number of robots within radio range, |N_i| (paper, line 129), counted by the radio, not the sensors.
    sensed: Mapping[int, Point]  #: Believed positions of the robots within sensing range, by id [units; world frame].
    observed: tuple[Point, ...]  #: Positions to tell the planner, in order of ids (usually those of `sensed`).
    moving: tuple[Mover, ...] = ()  #: Moving obstacles within sensing range.


class RoundBegan(Sensed, frozen=True, kw_only=True):
    """A motion round begins, numbered from 1, with the values of the sensors."""

    round: int


class HeartbeatDue(msgspec.Struct, frozen=True):
    """A heartbeat period begins.

    Send it after `Sensed` to a robot whose heartbeats follow its clock instead of its rounds; `period` counts from 1.
    """

    period: int


class MissionGiven(msgspec.Struct, frozen=True, kw_only=True):
    """The operator gives this robot another mission; the robot passes it on."""

    mission: Mission
    #: The operator's own time of the order, higher than that of every earlier order: see `llm_flock.message`. Not used
    #: where the order is signed.
    ordered_at: int
    #: The operator's signature, which covers its time; in teams with keys only.
    authorization: Authorization | None = None


class BatteryWeak(msgspec.Struct, frozen=True):
    """The robot's body says that it can fly only this far from now on [units]."""

    left: float


class OrderGiven(msgspec.Struct, frozen=True):
    """The operator gives this robot an order in words, at most `MAX_ORDER_BYTES`, in this round; the team judges it."""

    words: str
    round: int


class Judged(msgspec.Struct, frozen=True):
    """The planner answered the question for a judgement."""

    answer: JudgementAnswer | NoAnswer


class Planned(msgspec.Struct, frozen=True):
    """The planner answered the plan question."""

    answer: PlanAnswer | NoAnswer


class CommRoundBegan(msgspec.Struct, frozen=True):
    """A communication round begins: time to broadcast."""


class Received(msgspec.Struct, frozen=True):
    """A payload arrived by radio; `sender` is the robot that signed the transmission, if the transport knows it."""

    payload: bytes
    sender: int | None = None


class CommRoundEnded(msgspec.Struct, frozen=True):
    """All messages of this communication round have arrived: decide on them together."""


class AgreementEnded(msgspec.Struct, frozen=True):
    """No more communication rounds before the move."""


class Decided(msgspec.Struct, frozen=True):
    """The planner answered the step question."""

    answer: StepAnswer | NoAnswer


class Arrived(msgspec.Struct, frozen=True):
    """The body has finished the move, or will finish it while the planner is asked for the next one."""


class Stopped(msgspec.Struct, frozen=True):
    """The mission is over."""


Event: TypeAlias = (
    RoundBegan
    | Sensed
    | HeartbeatDue
    | MissionGiven
    | BatteryWeak
    | OrderGiven
    | Judged
    | Planned
    | CommRoundBegan
    | Received
    | CommRoundEnded
    | AgreementEnded
    | Decided
    | Arrived
    | Stopped
)

# Effects that a robot asks its runtime for.


class AskPlan(msgspec.Struct, frozen=True):
    """Ask the planner for a formation."""

    question: PlanQuestion


class AskStep(msgspec.Struct, frozen=True):
    """Ask the planner for a waypoint."""

    question: StepQuestion


class AskJudgement(msgspec.Struct, frozen=True):
    """Ask the planner for a judgement. The round goes on meanwhile, in whatever phase it is."""

    question: JudgementQuestion


class Broadcast(msgspec.Struct, frozen=True):
    """Send these bytes to every robot in radio range."""

    payload: bytes


class MoveTo(msgspec.Struct, frozen=True, kw_only=True):
    """Fly to `waypoint`; `proposed` is the planner's own waypoint, if it answered."""

    waypoint: Point
    proposed: Point | None
    origin: Origin


NOTES: Mapping[str, frozenset[str]] = {
    "proposed": frozenset({"plan", "slot", "by"}),
    "enlarged": frozenset({"asked"}),
    "no_plan": frozenset({"cause", "reason"}),
    "adopted": frozenset({"plan", "from"}),
    "void_plan": frozenset({"plan", "proposer", "after", "slot"}),
    "fallback": frozenset({"question", "by", "cause", "reason"}),
    "breaker": frozenset({"question", "state", "refusals", "wait", "reason"}),
    "claimed": frozenset({"slot", "before"}),
    "rejected_message": frozenset({"reason", "detail"}),
    "asked_again": frozenset({"reason"}),
    "stale_question": frozenset({"about"}),
    "stale_answer": frozenset({"about"}),
    "search": frozenset({"begun", "vacant"}),
    "gap": frozenset({"slots", "missing"}),
    "mission": frozenset({"counter", "digest", "shape"}),
    "clipped": frozenset({"proposed", "flown"}),
    "shielded": frozenset({"proposed", "flown"}),
    "separating": frozenset({"nearest", "makes_way"}),
    "deadlock": frozenset({"goal_distance", "rounds"}),
    "gives_way": frozenset({"to"}),
    "evades": frozenset({"obstacle"}),
    "held": frozenset({"cause", "reason"}),
    "incident": frozenset({"about", "robot", "options"}),
    "judged": frozenset({"about", "robot", "choice", "reason"}),
    "agreed": frozenset({"about", "robot", "choice", "votes"}),
    "dropped_notes": frozenset({"count"}),
    "clock": frozenset({"ahead_s"}),
    "accused": frozenset({"robot", "reason", "proof"}),
    "battery": frozenset({"left"}),
    "order": frozenset({"words"}),
    "killed": frozenset(),
    "joined": frozenset(),
    "injected": frozenset({"model", "loss"}),
}
"""Names in the detail of each kind of note: see docs/reference/record.md. The runtime writes the last five kinds."""


class Note(msgspec.Struct, frozen=True):
    """Something worth recording.

    Attributes:
        kind: one of `NOTES`.
        detail: plain values by name, exactly those of the kind.

    Raises:
        ValueError: when made with another kind, or with other names.
    """

    kind: str
    detail: Mapping[str, Any] = msgspec.field(default_factory=dict[str, Any])

    def __post_init__(self) -> None:
        if NOTES.get(self.kind) != frozenset(self.detail):
            raise ValueError(f"no note {self.kind!r} with {sorted(self.detail)}: NOTES names what is allowed")


Effect: TypeAlias = AskPlan | AskStep | AskJudgement | Broadcast | MoveTo | Note

AT_ANY_TIME = (
    Sensed,
    HeartbeatDue,
    MissionGiven,
    BatteryWeak,
    OrderGiven,
    Judged,
    CommRoundBegan,
    Received,
    CommRoundEnded,
)
"""Events that are legal in every phase: robots also communicate and sense while models think and bodies fly."""

TRANSITIONS: Mapping[tuple[Phase, type[Event]], frozenset[Phase]] = {
    (Phase.IDLE, RoundBegan): frozenset({Phase.PLANNING, Phase.AGREEING}),
    (Phase.PLANNING, Planned): frozenset({Phase.AGREEING}),
    (Phase.AGREEING, AgreementEnded): frozenset({Phase.DECIDING, Phase.MOVING}),
    (Phase.DECIDING, Decided): frozenset({Phase.DECIDING, Phase.MOVING}),
    (Phase.MOVING, Arrived): frozenset({Phase.IDLE}),
    **{(phase, event): frozenset({phase}) for phase in Phase if phase is not Phase.STOPPED for event in AT_ANY_TIME},
    (Phase.DECIDING, CommRoundEnded): frozenset({Phase.DECIDING, Phase.MOVING}),
    **{(phase, Stopped): frozenset({Phase.STOPPED}) for phase in Phase if phase is not Phase.STOPPED},
}
"""Every legal (phase, event), and the phases it may lead to. Any other event is a fault of the runtime."""
