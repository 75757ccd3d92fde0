"""Messages between the processes of a swarm other than those of the protocol, as MessagePack.

| topic | from | to | content |
|---|---|---|---|
| `say/ID` | robot | robots in radio range | `BeaconedMessage`: a protocol message, unchanged, behind a beacon |
| `beacon/ID` | robot | robots in radio range | `Beacon`, where no message has carried one for a while |
| `frame/-1` | world | robots (their sensors), observers | `WorldState` |
| `command/ID` | robot | its body, in the world | `Command` |
| `report/ID` | robot | observers | `RobotReport` |
| `mission/ID` | operator | one robot | `MissionOrder` |
| `alive/ID` | liveliness token | all processes | nothing |
"""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec

from llm_flock.arrays import Point
from llm_flock.errors import MessageError

WIRE_VERSION = 1


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
    """All bodies at one moment.

    Attributes:
        stamp: by the wall clock [s].
        closest: smallest distance of two bodies since the last state, also along their segments [units].
        bodies: by id.
        late: commands refused so far because they came too late.
    """

    stamp: float
    closest: float
    bodies: tuple[Body, ...]
    late: int


class Command(msgspec.Struct, array_like=True, frozen=True):
    """Fly from where the body will stop straight on to `target`, up to the deadline.

    Attributes:
        number: counts the robot's commands.
        stamp: when it was given, by the wall clock [s].
        origin: where the robot believes that its body will stop; the body refuses another origin [units].
        target: where to stop then [units; world frame].
    """

    number: int
    stamp: float
    origin: Point
    target: Point


class MissionOrder(msgspec.Struct, frozen=True):
    """Fields of the mission to change, by name; with keys, signed by the operator."""

    fields: dict[str, Any]
    counter: int = 0
    signature: bytes = b""


class ReportedEvent(msgspec.Struct, frozen=True):
    """An event of one robot, as in the record."""

    kind: str
    detail: dict[str, Any]
    comm_round: int | None = None


class RobotReport(msgspec.Struct, frozen=True, kw_only=True):
    """State of a robot, for observers only: no robot listens to it.

    Attributes:
        stamp: by the wall clock [s].
        round: own count of motion rounds.
        period: own count of heartbeat periods.
        phase: phase of its state machine.
        mission: counter and digest of the mission in force.
        plan_id: digest of the plan it follows.
        points: that plan's places, in the first report that names it.
        proposer: robot that proposed it.
        slot: index of its place in the plan.
        goal: that place [units; world frame].
        blocked: slots that it knows to be out of every robot's reach.
        waypoint: where it is flying to [units; world frame].
        origin: what chose that waypoint.
        neighbors: |N_i|.
        happened: events since the last report.
        calls: model calls since the last report, in the fields of the record.
        waypoints: waypoints flown so far, by origin.
        sent: protocol messages broadcast so far.
        bytes: bytes broadcast so far, beacons included.
        rejected: messages refused so far, by reason.
        latencies_s: one-way latencies of beacons heard since the last report [s].
        shape: the mission's fields, in the first report that names its digest.
    """

    stamp: float
    round: int
    period: int
    phase: str
    mission: tuple[int, str]
    plan_id: str | None
    points: tuple[Point, ...] | None
    proposer: int | None
    slot: int | None
    goal: Point | None
    blocked: tuple[int, ...]
    waypoint: Point | None
    origin: str
    neighbors: int
    happened: tuple[ReportedEvent, ...]
    calls: tuple[dict[str, Any], ...]
    waypoints: dict[str, int]
    sent: int
    bytes: int
    rejected: dict[str, int]
    latencies_s: tuple[float, ...]
    shape: dict[str, Any] | None


T = TypeVar("T", bound=msgspec.Struct)

_ENCODER = msgspec.msgpack.Encoder()


def pack(message: msgspec.Struct) -> bytes:
    """The wire version, then MessagePack."""
    return bytes([WIRE_VERSION]) + _ENCODER.encode(message)


def unpack(kind: type[T], payload: bytes) -> T:
    """The message that `pack` encoded.

    Raises:
        MessageError: it is not of this kind or version.
    """
    if payload[:1] != bytes([WIRE_VERSION]):
        raise MessageError("version", f"this program speaks version {WIRE_VERSION}")
    try:
        return msgspec.msgpack.decode(memoryview(payload)[1:], type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", str(error)) from None
