"""Certificates: signatures under bid entries, offers, plan origins, heartbeats and missions, and how they are encoded.

A slot is freed, or found blocked, by witnesses, one more than may lie; a claim on it is signed by its owner and carries
their statements. An exchange is signed by both robots, and counts only where no two may lie together. So one of
the signers is honest, and no history has to be shown. Of a robot's numbered claims on one plan the last one counts.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Protocol, TypeAlias

import msgspec
from msgspec.structs import astuple

from llm_flock.bounds import MAX_ROBOTS, max_payload_bytes
from llm_flock.errors import MessageError
from llm_flock.message import (
    BLOCKED,
    MAX_BID,
    MAX_EPOCHS,
    MAX_LOOKS,
    NO_OWNER,
    BidEntry,
    Id,
    MissionStamp,
    Offer,
    Provenance,
)

OPERATOR = -2  # member id of the operator, who gives missions
WIRE_SIGNED = 9  # first byte of a message with certificates
LIARS = 1  # robots that may lie together, unless a team is told otherwise
LEFT = -3  # in a witness's statement: the slot is free because robot 0 left it; `left_by` gives that of every robot


def left_by(robot: int) -> int:
    """In a witness's statement, in place of an owner: the slot is free because this robot left it."""
    return LEFT - robot


def witnesses(liars: int) -> int:
    """Robots that must state that a slot is free or blocked: one more than may lie."""
    return liars + 1


def most_exchanges(places: int) -> int:
    """Highest number of an offer, or of the acceptance of one, on a plan: later, an honest robot makes none."""
    return places + 20


def most_claims(places: int) -> int:
    """Highest number of a claim on a plan that counts: far above what liars can drive an honest robot to.

    One takes a place by `most_exchanges` exchanges at most, and each by bids once a slot, or until its owner has drawn
    higher.
    """
    return (places + 4) * most_exchanges(places)


class Verifier(Protocol):
    """Checks signatures."""

    def check(self, member: int, statement: bytes, signature: bytes) -> bool: ...


class Authenticator(Verifier, Protocol):
    """Signs as its robot, and checks the signatures of others."""

    def sign(self, statement: bytes) -> bytes: ...


@dataclass(frozen=True, slots=True)
class Context:
    """The plan that a claim is about. The same plan under another origin is another one: its signatures are void."""

    mission: MissionStamp
    plan: str
    origin: Provenance | None = None

    @property
    def proposer(self) -> int:
        """The robot that proposed the plan; NO_OWNER if it is not known."""
        return NO_OWNER if self.origin is None else self.origin.proposer


@lru_cache(maxsize=2**14)
def drawn_bid(context: Context, slot: int, version: int, owner: int) -> float:
    """The bid for a slot of a version above 0: drawn by lot, so that no robot outbids another wherever it goes."""
    lot = hashlib.blake2b(_statement("lot", context, slot, version, owner), digest_size=4).digest()
    return -1.0 - (int.from_bytes(lot) >> 12)


Signature = Annotated[bytes, msgspec.Meta(max_length=64)]
Number = Annotated[int, msgspec.Meta(ge=0, lt=2**31)]
Count = Annotated[int, msgspec.Meta(ge=0, lt=2**41)]


class ReleaseGrant(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True, tag=0):
    """Statements that the slot is free, or blocked, from this version on; `by` is who left it, if that is why."""

    words: Annotated[tuple[tuple[Id, Signature], ...], msgspec.Meta(min_length=witnesses(LIARS), max_length=MAX_ROBOTS)]
    by: Annotated[int, msgspec.Meta(ge=NO_OWNER, lt=MAX_ROBOTS)] = NO_OWNER


