"""What robots say to each other: one kind of message, versioned, size-limited, validated on receipt.

A message carries the sender's whole public standing: its influence, its plan with that plan's pedigree, the slot
it claims and, for the auction, its table of claims. Positions are not in it: they are sensed.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import to_json

from llm_flock.arrays import Point
from llm_flock.errors import MessageError
from llm_flock.protocol.plan import Plan

WIRE_VERSION = 1
MAX_COORDINATE = 1e9
NO_OWNER = -1

Entry: TypeAlias = tuple[int, float, int]
"""One slot of an auction table: (version, bid, owner); owner is NO_OWNER for a free slot."""

Table: TypeAlias = tuple[Entry, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pedigree:
    """Where a plan comes from: fixed when it is proposed, carried along unchanged.

    Attributes:
        mission: counter of the mission the plan was made for.
        mission_digest: content of that mission.
        epoch: counter of the team's composition.
        neighbors: how many neighbours the proposer had, that is N times its influence (paper, eq. 1).
        proposer: id of the robot that proposed.
        sequence: counts the proposer's proposals.
    """

    mission: int
    mission_digest: str
    epoch: int
    neighbors: int
    proposer: int
    sequence: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """An exchange of places, offered to one neighbour.

    Attributes:
        to: robot that may accept it.
        give: slot that the sender owns and gives.
        take: slot that `to` owns and the sender would get.
        give_version: version of `give` that the offer is about.
        take_version: version of `take` that the offer is about.
        bid: the sender's bid for `take`.
    """

    to: int
    give: int
    take: int
    give_version: int
    take_version: int
    bid: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """One robot's standing, as broadcast.

    Attributes:
        sender: id of the robot.
        sequence: counts the changes of the sender's standing; equal content is equal bytes.
        neighbors: robots within the sender's radio range; its influence is neighbors / N (paper, eq. 1).
        plan: the plan it follows, None before it has one.
        pedigree: origin of that plan, present with it.
        slot: index of the place it claims in the plan.
        table: what it knows of everybody's claims on that plan (auction only).
        offer: an exchange of places that it offers (auction only).
        plan_class: how good the receiver itself found the plan; never sent, 0 where nothing was checked.
    """

    sender: int
    sequence: int
    neighbors: int
    plan: Plan | None = None
    pedigree: Pedigree | None = None
    slot: int | None = None
    table: Table | None = None
    offer: Offer | None = None
    plan_class: int = 0


Id = Annotated[int, Field(ge=0)]
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
Counter = Annotated[int, Field(ge=0, lt=2**40)]
"""Far more than any honest robot counts, and far enough from the integers of JSON to be raised without harm."""


class _WirePedigree(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    mission: Counter
    mission_digest: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
    epoch: Counter
    neighbors: Counter
    proposer: Id
    sequence: Counter


class _WireOffer(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    to: Id
    give: Id
    take: Id
    give_version: Counter
    take_version: Counter
    bid: Finite


class _WireMessage(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    v: Annotated[int, Field(ge=WIRE_VERSION, le=WIRE_VERSION)]
    sender: Id
    sequence: Counter
    neighbors: Counter
    plan: tuple[tuple[Finite, ...], ...] | None
    pedigree: _WirePedigree | None
    slot: Id | None
    table: tuple[tuple[Counter, Finite, int], ...] | None
    offer: _WireOffer | None


def max_payload_bytes(n_robots: int) -> int:
    """Largest payload that a team of N can legitimately need [bytes]."""
    return 1024 + 256 * n_robots


def encode(message: Message) -> bytes:
    """The message as JSON bytes."""
    origin = message.pedigree
    return to_json(
        {
            "v": WIRE_VERSION,
            "sender": message.sender,
            "sequence": message.sequence,
            "neighbors": message.neighbors,
            "plan": None if message.plan is None else message.plan.points,
            "pedigree": None
            if origin is None
            else {
                "mission": origin.mission,
                "mission_digest": origin.mission_digest,
                "epoch": origin.epoch,
                "neighbors": origin.neighbors,
                "proposer": origin.proposer,
                "sequence": origin.sequence,
            },
            "slot": message.slot,
            "table": message.table,
            "offer": None
            if message.offer is None
            else {
                "to": message.offer.to,
                "give": message.offer.give,
                "take": message.offer.take,
                "give_version": message.offer.give_version,
                "take_version": message.offer.take_version,
                "bid": message.offer.bid,
            },
        }
    )


@functools.lru_cache(maxsize=256)
def _plan(points: tuple[Point, ...]) -> Plan:
    """The plan of these points: a few plans come in many messages, and rounding a long one takes milliseconds."""
    return Plan(points)


@functools.lru_cache(maxsize=4096)
def decode(payload: bytes, n_robots: int, dim: int) -> Message:
    """A message from bytes that anybody may have sent.

    Pure, so equal payloads are decoded once (a broadcast has many receivers).

    Raises:
        MessageError: with reason `oversized`, `version`, `malformed`, `not_finite`, `wrong_length` or `unknown_id`.
    """
    if len(payload) > max_payload_bytes(n_robots):
        raise MessageError("oversized", f"{len(payload)} bytes, at most {max_payload_bytes(n_robots)} are allowed")
    try:
        wire = _WireMessage.model_validate_json(payload)
    except ValidationError as error:
        raise _rejection(error) from None
    _check_ids(wire, n_robots)
    _check_lengths(wire, n_robots, dim)
    origin = wire.pedigree
    return Message(
        sender=wire.sender,
        sequence=wire.sequence,
        neighbors=wire.neighbors,
        plan=None if wire.plan is None else _plan(wire.plan),
        pedigree=None
        if origin is None
        else Pedigree(
            mission=origin.mission,
            mission_digest=origin.mission_digest,
            epoch=origin.epoch,
            neighbors=origin.neighbors,
            proposer=origin.proposer,
            sequence=origin.sequence,
        ),
        slot=wire.slot,
        table=wire.table,
        offer=None if wire.offer is None else Offer(**dict(wire.offer)),
    )


def _rejection(error: ValidationError) -> MessageError:
    """The word under which a refused payload is counted."""
    faults = error.errors(include_url=False, include_context=False, include_input=False)
    places = {fault["loc"][:1] for fault in faults}
    kinds = {fault["type"] for fault in faults}
    detail = f"{'.'.join(map(str, faults[0]['loc']))}: {faults[0]['msg']}"
    if ("v",) in places:
        return MessageError("version", f"version {WIRE_VERSION} is spoken here")
    if kinds & {"finite_number"}:
        return MessageError("not_finite", detail)
    return MessageError("malformed", detail)


def _check_ids(wire: _WireMessage, n_robots: int) -> None:
    named = [wire.sender]
    if wire.pedigree is not None:
        named.append(wire.pedigree.proposer)
    if wire.offer is not None:
        named.append(wire.offer.to)
    if wire.table is not None:
        named.extend(entry[2] for entry in wire.table if entry[2] != NO_OWNER)
    for robot in named:
        if not 0 <= robot < n_robots:
            raise MessageError("unknown_id", f"robot {robot} in a team of {n_robots}")
    if max(wire.neighbors, wire.pedigree.neighbors if wire.pedigree else 0) >= n_robots:
        raise MessageError("unknown_id", f"more neighbours than a team of {n_robots} has")


def _check_lengths(wire: _WireMessage, n_robots: int, dim: int) -> None:
    if (wire.plan is None) != (wire.pedigree is None):
        raise MessageError("malformed", "a plan and its pedigree go together")
    if wire.plan is None:
        if wire.slot is not None or wire.table is not None or wire.offer is not None:
            raise MessageError("malformed", "claims without a plan")
        return
    if len(wire.plan) != n_robots or set(map(len, wire.plan)) != {dim}:
        raise MessageError("wrong_length", f"a plan has {n_robots} points of {dim} coordinates")
    if wire.slot is not None and wire.slot >= n_robots:
        raise MessageError("wrong_length", f"slot {wire.slot} of {n_robots}")
    if wire.offer is not None and max(wire.offer.give, wire.offer.take) >= n_robots:
        raise MessageError("wrong_length", f"an offer of slots {wire.offer.give} and {wire.offer.take} of {n_robots}")
    if wire.table is not None and len(wire.table) != n_robots:
        raise MessageError("wrong_length", f"a table has {n_robots} entries, not {len(wire.table)}")
