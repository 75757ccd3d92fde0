"""The message that robots exchange, and its encoding: a version byte, then MessagePack.

A message carries all public knowledge about its sender: mission, influence, plan with its provenance, claimed slot and,
for the auction, its bids. Long parts are named by a digest, and spelled out only where a neighbour may lack them
(`llm_flock.protocol._messages.dissemination`). Positions of neighbours are sensed; reports of positions are for
joint assignments. The types of the fields hold the bounds of what a stranger may send, and `decode` checks the rest.
"""

from __future__ import annotations

import hashlib
import json
import operator
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, TypeAlias, cast

import msgspec
from msgspec.structs import astuple, force_setattr, replace

from llm_flock.arrays import MAX_COORDINATE
from llm_flock.bounds import LATEST, MAX_ORDER_BYTES, MAX_ROBOTS, max_payload_bytes, max_places
from llm_flock.errors import InputError, MessageError
from llm_flock.mission import MISSION_FIELDS, OPTIONAL, Mission
from llm_flock.plan import Coordinate, Plan

LOGICAL_BITS = 16  #: Lowest bits of an order's time, which count orders within a millisecond.

MAX_AHEAD_MS = 24 * 3600 * 1000  #: Others' times are believed if at most this far ahead of the own clock [ms].


def order_time(milliseconds: int, count: int = 0) -> int:
    """The time of an order at this moment [ms], the `count`-th of its millisecond."""
    return (milliseconds << LOGICAL_BITS) + count


class OperatorClock:
    """Gives each order of one operator a higher time than all before; `now_ms` is the wall clock [ms since 1970]."""

    def __init__(self, now_ms: Callable[[], int]) -> None:
        self._now_ms = now_ms
        self._last = 0

    def witness(self, time: int, *, own: bool = False) -> None:
        """Take note of the time of another order; one proven to be its `own` counts, however wrong the clock was."""
        if own or time <= order_time(self._now_ms() + MAX_AHEAD_MS):
            self._last = max(self._last, time)

    def next(self) -> int:
        """The time of an order that is given now."""
        self._last = max(order_time(self._now_ms()), self._last + 1)
        return self._last


