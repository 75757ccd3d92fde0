"""The one kind of message between robots.

A message carries everything public about its sender: mission, influence, plan with its provenance, claimed slot and,
for the auction, its bid table. Long parts are named by a digest, and spelled out only where a neighbour may lack them
(`llm_flock.protocol.messages.dissemination`). Positions of neighbours are sensed; reports of positions are for
joint assignments.
"""

from __future__ import annotations

import hashlib
from typing import Annotated, TypeAlias

import msgspec
import msgspec.structs

from llm_flock.arrays import MAX_COORDINATE, Point
from llm_flock.bounds import MAX_ROBOTS
from llm_flock.protocol.plan import Plan

MAX_BID = 10 * MAX_COORDINATE
"""Largest distance between two points of the largest arena [units]."""

Id = Annotated[int, msgspec.Meta(ge=0, lt=MAX_ROBOTS)]
Bid = Annotated[float, msgspec.Meta(ge=-MAX_BID, le=MAX_BID)]
Coordinate = Annotated[float, msgspec.Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
Counter = Annotated[int, msgspec.Meta(ge=0, lt=2**40)]
"""Far more than an honest robot ever counts, and far enough below the largest machine integer to be raised safely."""

NO_OWNER = -1
BLOCKED = -2
"""Owner of a slot that no robot can take, because a body that does not move stands there."""

BidEntry: TypeAlias = tuple[int, float, int]
"""One slot of a bid table: (version, bid, owner), CBAA's winning bid and winning agent; owner NO_OWNER marks a free
slot."""

BidTable: TypeAlias = tuple[BidEntry, ...]

PositionReport: TypeAlias = tuple[int, Point, Point]
"""A robot's report for a joint assignment: round of the mission, 0 for its start; position at that time; and position
for the second collection of a large team, empty before that [units; frame of the mission]."""

TeamPositions: TypeAlias = tuple[int, tuple[int, ...], tuple[Point, ...]]
"""A collection: version of the claims that follow from it, ids of the robots, and the position of each of them [units;
frame of the mission]."""

LAST_ROUND = 1023
"""Largest round number in a position report."""

MOST_LOOKS = 64
"""Largest number of visits to a vacant slot in an entry."""

MOST_EPOCHS = 32
"""Largest epoch: plans for one mission that follow on each other."""

UNSAID: BidEntry = (0, 0.0, NO_OWNER)
"""The entry of lowest rank: merging it changes nothing, so it stands for slots that a message leaves out."""


class MissionStamp(msgspec.Struct, frozen=True, order=True):
    """Identifies a mission: operator's time of the order, 0 for the first one, then content.

    The mission with the higher stamp is in force, so that of the last order.
    """

    counter: int
    digest: str


NO_MISSION = MissionStamp(0, "0" * 16)
"""The stamp of a message that names no mission."""


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """Where a plan comes from: fixed when it is proposed, and carried along unchanged.

    Attributes:
        mission: time of the order for the mission that the plan was made for.
        mission_digest: content of that mission.
        epoch: counter of plans for that mission.
        degree: number of neighbours of the proposer, that is N times its influence (paper, eq. 1).
        proposer: id of the robot that proposed.
        sequence: counts the proposals of that robot.
    """

    mission: int
    mission_digest: str
    epoch: int
    degree: int
    proposer: int
    sequence: int


class Offer(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """An exchange of slots, offered to one neighbour; also its form on the wire, with the bounds of its fields.

    The sender would give slot `give`, which it owns, for slot `take`, which robot `to` owns, as long as these entries
    have these versions; `bid` is the sender's bid for `take`.
    """

    to: Id
    give: Id
    take: Id
    give_version: Counter
    take_version: Counter
    bid: Bid


HIGHEST = 15
"""Highest level of a right of way."""

MOST_STOPS = 4
"""Most points of a course."""


class Course(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Where a robot that others block will be in the next rounds; also its form on the wire.

    Attributes:
        level: rises with the time for which the right of way has been missing.
        of: the robot whose right it is: the sender, or one that the sender makes way for.
        path: next corners of the sender's way [units; world frame].
    """

    level: Annotated[int, msgspec.Meta(ge=0, le=HIGHEST)]
    of: Id
    path: Annotated[tuple[tuple[Coordinate, ...], ...], msgspec.Meta(min_length=1, max_length=MOST_STOPS)]


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Everything public about one robot, as broadcast.

    Attributes:
        sender: id of the robot.
        sequence: counts the changes of the content; equal content is equal bytes.
        degree: number of robots within the sender's radio range; its influence is degree / N (paper, eq. 1).
        mission: the sender's mission; that of the provenance if left out.
        mission_text: that mission spelled out as JSON; None if not.
        plan: the plan that the sender follows; None before it has one, or if only the digest is given.
        plan_digest: digest of that plan, always present with a plan; that of `plan` if left out.
        places: number of places of that plan; that of `plan` if left out.
        provenance: origin of that plan, present with it.
        slot: index of the claimed place.
        table: the sender's bid table on that plan, with UNSAID for slots left out (auction only).
        said: slots that `table` does not leave out, if there are few; otherwise None.
        table_digest: digest of the sender's whole table (auction only); that of `table` if left out.
        offer: an exchange that the sender offers (auction only).
        course: the way that the sender asks others to leave free; None if nothing is in its way.
        beats: heartbeat counters of the team, by id; None if not spelled out.
        positions: position reports of the team, by id; None if not spelled out.
        plan_class: class of the plan by the receiver's own check; never sent, 0 where nothing was checked.
        proofs: signatures that came with the message (teams with keys only); never part of the message itself.
    """

    sender: int
    sequence: int
    degree: int
    mission: MissionStamp = NO_MISSION
    mission_text: str | None = None
    plan: Plan | None = None
    plan_digest: str | None = None
    places: int = 0
    provenance: Provenance | None = None
    slot: int | None = None
    table: BidTable | None = None
    said: tuple[int, ...] | None = None
    table_digest: str | None = None
    offer: Offer | None = None
    course: Course | None = None
    beats: tuple[int, ...] | None = None
    positions: dict[int, PositionReport] | None = None
    plan_class: int = 0
    proofs: object = None

    def __post_init__(self) -> None:
        origin, plan = self.provenance, self.plan
        if origin is not None and self.mission.digest != origin.mission_digest:
            msgspec.structs.force_setattr(self, "mission", MissionStamp(origin.mission, origin.mission_digest))
        if plan is not None and self.plan_digest != plan.digest:
            msgspec.structs.force_setattr(self, "plan_digest", plan.digest)
        if plan is not None and self.places != len(plan.points):
            msgspec.structs.force_setattr(self, "places", len(plan.points))
        if self.table is not None and self.table_digest is None:
            msgspec.structs.force_setattr(self, "table_digest", table_digest(self.table))


def without_plan(message: Message) -> Message:
    """The message as from a robot that follows no plan."""
    return msgspec.structs.replace(
        message,
        plan=None,
        plan_digest=None,
        places=0,
        provenance=None,
        slot=None,
        table=None,
        said=None,
        table_digest=None,
        offer=None,
    )


def table_digest(table: BidTable) -> str:
    """16 hexadecimal digits that identify a whole bid table."""
    return hashlib.blake2b(msgspec.msgpack.encode(table), digest_size=8).hexdigest()
