"""What processes of a swarm tell each other besides the messages of the protocol, as MessagePack.

| topic | from | to | holds |
|---|---|---|---|
| `say/ID` | robot | robots in radio range | `Saying`: a message of the protocol, as it is, behind a beacon |
| `beacon/ID` | robot | robots in radio range | `Beacon`, where no message has brought one for a while |
| `frame/-1` | world | robots (their sensors), observers | `Frame` |
| `command/ID` | robot | its body, in the world | `Command` |
| `report/ID` | robot | observers | `Report` |
| `mission/ID` | operator | one robot | `Order` |
| `alive/ID` | liveliness token | everybody | nothing |
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


class Saying(msgspec.Struct, array_like=True, frozen=True):
    """A message of the protocol, and where its sender is: one packet for both, since packets cost more than bytes."""

    beacon: Beacon
    message: bytes


class Body(msgspec.Struct, array_like=True, frozen=True):
    """One body: where it is, where it will stop, and the last command that it has answered, obeyed or not."""

    position: Point
    end: Point
    command: int


class Frame(msgspec.Struct, array_like=True, frozen=True):
    """All bodies at one moment.

    Attributes:
        stamp: by the wall clock [s].
        closest: smallest distance of two bodies since the last frame, along their segments too [units].
        bodies: by id.
        late: commands refused because they came too late, so far.
    """

    stamp: float
    closest: float
    bodies: tuple[Body, ...]
    late: int


class Command(msgspec.Struct, array_like=True, frozen=True):
    """Fly from where the body is to stop, straight on to `target`, and be nowhere else when the deadline comes.

    Attributes:
        number: counts the robot's commands.
        stamp: when it was given, by the wall clock [s].
        origin: where the robot believes that its body is to stop: with another origin nothing is flown [units].
        target: where to stop then [units; world frame].
    """

    number: int
    stamp: float
    origin: Point
    target: Point


class Order(msgspec.Struct, frozen=True):
    """What is to change in the mission, by the names of its fields; with keys it is signed by the operator."""

    fields: dict[str, Any]
    counter: int = 0
    signature: bytes = b""


class Happened(msgspec.Struct, frozen=True):
    """Something that a robot decided or met."""

    kind: str
    detail: dict[str, Any]
    comm_round: int | None = None


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """How a robot fares: for observers only, no robot listens to it.

    Attributes:
        stamp: by the wall clock [s].
        round: own count of rounds.
        period: own count of heartbeat periods.
        phase: phase of its state machine.
        mission: counter and digest of the mission in force.
        plan_id: digest of the plan it follows.
        points: that plan's places, as long as they are news.
        proposer: who proposed it.
        slot: its place in it.
        goal: where that is [units; world frame].
        blocked: places that it knows nobody can take.
        waypoint: where it is flying to [units; world frame].
        origin: who made that waypoint.
        neighbors: |N_i|.
        happened: events since the last report.
        calls: model calls made since the last report, in the fields of the record.
        waypoints: waypoints flown so far, by origin.
        sent: messages of the protocol broadcast so far.
        bytes: bytes broadcast so far, beacons included.
        rejected: messages refused so far, by reason.
        latencies_s: one-way latencies of beacons heard since the last report [s].
        shape: the mission's fields, as long as they are news.
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
    happened: tuple[Happened, ...]
    calls: tuple[dict[str, Any], ...]
    waypoints: dict[str, int]
    sent: int
    bytes: int
    rejected: dict[str, int]
    latencies_s: tuple[float, ...]
    shape: dict[str, Any] | None


T = TypeVar("T", Beacon, Saying, Frame, Command, Order, Report)

_ENCODER = msgspec.msgpack.Encoder()


def pack(message: Beacon | Saying | Frame | Command | Order | Report) -> bytes:
    """The wire version, then MessagePack."""
    return bytes([WIRE_VERSION]) + _ENCODER.encode(message)


def unpack(kind: type[T], payload: bytes) -> T:
    """What `pack` made.

    Raises:
        MessageError: it is not of this kind or version.
    """
    if payload[:1] != bytes([WIRE_VERSION]):
        raise MessageError("version", f"version {WIRE_VERSION} is spoken here")
    try:
        return msgspec.msgpack.decode(memoryview(payload)[1:], type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", str(error)) from None
