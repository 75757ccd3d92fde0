"""What happens to a robot, what it wants done about it, and which event is legal when.

`TRANSITIONS` is the table of the state machine in `llm_flock.protocol.agent`; the documentation draws it.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, TypeAlias

import msgspec

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.messages.channel import Authorization
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion


class Phase(StrEnum):
    """Where a robot is in its motion round."""

    IDLE = "idle"
    PLANNING = "planning"
    AGREEING = "agreeing"
    DECIDING = "deciding"
    MOVING = "moving"
    STOPPED = "stopped"


class Origin(StrEnum):
    """Who made the waypoint that is flown."""

    START = "start"
    MODEL = "model"
    SHIELD = "shield"
    FALLBACK = "fallback"
    DETOUR = "detour"
    HOLD = "hold"


# Events: what happens to the robot.


class RoundBegan(msgspec.Struct, frozen=True, kw_only=True):
    """A new motion round, with what the sensors say.

    Attributes:
        round: number of the round, from 1.
        position: own believed position [units; world frame].
        neighbors: how many robots are within radio range, |N_i| (paper, line 129); the radio knows, not the sensors.
        sensed: believed positions of the robots within sensing range, by id.
        observed: positions to tell the planner, in ascending order of ids (usually those of `sensed`).
    """

    round: int
    position: Point
    neighbors: int
    sensed: Mapping[int, Point]
    observed: tuple[Point, ...]


class Sensed(msgspec.Struct, frozen=True, kw_only=True):
    """What the sensors say between two rounds, for a robot that is not in step with the others; as in RoundBegan."""

    position: Point
    neighbors: int
    sensed: Mapping[int, Point]
    observed: tuple[Point, ...]


class HeartbeatDue(msgspec.Struct, frozen=True):
    """A new heartbeat period, after a look, of a robot whose heart beats by its clock and not by its rounds.

    `period` counts from 1.
    """

    period: int


class MissionGiven(msgspec.Struct, frozen=True, kw_only=True):
    """The operator gives this robot another mission; the others hear of it from this robot.

    Attributes:
        mission: what it is.
        authorization: the operator's signature, where robots accept nothing else.
    """

    mission: Mission
    authorization: Authorization | None = None


class Planned(msgspec.Struct, frozen=True):
    """The planner answered the plan question."""

    answer: PlanAnswer | NoAnswer


class CommRoundBegan(msgspec.Struct, frozen=True):
    """Time to broadcast."""


class Received(msgspec.Struct, frozen=True):
    """Bytes came in over the radio, from anybody.

    Attributes:
        payload: the bytes.
        sender: the robot that has signed them, where the transport knows.
    """

    payload: bytes
    sender: int | None = None


class CommRoundEnded(msgspec.Struct, frozen=True):
    """All messages of this communication round are in: decide on them together (snapshot semantics)."""


class AgreementEnded(msgspec.Struct, frozen=True):
    """No more exchanges before the move."""


class Decided(msgspec.Struct, frozen=True):
    """The planner answered the step question."""

    answer: StepAnswer | NoAnswer


class Arrived(msgspec.Struct, frozen=True):
    """The body finished the move, or does so while the planner is asked for the next one."""


class Stopped(msgspec.Struct, frozen=True):
    """The mission is over."""


Event: TypeAlias = (
    RoundBegan
    | Sensed
    | HeartbeatDue
    | MissionGiven
    | Planned
    | CommRoundBegan
    | Received
    | CommRoundEnded
    | AgreementEnded
    | Decided
    | Arrived
    | Stopped
)

# Effects: what the robot wants done.


class AskPlan(msgspec.Struct, frozen=True):
    """Ask the planner for a formation."""

    question: PlanQuestion


class AskStep(msgspec.Struct, frozen=True):
    """Ask the planner for a waypoint."""

    question: StepQuestion


class Broadcast(msgspec.Struct, frozen=True):
    """Send these bytes to whoever is in radio range."""

    payload: bytes


class MoveTo(msgspec.Struct, frozen=True, kw_only=True):
    """Fly to `waypoint`; `proposed` is what the planner asked for, where it answered."""

    waypoint: Point
    proposed: Point | None
    origin: Origin


class Note(msgspec.Struct, frozen=True):
    """Something worth recording: `kind` is a stable word, `detail` plain values."""

    kind: str
    detail: Mapping[str, Any] = msgspec.field(default_factory=dict[str, Any])


Effect: TypeAlias = AskPlan | AskStep | Broadcast | MoveTo | Note

AT_ANY_TIME = (Sensed, HeartbeatDue, MissionGiven, CommRoundBegan, Received, CommRoundEnded)
"""A robot sends, receives and senses in every phase, while its model thinks and while its body flies as well."""

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
"""Every legal (phase, event) and the phases it may lead to; anything else is a fault of the runtime."""
