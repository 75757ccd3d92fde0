"""Which place of the plan is mine: rules that look at one's own claim and at what was just heard on the same plan."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Protocol

from llm_flock.arrays import Point
from llm_flock.protocol.messages import NO_OWNER, Entry, Message, Table
from llm_flock.protocol.plan import Plan

BID_DECIMALS = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A robot's place in its present plan.

    Attributes:
        slot: index of the place, None while the robot has none.
        table: everybody's claims as far as known (auction only).
        bids: this robot's bid for every slot, fixed when the plan was adopted (auction only).
    """

    slot: int | None
    table: Table | None = None
    bids: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """What a robot knows when it begins to follow a plan.

    Attributes:
        robot: own id.
        position: own believed position [units; world frame].
        plan: the plan that is now followed.
        chosen: the index that its own model named for itself, None where the model gave no plan.
        adopted: whether the plan is another robot's.
        heard: this tick's messages of robots on the same plan.
    """

    robot: int
    position: Point
    plan: Plan
    chosen: int | None
    adopted: bool
    heard: Sequence[Message]


class AssignmentRule(Protocol):
    """Chooses a robot's own slot.

    A rule is a pure function of its arguments. `heard` holds the newest message of each sender that follows the same
    plan, in ascending order of ids. `llm_flock.testing.check_assignment_rule` tests a new rule.
    """

    @property
    def name(self) -> str:
        """The word for the command line and records."""
        ...

    def take(self, start: Start) -> Claim:
        """First claim on a plan that was just proposed or adopted."""
        ...

    def update(self, robot: int, position: Point, plan: Plan, claim: Claim, heard: Sequence[Message]) -> Claim:
        """The claim after a tick's messages on the same plan."""
        ...


def nearest(position: Point, plan: Plan, taken: frozenset[int] = frozenset()) -> int:
    """Index of the plan's point closest to `position` that is not in `taken`; lowest index among equals.

    With every point taken, the closest of all.
    """
    free = [a for a in range(len(plan)) if a not in taken] or range(len(plan))
    return min(free, key=lambda a: (math.dist(position, plan.points[a]), a))


def _own_choice(start: Start) -> int:
    """The model's own index; the robot's id where the model named none."""
    return start.robot if start.chosen is None else start.chosen


@dataclass(frozen=True, slots=True)
class IndexAssignment:
    """The model's own choice (paper, line 119), kept whatever others claim; the baseline's rule."""

    name: str = "index"

    def take(self, start: Start) -> Claim:
        """The index that this robot's model named with its own plan, also in a plan adopted from another."""
        return Claim(slot=_own_choice(start))

    def update(self, robot: int, position: Point, plan: Plan, claim: Claim, heard: Sequence[Message]) -> Claim:
        """Unchanged."""
        return claim


@dataclass(frozen=True, slots=True)
class NearestAssignment:
    """The paper's rule, literally (lines 136-139 and 155-157).

    On adoption the set of available goals is reset to the whole plan, the nearest is taken, and the set is never
    looked at again: nobody hears of it, so two robots may take the same goal. A robot's own plan keeps the index
    that its model named.
    """

    name: str = "nearest"

    def take(self, start: Start) -> Claim:
        """The model's index on its own plan; the nearest of all points on an adopted one."""
        return Claim(slot=_own_choice(start) if not start.adopted else nearest(start.position, start.plan))

    def update(self, robot: int, position: Point, plan: Plan, claim: Claim, heard: Sequence[Message]) -> Claim:
        """Unchanged: equal plans never trigger a new assignment."""
        return claim


