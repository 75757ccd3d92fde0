"""Messages between the processes of a swarm other than those of the protocol, as MessagePack.

docs/reference/wire.md has a table of their topics.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

import msgspec

from llm_flock.arrays import Point
from llm_flock.errors import MessageError
from llm_flock.protocol.messages.order_time import LATEST

WIRE_VERSION = 2


class Beacon(msgspec.Struct, array_like=True, frozen=True):
    """Where a robot is, and where the segment that it flies ends; `stamp` by the wall clock [s]."""

    stamp: float
    position: Point
    end: Point


class BeaconedMessage(msgspec.Struct, array_like=True, frozen=True):
    """A protocol message and its sender's position in one packet: packets cost more than bytes."""

    beacon: Beacon
    message: bytes


class Body(msgspec.Struct, array_like=True, frozen=True):
    """One body: where it is, where it will stop, and the last command that it answered, obeyed or not."""

    position: Point
    end: Point
    command: int


class WorldState(msgspec.Struct, array_like=True, frozen=True):
    """All bodies, by id, at one moment by the wall clock [s]."""

    stamp: float
    closest: float  # smallest distance of two bodies since the last state, also along their segments [units]
    bodies: tuple[Body, ...]
    late: int  # commands refused so far because they came too late


class Command(msgspec.Struct, array_like=True, frozen=True):
    """Fly from where the body will stop straight on to `target`, up to the deadline."""

    number: int  # counts the robot's commands
    stamp: float  # when it was given, by the wall clock [s]
    origin: Point  # where the robot believes that its body will stop; the body refuses another origin [units]
    target: Point  # where to stop then [units; world frame]


class MissionOrder(msgspec.Struct, frozen=True):
    """Fields of the mission to change, by name, and the operator's time of the order; with keys, signed by it."""

    fields: dict[str, Any]
    counter: Annotated[int, msgspec.Meta(gt=0, lt=LATEST)]
    signature: bytes = b""


class ReportedEvent(msgspec.Struct, frozen=True):
    """An event of one robot, as in the record."""

    kind: str
    detail: dict[str, Any]
    comm_round: int | None = None


class RobotReport(msgspec.Struct, frozen=True, kw_only=True):
    """State of a robot, for observers only: no robot listens to it. Positions are in [units; world frame]."""

    stamp: float  # by the wall clock [s]
    round: int  # own count of motion rounds
    period: int  # own count of heartbeat periods
    phase: str  # of its state machine
    mission: tuple[int, str]  # time of the order for the mission in force, and its digest
    plan_id: str | None  # digest of the plan it follows
    points: tuple[Point, ...] | None  # that plan's places, in the first report that names it
    proposer: int | None  # robot that proposed it
    slot: int | None  # index of its place in the plan
    goal: Point | None  # that place
    blocked: tuple[int, ...]  # slots that it knows to be out of every robot's reach
    waypoint: Point | None  # where it is flying to
    origin: str  # what chose that waypoint
    neighbors: int  # |N_i|
    happened: tuple[ReportedEvent, ...]  # since the last report
    calls: tuple[dict[str, Any], ...]  # model calls since the last report, in the fields of the record
    waypoints: dict[str, int]  # flown so far, by origin
    sent: int  # protocol messages broadcast so far
    bytes: int  # broadcast so far, beacons included
    rejected: dict[str, int]  # messages refused so far, by reason
    breakers: tuple[str, ...]  # kinds of questions that its model is not asked
    hopeless: str | None  # why its model's last plan was refused, while it has none and its model is not asked
    latencies_s: tuple[float, ...]  # one-way, of beacons heard since the last report
    shape: dict[str, Any] | None  # the mission's fields, in the first report that names its digest


T = TypeVar("T", bound=msgspec.Struct)

_ENCODER = msgspec.msgpack.Encoder()


def pack(message: msgspec.Struct) -> bytes:
    """The wire version, then MessagePack."""
    return bytes([WIRE_VERSION]) + _ENCODER.encode(message)


def unpack(kind: type[T], payload: bytes) -> T:
    """The message that `pack` encoded; `MessageError` if it is not of this kind or version."""
    if payload[:1] != bytes([WIRE_VERSION]):
        raise MessageError("version", f"this program speaks version {WIRE_VERSION}")
    try:
        return msgspec.msgpack.decode(memoryview(payload)[1:], type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", str(error)) from None
