"""Messages as bytes: one version byte, then MessagePack; bounded in size, and validated on receipt."""

from __future__ import annotations

import operator
from functools import lru_cache
from typing import Annotated

import msgspec

from llm_flock.arrays import Point
from llm_flock.bounds import MAX_ROBOTS
from llm_flock.errors import MessageError
from llm_flock.protocol.messages.message import (
    BLOCKED,
    LAST_ROUND,
    UNSAID,
    Bid,
    BidEntry,
    BidTable,
    Coordinate,
    Counter,
    Course,
    Id,
    Message,
    MissionStamp,
    Offer,
    Provenance,
)
from llm_flock.protocol.messages.order_time import LATEST
from llm_flock.protocol.plan import Plan

WIRE_VERSION = 7

FEW = 0.5
"""Largest share of a table's slots that counts as few."""

Owner = Annotated[int, msgspec.Meta(ge=BLOCKED, lt=MAX_ROBOTS)]
Round = Annotated[int, msgspec.Meta(ge=0, le=LAST_ROUND)]
OrderTime = Annotated[int, msgspec.Meta(ge=0, lt=LATEST)]
Digest = Annotated[bytes, msgspec.Meta(min_length=8, max_length=8)]


class _WireProvenance(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    epoch: Counter
    neighbors: Id
    proposer: Id
    sequence: Counter


class _WireMessage(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    sender: Id
    sequence: Counter
    neighbors: Id
    mission: OrderTime
    mission_digest: Digest
    mission_text: str | None
    provenance: _WireProvenance | None
    places: Annotated[int, msgspec.Meta(ge=0, le=MAX_ROBOTS)]
    plan_digest: Digest | None
    plan: tuple[tuple[Coordinate, ...], ...] | None
    slot: Id | None
    table_digest: Digest | None
    claims: tuple[tuple[Id, Counter, Bid, Owner], ...] | None
    offer: Offer | None
    course: Course | None
    beats: tuple[Counter, ...] | None
    positions: dict[Id, tuple[Round, tuple[Coordinate, ...], tuple[Coordinate, ...]]] | None


_VERSION = bytes([WIRE_VERSION])
_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(_WireMessage)
_SLOT, _OWNER = operator.itemgetter(0), operator.itemgetter(3)


def max_payload_bytes(n_robots: int) -> int:
    """Largest payload that a team of N legitimately needs [bytes]."""
    return 4096 + 256 * n_robots


def encode(message: Message, sequence: int | None = None) -> bytes:
    """The message as bytes, with its own or another sequence number."""
    origin = message.provenance
    wire = _WireMessage(
        sender=message.sender,
        sequence=message.sequence if sequence is None else sequence,
        neighbors=message.degree,
        mission=message.mission.counter,
        mission_digest=bytes.fromhex(message.mission.digest),
        mission_text=message.mission_text,
        provenance=None
        if origin is None
        else _WireProvenance(origin.epoch, origin.degree, origin.proposer, origin.sequence),
        places=message.places,
        plan_digest=None if message.plan_digest is None else bytes.fromhex(message.plan_digest),
        plan=None if message.plan is None else message.plan.points,
        slot=message.slot,
        table_digest=None if message.table_digest is None else bytes.fromhex(message.table_digest),
        claims=_claims(message),
        offer=message.offer,
        course=message.course,
        beats=message.beats,
        positions=message.positions,
    )
    return _VERSION + _ENCODER.encode(wire)


def _claims(message: Message) -> tuple[tuple[int, int, float, int], ...] | None:
    table = message.table
    if table is None:
        return None
    slots = range(len(table)) if message.said is None else message.said
    return tuple([_claim(a, table[a]) for a in slots if table[a] != UNSAID])


def _claim(slot: int, entry: BidEntry) -> tuple[int, int, float, int]:
    """An entry on the wire. A bid of 0, as in joint assignments, takes one byte as an integer, and nine as a float."""
    version, bid, owner = entry
    return slot, version, bid or 0, owner


def decode(payload: bytes, n_robots: int, dim: int) -> Message:
    """The message in a payload from an untrusted sender. Pure.

    Raises:
        MessageError: with reason `oversized`, `version`, `malformed`, `wrong_length` or `unknown_id`.
    """
    if len(payload) > max_payload_bytes(n_robots):
        raise MessageError("oversized", f"{len(payload)} bytes, at most {max_payload_bytes(n_robots)} are allowed")
    if payload[:1] != _VERSION:
        raise MessageError("version", f"version {WIRE_VERSION} is spoken here")
    try:
        wire = _DECODER.decode(memoryview(payload)[1:])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", str(error)) from None
    _check_ids(wire, n_robots)
    _check_lengths(wire, n_robots, dim)
    mission_digest, origin = wire.mission_digest.hex(), wire.provenance
    return Message(
        sender=wire.sender,
        sequence=wire.sequence,
        degree=wire.neighbors,
        mission=MissionStamp(wire.mission, mission_digest),
        mission_text=wire.mission_text,
        plan=None if wire.plan is None else _plan(wire.plan),
        plan_digest=None if wire.plan_digest is None else wire.plan_digest.hex(),
        places=wire.places,
        provenance=None
        if origin is None
        else Provenance(
            mission=wire.mission,
            mission_digest=mission_digest,
            epoch=origin.epoch,
            degree=origin.neighbors,
            proposer=origin.proposer,
            sequence=origin.sequence,
        ),
        slot=wire.slot,
        table=_table(wire),
        said=None if wire.claims is None or len(wire.claims) > FEW * wire.places else tuple(map(_SLOT, wire.claims)),
        table_digest=None if wire.table_digest is None else wire.table_digest.hex(),
        offer=None if wire.offer is None else msgspec.structs.replace(wire.offer, bid=wire.offer.bid + 0.0),
        course=wire.course,
        beats=wire.beats,
        positions=wire.positions,
    )


@lru_cache(maxsize=256)
def _plan(points: tuple[Point, ...]) -> Plan:
    """The plan of these points. All robots spell out the same few plans, and rounding and hashing one is slow."""
    return Plan(points)


def _table(wire: _WireMessage) -> BidTable | None:
    if wire.claims is None:
        return None
    table = [UNSAID] * wire.places
    for slot, version, bid, owner in wire.claims:
        table[slot] = _entry(version, bid, owner)
    return tuple(table)


@lru_cache(maxsize=2**18)
def _entry(version: int, bid: float, owner: int) -> BidEntry:
    """One object for equal entries, so that large tables are compared by identity (`agreement.auction.merged`).

    A bid of zero loses its sign: equal entries must have the same digest and signature, whichever is read first.
    """
    return version, bid + 0.0, owner


def _check_ids(wire: _WireMessage, n_robots: int) -> None:
    named = {wire.sender}
    if wire.provenance is not None:
        named.add(wire.provenance.proposer)
    if wire.offer is not None:
        named.add(wire.offer.to)
    if wire.course is not None:
        named.add(wire.course.of)
    if wire.claims:
        named.add(max(map(_OWNER, wire.claims)))
    if wire.positions:
        named.add(max(wire.positions))
    if max(named) >= n_robots:
        raise MessageError("unknown_id", f"robot {max(named)} in a team of {n_robots}")
    if max(wire.neighbors, wire.provenance.neighbors if wire.provenance else 0) >= n_robots:
        raise MessageError("unknown_id", f"more neighbours than a team of {n_robots} has")


def _check_lengths(wire: _WireMessage, n_robots: int, dim: int) -> None:
    if wire.beats is not None and len(wire.beats) != n_robots:
        raise MessageError("wrong_length", f"{len(wire.beats)} heartbeats of {n_robots} robots")
    if wire.positions and not all(len(x) == dim and len(mark) in (0, dim) for _, x, mark in wire.positions.values()):
        raise MessageError("wrong_length", f"a position has {dim} coordinates")
    if wire.course is not None and set(map(len, wire.course.path)) != {dim}:
        raise MessageError("wrong_length", f"a course has points of {dim} coordinates")
    if (wire.plan_digest is None) != (wire.provenance is None) or (wire.plan is not None and wire.plan_digest is None):
        raise MessageError("malformed", "a plan and its provenance go together")
    if (wire.claims is None) != (wire.table_digest is None):
        raise MessageError("malformed", "claims and their digest go together")
    if wire.plan_digest is None:
        if wire.places or wire.slot is not None or wire.claims is not None or wire.offer is not None:
            raise MessageError("malformed", "claims without a plan")
        return
    if not wire.places:
        raise MessageError("wrong_length", "a plan without places")
    if wire.plan is not None and (len(wire.plan) != wire.places or set(map(len, wire.plan)) != {dim}):
        raise MessageError("wrong_length", f"a plan of {wire.places} places has as many points of {dim} coordinates")
    slots = [max(map(_SLOT, wire.claims))] if wire.claims else []
    if wire.slot is not None:
        slots.append(wire.slot)
    if wire.offer is not None:
        slots += (wire.offer.give, wire.offer.take)
    if slots and max(slots) >= wire.places:
        raise MessageError("wrong_length", f"slot {max(slots)} of a plan of {wire.places} places")