@dataclass(frozen=True, slots=True)
class NearestFreeAssignment:
    """The paper's evident intention: claims are broadcast, and a goal claimed by a neighbour on the same plan is taken.

    Two robots may still claim one goal in the same tick, or meet later; then the higher id yields to the lower and
    takes the nearest goal that no neighbour claims. A robot knows its neighbours' claims only, so distinct goals in
    the whole team are not assured.
    """

    name: str = "nearest-free"

    def take(self, start: Start) -> Claim:
        """The model's index on its own plan; the nearest unclaimed point on an adopted one."""
        if not start.adopted:
            return Claim(slot=_own_choice(start))
        taken = frozenset(m.slot for m in start.heard if m.slot is not None)
        return Claim(slot=nearest(start.position, start.plan, taken))

    def update(self, robot: int, position: Point, plan: Plan, claim: Claim, heard: Sequence[Message]) -> Claim:
        """Yield to a neighbour of lower id on the same goal."""
        if not any(m.slot == claim.slot and m.sender < robot for m in heard):
            return claim
        taken = frozenset(m.slot for m in heard if m.slot is not None)
        return Claim(slot=nearest(position, plan, taken))


def rank(entry: Entry) -> tuple[int, bool, float, int]:
    """Order of claims on one slot: higher version, then owned before free, then higher bid, then lower owner."""
    version, bid, owner = entry
    return (version, owner != NO_OWNER, bid, -owner)


def merge(mine: Table, theirs: Table) -> Table:
    """Slot by slot the claim of higher rank; associative, commutative and idempotent."""
    if mine == theirs:
        return mine
    # Tables are long and differ in few slots: those are found without a step of the interpreter for each slot.
    differ = compress(range(len(mine)), map(operator.ne, mine, theirs))
    higher = {a: theirs[a] for a in differ if rank(theirs[a]) > rank(mine[a])}
    if not higher:
        return mine
    merged = list(mine)
    for a, entry in higher.items():
        merged[a] = entry
    return tuple(merged)


@dataclass(frozen=True, slots=True)
class AuctionAssignment:
    """Consensus-based auction (CBAA: Choi, Brunet, How 2009) over the slots of the agreed plan.

    A robot's bid for a slot is minus its distance to it, fixed when it adopts the plan: bids from moving positions
    could leapfrog for ever. Tables are merged slot by slot; a robot that is outbid claims the best slot it can still
    win. With fixed bids the highest bid of all wins for good, then the highest of the rest, and so on: on a connected
    graph the team ends on distinct slots. The index named by the model is not used: it knows nobody's distance.
    """

    name: str = "auction"

    def take(self, start: Start) -> Claim:
        """Fix the bids for this plan and claim the best slot that can be won."""
        bids = tuple(round(-math.dist(start.position, point), BID_DECIMALS) for point in start.plan.points)
        empty: Table = ((0, 0.0, NO_OWNER),) * len(start.plan)
        claim = Claim(slot=None, table=empty, bids=bids)
        return self.update(start.robot, start.position, start.plan, claim, start.heard)

    def update(self, robot: int, position: Point, plan: Plan, claim: Claim, heard: Sequence[Message]) -> Claim:
        """Merge the tables heard; keep the slot, or claim another one if it was lost."""
        table, bids = claim.table, claim.bids
        assert table is not None and bids is not None, "an auction claim carries a table and bids"
        before = table
        for message in heard:
            if message.table is not None:
                table = merge(table, message.table)
        if table is before and claim.slot is not None:
            return claim
        table, slot = _settle(robot, bids, table)
        return Claim(slot=slot, table=table, bids=bids)


def _settle(robot: int, bids: tuple[float, ...], table: Table) -> tuple[Table, int | None]:
    """Own exactly one slot: keep the best of those owned and release the rest, or claim the best winnable one."""
    owned = [a for a, entry in enumerate(table) if entry[2] == robot]
    if owned:
        keep = max(owned, key=lambda a: (table[a][0], table[a][1], -a))
        if len(owned) == 1:
            return table, keep
        released = {a: (table[a][0] + 1, 0.0, NO_OWNER) for a in owned if a != keep}
        return tuple(released.get(a, entry) for a, entry in enumerate(table)), keep
    offers = ((a, (table[a][0], bids[a], robot)) for a in range(len(table)))
    winnable = [(bids[a], -a, offer) for a, offer in offers if rank(offer) > rank(table[a])]
    if not winnable:
        return table, None
    _, minus_slot, offer = max(winnable)
    slot = -minus_slot
    return table[:slot] + (offer,) + table[slot + 1 :], slot
