"""Messages between the processes of a swarm other than those of the protocol: see docs/reference/wire.md."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec

from llm_flock.bounds import LATEST, MAX_DISTANCE, MAX_INTEGER, MAX_REASON, MAX_ROBOTS, MAX_ROUND, MAX_WORD
from llm_flock.errors import MessageError
from llm_flock.message import Coordinate, Id, OrderTime
from llm_flock.plan import Plan
from llm_flock.printable import one_line
from llm_flock.record import Entry, LlmEntry, ProtocolEvent
from llm_flock_swarm._signed.certificates import Signature

WIRE_VERSION = 5

MAX_EVENTS = 4096  # most events or calls in one report
MAX_WORDS = 64  # most entries of a dictionary by origin or by reason
Place: TypeAlias = tuple[Coordinate, ...]  # one position; its receiver checks the length [units; world frame]
Stamp = Annotated[float, msgspec.Meta(ge=0.0, le=2.0**40)]  # a moment by the wall clock [s]

Amount = Annotated[float, msgspec.Meta(ge=0.0, le=MAX_DISTANCE)]
MAX_LATENCY_S = 60.0  # later beacons count as this late [s]
Count = Annotated[int, msgspec.Meta(ge=0, le=MAX_INTEGER)]
Round = Annotated[int, msgspec.Meta(ge=0, le=MAX_ROUND)]
Word = Annotated[str, msgspec.Meta(max_length=MAX_WORD)]
Reason = Annotated[str, msgspec.Meta(max_length=MAX_REASON)]

Slots = Annotated[tuple[Id, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
Words = Annotated[tuple[Word, ...], msgspec.Meta(max_length=MAX_WORDS)]
Latency = Annotated[float, msgspec.Meta(ge=0.0, le=MAX_LATENCY_S)]
Latencies = Annotated[tuple[Latency, ...], msgspec.Meta(max_length=MAX_EVENTS)]
Events = Annotated[tuple[ProtocolEvent, ...], msgspec.Meta(max_length=MAX_EVENTS)]
Calls = Annotated[tuple[LlmEntry, ...], msgspec.Meta(max_length=MAX_EVENTS)]
Counts = Annotated[dict[Word, Count], msgspec.Meta(max_length=MAX_WORDS)]


class Beacon(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """The position of a robot; `stamp` by the wall clock [s]."""

    stamp: Stamp
    position: Place


class BeaconedMessage(msgspec.Struct, array_like=True, frozen=True):
    """A protocol message and its sender's position in one packet: packets cost more than bytes."""

    beacon: Beacon
    message: bytes


class Body(msgspec.Struct, array_like=True, frozen=True):
    """One body: where it is, where it will stop, and the last command that it answered, obeyed or not."""

    position: Place
    end: Place
    command: Count


class WorldState(msgspec.Struct, array_like=True, frozen=True):
    """All bodies, by id, at one moment by the wall clock [s]."""

    stamp: Stamp
    closest: Amount | None  # smallest distance of two bodies since the last state, on their way too; None of one body
    bodies: Annotated[tuple[Body, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
    late: Count  # commands refused so far because they came too late


class Command(msgspec.Struct, array_like=True, frozen=True):
    """Fly from where the body will stop straight on to `target`, up to the deadline."""

    number: Count  # counts the robot's commands
    stamp: Stamp  # when it was given, by the wall clock [s]
    origin: Place  # where the robot believes that its body will stop; the body refuses another origin [units]
    target: Place  # where to stop then [units; world frame]


class MissionOrder(msgspec.Struct, frozen=True):
    """Fields of the mission to change, by name, and the operator's time of the order; with keys, signed by it."""

    fields: dict[str, Any]
    counter: Annotated[int, msgspec.Meta(gt=0, lt=LATEST)]
    signature: Signature = b""


class RobotReport(msgspec.Struct, frozen=True, kw_only=True):
    """State of a robot, for observers only: no robot listens to it. Positions are in [units; world frame]."""

    round: Round  # own count of motion rounds
    period: Round  # own count of heartbeat periods
    phase: Word  # of its state machine
    mission: tuple[OrderTime, Word]  # time of the order, digest of the mission
    order: Signature  # of the operator, on that time and digest; empty for the first mission, and without keys
    plan_id: Word | None  # digest of the plan it follows
    plan: Plan | None  # that plan, in the first report that names it
    proposer: Id | None  # robot that proposed it
    slot: Id | None  # index of its place in the plan
    blocked: Slots  # slots that it knows to be out of every robot's reach
    replans: bool = False  # whether it will leave the plan, which does not fit the robots that it knows to be alive
    waypoint: Place | None  # where it is flying to
    origin: Word  # what chose that waypoint
    neighbors: Id  # |N_i|
    happened: Events  # since the last report; entries of a record in its JSON, so that all that is decoded fits there
    calls: Calls  # likewise
    waypoints: Counts  # flown so far, by origin
    sent: Count  # protocol messages broadcast so far
    bytes: Count  # broadcast so far, beacons included
    rejected: Counts  # messages refused so far, by reason
    breakers: Words  # kinds of questions that its model is not asked
    hopeless: Reason | None  # why its model's last plan was refused, while it has none and its model is not asked
    latencies_s: Latencies  # one-way, of beacons heard since the last report
    shape: dict[str, Any] | None  # the mission's fields, in the first report that names its digest


T = TypeVar("T", bound=msgspec.Struct)

_ENCODER = msgspec.msgpack.Encoder(enc_hook=Entry.encoded)


def pack(message: msgspec.Struct) -> bytes:
    """The wire version, then MessagePack."""
    return bytes([WIRE_VERSION]) + _ENCODER.encode(message)


def _entry(kind: type[Entry], data: bytes) -> Entry:
    return kind.model_validate_json(data)


def unpack(kind: type[T], payload: bytes) -> T:
    """The message that `pack` encoded; `MessageError` if it is not of this kind or version."""
    if payload[:1] != bytes([WIRE_VERSION]):
        raise MessageError("version", f"this program speaks version {WIRE_VERSION}")
    try:
        return msgspec.msgpack.decode(memoryview(payload)[1:], type=kind, dec_hook=_entry)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", one_line(str(error))) from None