def time_text(time: int) -> str:
    """An order's time as text. The first mission, and rounds of a simulation, count from 1970 too."""
    moment = datetime.fromtimestamp((time >> LOGICAL_BITS) / 1000.0, UTC)
    count = time & ((1 << LOGICAL_BITS) - 1)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{moment.microsecond // 1000:03} UTC" + (f" ({count})" if count else "")


WIRE_VERSION = 11

MAX_BID = 10 * MAX_COORDINATE  #: Largest distance between two points of the largest arena [units].

NO_OWNER = -1
BLOCKED = -2  #: Owner of a slot that no robot can take, because a body that does not move stands there.
LAST_ROUND = 1023  #: Largest round number in a position report.
MAX_LOOKS = 64  #: Largest number of visits to a vacant slot in an entry.
MAX_EPOCHS = 32  #: Largest epoch: plans for one mission that follow on each other.
MAX_LEVEL = 15  #: Highest level of a right of way.
MAX_STOPS = 4  #: Most points of a course.
MAX_PROPOSALS = 4  #: Most proposals of others in one message.
MAX_VOTES = 16  #: Most votes in one message.

Choice: TypeAlias = Literal["leave", "close", "replan", "continue", "swap", "spare", "wait", "round"]
"""What a team can do about the empty place of a dead robot, a weak battery, a blocked way and an order in words."""

Id = Annotated[int, msgspec.Meta(ge=0, lt=MAX_ROBOTS)]
Owner = Annotated[int, msgspec.Meta(ge=BLOCKED, lt=MAX_ROBOTS)]
Bid = Annotated[float, msgspec.Meta(ge=-MAX_BID, le=MAX_BID)]
Counter = Annotated[int, msgspec.Meta(ge=0, lt=2**40)]
"""Far more than an honest robot ever counts, and far enough below the largest machine integer to be raised safely."""
Round = Annotated[int, msgspec.Meta(ge=0, le=LAST_ROUND)]
OrderTime = Annotated[int, msgspec.Meta(ge=0, lt=LATEST)]
Digest = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{16}\Z")]
TableDigest = Annotated[bytes, msgspec.Meta(min_length=8, max_length=8)]
Coordinates: TypeAlias = tuple[Coordinate, ...]

BidEntry: TypeAlias = tuple[int, float, int]
"""One slot of a bid table: (version, bid, owner), CBAA's winning bid and winning agent; owner NO_OWNER marks a free
slot."""

BidTable: TypeAlias = tuple[BidEntry, ...]

UNSAID: BidEntry = (0, 0.0, NO_OWNER)  #: The entry of lowest rank, for slots left out: merging it changes nothing.

Claims: TypeAlias = tuple[tuple[Id, Counter, Bid, Owner], ...]
"""The entries of a bid table that a message spells out: slot, version, bid and owner of each."""

PositionReport: TypeAlias = tuple[Round, Coordinates, Coordinates]
"""A robot's report for a joint assignment: round of the mission, 0 for its start; position at that time; and position
for the second collection of a large team, empty before that [units; frame of the mission]."""

TeamPositions: TypeAlias = tuple[int, tuple[int, ...], tuple[Coordinates, ...]]
"""A collection: version of the claims that follow from it, ids of the robots, and the position of each of them [units;
frame of the mission]."""


class _OnWire(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A part of a message: an array of its fields in their order."""


class MissionStamp(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True, order=True):
    """Identifies a mission by the operator's time of the order, 0 for the first one, and by its content.

    The mission with the higher stamp is in force: that of the last order.
    """

    counter: OrderTime
    digest: Digest


NO_MISSION = MissionStamp(0, "0" * 16)  #: The stamp of a message that names no mission.


Knowledge: TypeAlias = tuple[MissionStamp, str | None, bytes | None]


class Authorization(msgspec.Struct, frozen=True, kw_only=True):
    """The operator's signature on a mission's digest and on the time of the order, `counter`."""

    counter: int
    signature: bytes


class Provenance(_OnWire, frozen=True, kw_only=True):
    """The origin of a plan: fixed when it is proposed, and passed on unchanged."""

    mission: OrderTime  #: Time of the order for the mission that the plan was made for.
    mission_digest: Digest  #: Content of that mission.
    epoch: Counter  #: Counter of plans for that mission.
    degree: Id  #: Number of neighbours of the proposer, that is N times its influence (paper, eq. 1).
    proposer: Id  #: Id of the robot that proposed.
    sequence: Counter  #: Counts the proposals of that robot.

    @property
    def stamp(self) -> MissionStamp:
        """The mission that the plan was made for."""
        return MissionStamp(self.mission, self.mission_digest)


class Offer(_OnWire, frozen=True, kw_only=True):
    """An exchange of slots, offered to one neighbour.

    The sender would give slot `give`, which it owns, for slot `take`, which robot `to` owns, as long as these entries
    have these versions; `bid` is the sender's bid for `take`.
    """

    to: Id
    give: Id
    take: Id
    give_version: Counter
    take_version: Counter
    bid: Bid

    def __post_init__(self) -> None:
        force_setattr(self, "bid", self.bid + 0.0)  # a zero without a sign, which would be signed as another number


class Course(_OnWire, frozen=True, kw_only=True):
    """The way that a blocked robot wants to fly in the next rounds."""

    #: Rises with the time for which the right of way has been missing.
    level: Annotated[int, msgspec.Meta(ge=0, le=MAX_LEVEL)]
    of: Id  #: The robot whose right it is: the sender, or one that the sender makes way for.
    #: Next corners of the sender's way [units; world frame].
    path: Annotated[tuple[Coordinates, ...], msgspec.Meta(min_length=1, max_length=MAX_STOPS)]


class Proposal(_OnWire, frozen=True, kw_only=True):
    """A plan as it was proposed, passed on by robots that compare all proposals (`ConsensusRule.ballots`)."""

    provenance: Provenance
    plan: Plan


class Incident(_OnWire, frozen=True, kw_only=True):
    """What the robots' models judge: the empty place of a dead robot, a weak battery, a blocked way, or an order."""

    kind: Literal["death", "battery", "blocked", "order"]
    robot: Id  #: The robot that it has happened to; that an order names by number, or else that got it.
    #: How far that robot can still fly, or the radius of the obstacle in its way [units]; the round of an order.
    left: Annotated[float, msgspec.Meta(ge=0, le=MAX_BID)] = 0.0
    at: Coordinates = ()  #: Where it said so, or where that obstacle is [units]; else empty.
    words: str = ""  #: The order; empty for other kinds.


class Vote(_OnWire, frozen=True, kw_only=True):
    """The choice of one robot's model, passed on unchanged."""

    incident: Incident
    voter: Id
    degree: Id  #: Number of the voter's neighbours when it voted.
    choice: Choice | None  #: None if its model gave no usable answer.


class Message(_OnWire, frozen=True, kw_only=True, dict=True):
    """All public knowledge about one robot, as broadcast. On the wire, an array of the fields before `plan_class`."""

    sender: Id  #: Id of the robot.
    sequence: Counter  #: Counts the changes of the content; equal content is equal bytes.
    degree: Id  #: Number of robots within the sender's radio range; its influence is degree / N (paper, eq. 1).
    stamp: MissionStamp | None = None  #: The sender's mission; None with a provenance, which has it.
    provenance: Provenance | None = None  #: Origin of the plan that the sender follows, present with it.
    #: Number of places of that plan; that of `plan` if left out.
    places: Annotated[int, msgspec.Meta(ge=0, le=MAX_ROBOTS)] = 0
    plan_digest: Digest | None = None  #: Digest of that plan; that of `plan` if left out.
    slot: Id | None = None  #: Index of the claimed place.
    table_digest: TableDigest | None = None  #: Digest of the sender's whole bid table (auction only).
    claims: Claims | None = None  #: Entries of that table, in ascending order of slots (auction only).
    offer: Offer | None = None  #: An exchange that the sender offers (auction only).
    course: Course | None = None  #: The way that the sender asks others to leave free; None if nothing is in its way.
    beats: tuple[Counter, ...] | None = None  #: Heartbeat counters of the team, by id; None if not spelled out.
    plan: Plan | None = None  #: The plan spelled out; None before the sender has one, or if only the digest is given.
    mission_text: str | None = None  #: The mission spelled out as JSON; None if not.
    positions: dict[Id, PositionReport] | None = None  #: Position reports of the team, by id; None if not spelled out.
    #: Some of the proposals that the sender knows; None where proposals are not compared.
    proposals: Annotated[tuple[Proposal, ...], msgspec.Meta(max_length=MAX_PROPOSALS)] | None = None
    #: Some of the votes that the sender knows; None where models are not asked to judge.
    votes: Annotated[tuple[Vote, ...], msgspec.Meta(max_length=MAX_VOTES)] | None = None
    plan_class: int = 0  #: Class of the plan by the receiver's own check; never sent, 0 where nothing was checked.
    #: Signatures that came with the message (teams with keys only); never part of the message itself.
    proofs: object = None

    def __post_init__(self) -> None:
        plan = self.plan
        if self.stamp is not None and self.provenance is not None:
            force_setattr(self, "stamp", None)
        if plan is not None and self.plan_digest != plan.digest:
            force_setattr(self, "plan_digest", plan.digest)
        if plan is not None and self.places != len(plan):
            force_setattr(self, "places", len(plan))

    @cached_property
    def mission(self) -> MissionStamp:
        """The sender's mission."""
        return self.stamp or NO_MISSION if self.provenance is None else self.provenance.stamp

    @cached_property
    def knowledge(self) -> Knowledge:
        """The part that shows what the sender knows: its mission, and the digests of its plan and table."""
        return self.mission, self.plan_digest, self.table_digest

    @cached_property
    def table(self) -> BidTable | None:
        """The sender's bid table, with UNSAID for slots left out; None without claims."""
        return None if self.claims is None else _table(self.claims, self.places)

    @cached_property
    def said(self) -> tuple[int, ...] | None:
        """Slots that `table` does not leave out, if they are at most half of all; otherwise None."""
        if self.claims is None or 2 * len(self.claims) > self.places:
            return None
        return tuple(map(_SLOT, self.claims))


_SLOT, _OWNER = operator.itemgetter(0), operator.itemgetter(3)
_VERSION = bytes([WIRE_VERSION])
_WIRE_FIELDS, _PLAN_DIGEST = map(Message.__struct_fields__.index, ("plan_class", "plan_digest"))
_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(Message)


def _table(claims: Claims, places: int) -> BidTable:
    table = [UNSAID] * places
    for slot, version, bid, owner in claims:
        table[slot] = _entry(version, bid, owner)
    return tuple(table)


@lru_cache(maxsize=2**14)
def _entry(version: int, bid: float, owner: int) -> BidEntry:
    """One object for equal entries, so that large tables are compared by identity (`_agreement.auction.merged`).

    A bid of zero loses its sign: equal entries must have the same digest and signature, whichever is read first.
    """
    return version, bid + 0.0, owner


def claims_in(table: BidTable, slots: Iterable[int] | None = None) -> Claims:
    """The entries of a bid table for a message: all of them, or those of some slots.

    A bid of 0, as in joint assignments, takes one byte as an integer, and nine as a float.
    """
    chosen = range(len(table)) if slots is None else slots
    return tuple([_claim(slot, table[slot]) for slot in chosen if table[slot] != UNSAID])


@lru_cache(maxsize=2**14)
def _claim(slot: int, entry: BidEntry) -> tuple[int, int, float, int]:
    """One object for equal claims, which many robots send."""
    return slot, entry[0], entry[1] or 0, entry[2]


def table_digest(table: BidTable) -> bytes:
    """8 bytes that identify a whole bid table."""
    return hashlib.blake2b(msgspec.msgpack.encode(table), digest_size=8).digest()


def without_plan(message: Message) -> Message:
    """The message as from a robot that follows no plan."""
    return replace(
        message,
        stamp=message.mission,
        provenance=None,
        places=0,
        plan=None,
        plan_digest=None,
        slot=None,
        table_digest=None,
        claims=None,
        offer=None,
    )


def encode(message: Message) -> bytes:
    """The message as bytes, without absent fields at its end, and without the digest of a plan that it spells out."""
    fields: list[object] = [*astuple(message)[:_WIRE_FIELDS]]
    if message.plan is not None:
        fields[_PLAN_DIGEST] = None
    while fields[-1] is None:
        fields.pop()
    return _VERSION + _ENCODER.encode(fields)


def decode(payload: bytes, n_robots: int, dim: int) -> Message:
    """The message in a payload from an untrusted sender. Pure, and cheap: no program in it is drawn.

    Raises:
        MessageError: with reason `oversized`, `version`, `malformed`, `wrong_length` or `unknown_id`.
    """
    if len(payload) > max_payload_bytes(n_robots):
        raise MessageError("oversized", f"{len(payload)} bytes, at most {max_payload_bytes(n_robots)} are allowed")
    if payload[:1] != _VERSION:
        raise MessageError("version", f"version {WIRE_VERSION} is spoken here")
    try:
        message = _DECODER.decode(memoryview(payload)[1:])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", str(error)) from None
    _check_ids(message, n_robots)
    _check_lengths(message, n_robots, dim)
    return message


def _check_ids(message: Message, n_robots: int) -> None:
    origin, offer, course = message.provenance, message.offer, message.course
    named = [message.sender, *(message.positions or ()), *map(_OWNER, message.claims or ())]
    origins = [*([] if origin is None else [origin]), *(one.provenance for one in message.proposals or ())]
    named += [one.proposer for one in origins]
    named += [] if offer is None else [offer.to]
    named += [] if course is None else [course.of]
    named += [robot for vote in message.votes or () for robot in (vote.voter, vote.degree, vote.incident.robot)]
    if max(named) >= n_robots:
        raise MessageError("unknown_id", f"robot {max(named)} in a team of {n_robots}")
    if max([message.degree, *(one.degree for one in origins)]) >= n_robots:
        raise MessageError("unknown_id", f"more neighbours than a team of {n_robots} has")


def _check_lengths(message: Message, n_robots: int, dim: int) -> None:
    plan, offer, places = message.plan, message.offer, message.places
    if message.plan_class or message.proofs is not None:
        raise MessageError("malformed", "more fields than a message has")
    if message.beats is not None and len(message.beats) != n_robots:
        raise MessageError("wrong_length", f"{len(message.beats)} heartbeats of {n_robots} robots")
    reports = (message.positions or {}).values()
    if not all(len(x) == dim and len(mark) in (0, dim) for _, x, mark in reports):
        raise MessageError("wrong_length", f"a position has {dim} coordinates")
    incidents = [vote.incident for vote in message.votes or ()]
    if any(len(one.at) not in (0, dim) for one in incidents):
        raise MessageError("wrong_length", f"a robot's place has {dim} coordinates")
    if any((one.kind == "order") != (0 < len(one.words.encode()) <= MAX_ORDER_BYTES) for one in incidents):
        raise MessageError("wrong_length", f"an order has words, of at most {MAX_ORDER_BYTES} bytes")
    if message.course is not None and set(map(len, message.course.path)) != {dim}:
        raise MessageError("wrong_length", f"a course has points of {dim} coordinates")
    if (message.plan_digest is None) != (message.provenance is None):
        raise MessageError("malformed", "a plan and its provenance go together")
    if (message.claims is None) != (message.table_digest is None):
        raise MessageError("malformed", "claims and their digest go together")
    for one in [*([] if plan is None else [plan]), *(one.plan for one in message.proposals or ())]:
        check_plan_sent(one, n_robots, dim)
    if message.plan_digest is None:
        if places or message.slot is not None or message.claims is not None or offer is not None:
            raise MessageError("malformed", "claims without a plan")
        return
    if not places:
        raise MessageError("wrong_length", "a plan without places")
    slots = [*map(_SLOT, message.claims or ())]
    slots += [] if message.slot is None else [message.slot]
    slots += [] if offer is None else [offer.give, offer.take]
    if slots and max(slots) >= places:
        raise MessageError("wrong_length", f"slot {max(slots)} of a plan of {places} places")


def check_plan_sent(plan: Plan, n_robots: int, dim: int) -> None:
    """Check the form of a plan from a stranger; `MessageError` with reason `wrong_length`. Draws no program."""
    if set(map(len, plan.given if plan.drawing is None else [plan.drawing.center])) != {dim}:
        raise MessageError("wrong_length", f"a plan has points of {dim} coordinates")
    if len(plan) > max_places(n_robots, dim):
        raise MessageError("wrong_length", f"a plan of {len(plan)} places for {n_robots} robots")


def received_mission(message: Message, own: Mission) -> Mission:
    """The mission that a message spells out, with the limits and surroundings of the robot's own mission.

    A sender with other limits announces another digest, so its mission is rejected.

    Raises:
        MessageError: with reason `malformed` unless it is a JSON object of `MISSION_FIELDS`, or `other_mission`.
    """
    try:
        decoded: object = json.loads(message.mission_text or "")
    except (ValueError, RecursionError) as error:
        raise MessageError("malformed", f"the mission is not JSON ({error})") from None
    fields = cast("dict[str, Any]", decoded) if isinstance(decoded, dict) else {"": decoded}
    if not fields.keys() <= MISSION_FIELDS:
        raise MessageError("malformed", f"a mission of other fields than {', '.join(sorted(MISSION_FIELDS))}")
    try:
        mission = own.change(**{**OPTIONAL, **fields})
    except InputError as error:
        raise MessageError("other_mission", str(error)) from None
    if mission.digest != message.mission.digest:
        raise MessageError("other_mission", f"not the mission that {message.mission.digest} stands for")
    return mission