class ExchangeGrant(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True, tag=1):
    """An offer, signed by its maker, and its acceptance, signed by the robot that took it."""

    maker: Id
    to: Id
    give: Id
    take: Id
    give_version: Count
    take_version: Count
    bid: float
    number: Number
    signature: Signature
    accepted_bid: float
    accepted_number: Number
    accepted: Signature

    def entries(self) -> dict[int, tuple[BidEntry, int]]:
        """The entries of the two slots after the exchange, and the numbers of these claims."""
        return {
            self.give: ((self.give_version + 1, self.accepted_bid, self.to), self.accepted_number),
            self.take: ((self.take_version + 1, self.bid, self.maker), self.number),
        }

    def offer(self) -> Offer:
        return Offer(
            to=self.to,
            give=self.give,
            take=self.take,
            give_version=self.give_version,
            take_version=self.take_version,
            bid=self.bid,
        )


Grant: TypeAlias = ReleaseGrant | ExchangeGrant


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """Why an entry holds."""

    number: int  # of the owner's claim; 0 for a slot without owner
    signature: bytes = b""  # the owner's on its claim; empty if the grant has it, or without owner
    grant: Grant | None = None  # why the version was raised; None for version 0


class _Claim(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    slot: Id
    number: Number
    signature: Signature
    grant: Id | None


class WitnessStatement(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """A robot's statement that a slot is free or blocked from a version on; others pass it on."""

    witness: Id
    slot: Id
    version: Count
    owner: Annotated[int, msgspec.Meta(gt=LEFT - MAX_ROBOTS, le=NO_OWNER)]
    signature: Signature


class RestlessWord(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """A witness's statement that a robot leaves place after place of the plan; others pass it on."""

    robot: Id
    witness: Id
    signature: Signature


class LastClaim(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """A robot's claim with its certificate.

    Shown to a robot that claims under a lower number: it has restarted. And shown where a claim does not count any more
    but has outbid another: it is the cause why that one's owner has gone.
    """

    slot: Id
    version: Count
    bid: float
    owner: Id
    number: Number
    signature: Signature
    grant: Grant | None

    @classmethod
    def of(cls, slot: int, entry: BidEntry, certificate: Certificate) -> LastClaim:
        return cls(slot, *entry, certificate.number, certificate.signature, certificate.grant)

    @property
    def entry(self) -> BidEntry:
        return (self.version, self.bid, self.owner)

    @property
    def certificate(self) -> Certificate:
        return Certificate(number=self.number, signature=self.signature, grant=self.grant)


class SignedPlan(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """A plan by its digest, with what else its proposer has signed about it (`origin_statement`)."""

    plan: Annotated[str, msgspec.Meta(max_length=16)]
    epoch: Annotated[int, msgspec.Meta(ge=0, le=MAX_EPOCHS)]
    degree: Id
    sequence: Annotated[int, msgspec.Meta(ge=0, le=MAX_EPOCHS)]
    signature: Signature


class Equivocation(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """Two plans for one epoch of the mission that one robot has signed, which no honest one does."""

    proposer: Id
    plans: tuple[SignedPlan, SignedPlan]


class Proofs(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """The certificates of a message."""

    claims: tuple[_Claim, ...] = ()
    grants: tuple[Grant, ...] = ()
    words: tuple[WitnessStatement, ...] = ()
    offer: tuple[Number, Signature] | None = None
    origin: Signature | None = None
    mission: Signature | None = None
    beats: tuple[Signature, ...] | None = None
    last: tuple[LastClaim, ...] = ()
    restless: tuple[RestlessWord, ...] = ()
    causes: tuple[LastClaim, ...] = ()
    equivocations: tuple[Equivocation, ...] = ()

    def certificates(self) -> dict[int, Certificate]:
        """By slot; an index of a grant that is missing gives a certificate without grant."""
        return {
            claim.slot: Certificate(
                number=claim.number,
                signature=claim.signature,
                grant=self.grants[claim.grant] if claim.grant is not None and claim.grant < len(self.grants) else None,
            )
            for claim in self.claims
        }


class _Signed(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    message: bytes
    proofs: Proofs


_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(_Signed)


def max_signed_bytes(n_robots: int, liars: int = LIARS) -> int:
    """Largest message with certificates that a team of N legitimately needs [bytes]."""
    return max_payload_bytes(n_robots) + 2048 + (1584 + 80 * witnesses(liars)) * n_robots


def claims_of(certificates: dict[int, Certificate]) -> tuple[tuple[_Claim, ...], tuple[Grant, ...]]:
    """Certificates as they are encoded: a grant that several of them need appears once."""
    grants: dict[Grant, int] = {}
    claims = tuple(
        _Claim(slot, w.number, w.signature, None if w.grant is None else grants.setdefault(w.grant, len(grants)))
        for slot, w in certificates.items()
    )
    return claims, tuple(grants)


def wrap(message: bytes, proofs: Proofs) -> bytes:
    return bytes([WIRE_SIGNED]) + _ENCODER.encode(_Signed(message, proofs))


def unwrap(payload: bytes, n_robots: int, liars: int = LIARS) -> tuple[bytes, Proofs]:
    """Message and certificates in a payload from any member; a MessageError `oversized`, `version` or `malformed`."""
    most = max_signed_bytes(n_robots, liars)
    if len(payload) > most:
        raise MessageError("oversized", f"{len(payload)} bytes, at most {most} are allowed")
    if payload[:1] != bytes([WIRE_SIGNED]):
        raise MessageError("version", f"signed messages are of version {WIRE_SIGNED}")
    try:
        signed = _DECODER.decode(memoryview(payload)[1:])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", str(error)) from None
    return signed.message, signed.proofs


# Each signed statement begins with its kind, so none can be taken for one of another kind.


def claim_statement(context: Context, slot: int, entry: BidEntry, number: int) -> bytes:
    """Signed by an owner: this slot is mine."""
    return _statement("claim", context, slot, *entry, number)


def word_statement(context: Context, slot: int, version: int, owner: int) -> bytes:
    """Signed by a witness: from this version on the slot is free, or blocked."""
    return _statement("word", context, slot, version, owner)


def restless_statement(context: Context, robot: int) -> bytes:
    """Signed by a witness: this robot leaves place after place."""
    return _statement("restless", context, robot)


def offer_statement(context: Context, maker: int, offer: Offer, number: int) -> bytes:
    """Signed by an offer's maker: the addressee may exchange these slots with me."""
    return _statement("offer", context, maker, *astuple(offer), number)


def acceptance_statement(context: Context, exchange: ExchangeGrant) -> bytes:
    """Signed by the addressee: the exchange is made."""
    terms = (exchange.maker, *astuple(exchange.offer()), exchange.number)
    return _statement("accept", context, *terms, exchange.accepted_bid, exchange.accepted_number)


def origin_statement(origin: Provenance, plan: str) -> bytes:
    """Signed by a proposer: this plan is mine."""
    stamp = origin.stamp
    place = (origin.epoch, origin.degree, origin.proposer, origin.sequence)
    return _statement("origin", Context(stamp, plan), *place)


def beat_statement(robot: int, count: int) -> bytes:
    """Signed by a robot: this is my heartbeat counter."""
    return _ENCODER.encode(("beat", robot, count))


def mission_statement(stamp: MissionStamp) -> bytes:
    """Signed by the operator: this is the mission."""
    return _ENCODER.encode(("mission", stamp.counter, stamp.digest))


def _statement(kind: str, context: Context, *values: float) -> bytes:
    origin = context.origin
    proposal = () if origin is None else (origin.epoch, origin.degree, origin.proposer, origin.sequence)
    about = context.mission.counter, context.mission.digest, context.plan, proposal
    return _ENCODER.encode((kind, *about, *values))


def plausible(context: Context, slot: int, entry: BidEntry, number: int) -> bool:
    """Whether an honest robot could ever write such an entry."""
    version, bid, owner = entry
    if owner == NO_OWNER:
        return 0.0 <= bid <= MAX_LOOKS
    if owner == BLOCKED:
        return bid == 0.0 and version > 0
    in_range = -MAX_BID <= bid <= 0.0 if version == 0 else bid == drawn_bid(context, slot, version, owner)
    return in_range and number > 0
