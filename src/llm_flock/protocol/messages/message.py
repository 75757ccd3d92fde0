"""What robots say to each other: one kind of message.

A message carries the sender's whole public standing: its mission, its influence, its plan with that plan's provenance,
the slot it claims and, for the auction, its claims on all slots. What is long is named by a digest, and said in full
only where a neighbour may lack it (`llm_flock.protocol.messages.dissemination`). Positions are not in it: they are
sensed.
"""

from __future__ import annotations

import hashlib
from typing import TypeAlias

import msgspec
import msgspec.structs

from llm_flock.arrays import MAX_COORDINATE, Point
from llm_flock.protocol.plan import Plan

MAX_BID = 10 * MAX_COORDINATE
"""No two points of the largest arena are farther apart [units]."""

NO_OWNER = -1
BLOCKED = -2
"""Stands for the owner of a slot that nobody can take, because a body that does not move is on it."""

BidEntry: TypeAlias = tuple[int, float, int]
"""One slot of an auction table: (version, bid, owner); owner is NO_OWNER for a free slot."""

BidTable: TypeAlias = tuple[BidEntry, ...]

PositionReport: TypeAlias = tuple[int, Point, Point]
"""What a robot says of itself in a roll call: the round of the mission, 0 for when the mission came; where it is then;
and where it is for the second call, empty before that [units; frame of the mission]."""

TeamPositions: TypeAlias = tuple[int, tuple[Point, ...]]
"""A complete call: the version of its claims, and where each robot is, by id [units; frame of the mission]."""

LAST_ROUND = 1023
"""Rounds of sightings are counted up to here."""

UNSAID: BidEntry = (0, 0.0, NO_OWNER)
"""The lowest entry: merging it changes nothing, so it stands for the slots that a message leaves out."""


class MissionStamp(msgspec.Struct, frozen=True, order=True):
    """Which mission: the counter of its changes, then its content; of two missions the higher stamp is in force."""

    counter: int
    digest: str


NO_MISSION = MissionStamp(0, "0" * 16)
"""The stamp of a message that names no mission."""


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
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


class Offer(msgspec.Struct, frozen=True, kw_only=True):
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


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """One robot's standing, as broadcast.

    Attributes:
        sender: id of the robot.
        sequence: counts the changes of what the sender says; equal content is equal bytes.
        neighbors: robots within the sender's radio range; its influence is neighbors / N (paper, eq. 1).
        mission: which mission the sender pursues; that of the provenance if left out.
        mission_text: that mission in full, as JSON of what may change; None where it is not said.
        plan: the plan it follows, None before it has one or where only its digest is said.
        plan_digest: digest of that plan, always said; that of `plan` if left out.
        places: how many places that plan has; as many as `plan` has if left out.
        provenance: origin of that plan, present with it.
        slot: index of the place it claims in the plan.
        table: what it says of everybody's claims on that plan, UNSAID for the slots left out (auction only).
        said: the slots that `table` does not leave out, where they are few; None where it has to be looked through.
        table_digest: digest of its whole table (auction only); that of `table` if left out.
        offer: an exchange of places that it offers (auction only).
        beats: how often it has heard each robot's heart beat, by id; None where that is not said.
        roll: what robots have said in the roll call, by id; None where that is not said.
        plan_class: how good the receiver itself found the plan; never sent, 0 where nothing was checked.
        proofs: signatures that the message came with (teams with keys only); never part of the message itself.
    """

    sender: int
    sequence: int
    neighbors: int
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


def table_digest(table: BidTable) -> str:
    """16 hexadecimal digits that stand for all claims on a plan."""
    return hashlib.blake2b(msgspec.msgpack.encode(table), digest_size=8).hexdigest()
