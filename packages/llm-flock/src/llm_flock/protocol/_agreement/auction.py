"""Consensus-based auction over the slots of the agreed plan, with exchanges between neighbours.

The auction is CBAA: Choi, Brunet, How: Consensus-based decentralized auctions for robust task allocation (IEEE T-RO
2009). Exchanges follow D-CAPT: Turpin, Michael, Kumar: CAPT: Concurrent assignment and planning of trajectories for
multiple robots (IJRR 2014), with path lengths instead of distances. Tables hold CBAA's winning bids and agents.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import compress

from msgspec.structs import replace

from llm_flock.arrays import Point
from llm_flock.message import BLOCKED, NO_OWNER, UNSAID, BidEntry, BidTable, Offer
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import AssignmentInput, Claim
from llm_flock.protocol._membership.joint import flown_straight, optimal_assignment
from llm_flock.protocol._membership.occupancy import Occupancy
from llm_flock.protocol._path_length import path_lengths, ways, ways_to
from llm_flock.roadmap import Roadmap

BID_DECIMALS = 9

SWAP_GAIN = 0.01  # an exchange must lower the sum of squared path lengths by this share of the squared spacing
BOUND_ROUNDS = 4  # communication rounds for which an offer binds its maker; an answer takes two where nothing is lost
LAST_EXCHANGED = 2**34  # from this version on no slot is exchanged: two that lie could else raise it above every number


def rank(entry: BidEntry) -> tuple[int, bool, float, int]:
    """Order of claims on one slot: higher version, then owned before free, then higher bid, then lower owner."""
    version, bid, owner = entry
    return (version, owner != NO_OWNER, bid, -owner)


def merge(mine: BidTable, theirs: BidTable, said: Sequence[int] | None = None) -> BidTable:
    """For each slot, or those of `said`, the claim of higher rank. Associative, commutative and idempotent."""
    return merged(mine, [(theirs, said)])[0]


def merged(mine: BidTable, others: Iterable[tuple[BidTable, Sequence[int] | None]]) -> tuple[BidTable, set[int]]:
    """`merge` with several tables, each with its slots to compare. Also returns the slots that changed."""
    entries, touched = list(mine), set[int]()
    for theirs, said in others:
        if said is None:
            said = compress(range(len(entries)), map(operator.is_not, entries, theirs))
        for a in said:
            their, my = theirs[a], entries[a]
            if their is my or their is UNSAID or their[0] < my[0]:
                continue
            if their[0] > my[0] or ((their[1] >= my[1] or my[2] == NO_OWNER) and rank(their) > rank(my)):
                entries[a] = their
                touched.add(a)
    return (tuple(entries) if touched else mine), touched


def changed(table: BidTable, new: Mapping[int, BidEntry]) -> BidTable:
    """The table with some entries replaced; the same object if there are none."""
    if not new:
        return table
    entries = list(table)
    for a, entry in new.items():
        entries[a] = entry
    return tuple(entries)


@dataclass(frozen=True, slots=True)
class AuctionAssignment:
    """CBAA with exchanges.

    A robot's bid for a slot is minus its distance to it, fixed when it adopts the plan: bids from moving positions
    could overtake each other without end. Tables are merged slot by slot. A robot that is outbid claims the best slot
    that it can win. With fixed bids the highest bid of all wins for good, then the highest of the rest, and so on: on a
    connected graph the team ends on distinct slots. The index named by the model is not used: it knows no other robot's
    distance.

    Two neighbours exchange slots when that lowers the sum of their squared path lengths, even if one then flies
    farther. Paths lead along the formation (`llm_flock.protocol._path_length`): instead of one robot crossing
    it, a row of robots each moves up by one place. A robot that has accepted an offer may make the next one in the same
    communication round. An offer binds its maker until it is answered, refused or expired: meanwhile the maker neither
    claims nor exchanges. Acceptance is written into the table, both versions raised, and travels by merging; an entry
    with a raised version cannot be outbid by a robot that has not heard of it. A robot that finds itself on several
    slots, after a late acceptance for instance, keeps one by a fixed order and releases the rest.

    Positions of robots in touch, where they are known, are assigned together (`joint`), and replace bids. Without
    `team`, robots count no heartbeats, report no positions, and look for nobody.
    """

    name: str = "auction"
    swaps: bool = True
    joint: bool = True
    team: bool = True
    straight: bool = False  #: Whether exchanges weigh straight distances, not ways along the formation.

    def take(self, now: AssignmentInput) -> Claim:
        """Fix the bids for this plan and claim the best slot that can be won."""
        distances = ways(now.position, now.plan.array, now.roadmap)
        bids = tuple((0.0 - distances.round(BID_DECIMALS)).tolist())  # never -0.0, which is signed as another number
        empty: BidTable = (UNSAID,) * len(now.plan)
        return self.update(Claim(slot=None, table=empty, bids=bids), now)

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """Merge the tables heard. Then keep the slot, exchange it, or claim another one if it was lost."""
        table, bids = claim.table, claim.bids
        assert table is not None and bids is not None, "an auction claim carries a table and bids"
        table, touched = merged(table, [(m.table, m.said) for m in now.heard if m.table is not None])
        if now.positions is not None and self.joint:
            table, more = merged(
                table, [(optimal_assignment(now.plan, now.positions, now.roadmap, now.preferences), None)]
            )
            touched |= more
        if now.granted is None:
            table = with_occupancy(reclaim(now.robot, claim, table), now.occupancy)
        else:
            table = merge(table, now.granted)
        offer, bound = claim.offer, claim.bound - 1
        if offer is not None and (bound <= 0 or _is_answered(offer, now.robot, table)):
            offer = None
        if table is claim.table and claim.slot is not None:
            slot = claim.slot
        else:
            among = touched if claim.slot is None else touched | {claim.slot}
            table, slot = _keep_one(now, table, among)
            if slot is None and offer is None and not now.retired:
                table, slot = _claim_best(now, bids, table, before=claim.slot)
        claim = Claim(slot=slot, table=table, bids=bids, offer=offer, bound=max(bound, 0) if offer else 0)
        if slot is None or not (self.swaps and now.exchanges):
            return claim
        now = replace(now, straight=True) if self.straight else now
        claim = _accept(claim, now) or claim
        return claim if claim.offer is not None else _make_offer(claim, now)


def reclaim(robot: int, claim: Claim, table: BidTable) -> BidTable:
    """Take back a slot that others released while they heard nothing of this robot."""
    slot = claim.slot
    if slot is None or claim.bids is None or table[slot][2] != NO_OWNER:
        return table
    if any(owner == robot for _, _, owner in table):
        return table  # a joint assignment has given it another one
    return changed(table, {slot: (table[slot][0] + 1, claim.bids[slot], robot)})


def with_occupancy(table: BidTable, occupancy: Occupancy | None) -> BidTable:
    """The table with the slots of silent robots free and those under still bodies blocked."""
    if occupancy is None or not (occupancy.silent or occupancy.blocked or occupancy.clear):
        return table
    new: dict[int, BidEntry] = {}
    for a, (version, _, owner) in enumerate(table):
        if a in occupancy.blocked:
            if owner != BLOCKED:
                new[a] = (version + 1, 0.0, BLOCKED)
        elif owner in occupancy.silent or (owner == BLOCKED and a in occupancy.clear):
            new[a] = (version + 1, 0.0, NO_OWNER)
    return changed(table, new)


def _is_answered(offer: Offer, robot: int, table: BidTable) -> bool:
    """Whether an offer was accepted or has lapsed: the table has another version or owner of either slot."""
    mine, theirs = table[offer.give], table[offer.take]
    return mine[0] != offer.give_version or mine[2] != robot or theirs[0] != offer.take_version or theirs[2] != offer.to


def _keep_one(now: AssignmentInput, table: BidTable, among: Iterable[int]) -> tuple[BidTable, int | None]:
    """Of the robot's slots in `among`, keep the one of highest version, then bid; with keys, of highest precedence."""
    robot, precedence = now.robot, now.precedence
    if precedence is not None:
        every = [a for a, entry in enumerate(table) if entry[2] == robot]
        return table, max(every, key=lambda a: precedence(a, table[a]), default=None)
    owned = [a for a in among if table[a][2] == robot]
    keep = max(owned, key=lambda a: (table[a][0], table[a][1], -a), default=None)
    return changed(table, {a: (table[a][0] + 1, 0.0, NO_OWNER) for a in owned if a != keep}), keep


def _claim_best(
    now: AssignmentInput, bids: tuple[float, ...], table: BidTable, before: int | None
) -> tuple[BidTable, int | None]:
    """Claim the best slot that can be won, or none; first of all the slot held `before`, if it is free.

    Where witnesses have freed its slot, it stays there, instead of taking another that its owner may return to. If
    bids are drawn by lot and no other slot is left, it outbids the owner of a freed slot: the first to claim it has no
    right to it, because liars could then keep slots from all others.
    """
    robot, draw, freed = now.robot, now.draw, now.freed
    if before is not None and table[before][2] == NO_OWNER:
        version = table[before][0]
        return changed(table, {before: (version, _bid(now, bids, before, version), robot)}), before
    for a in _by_falling_bid(bids):
        version, bid, owner = table[a]
        # The order of `rank`, spelled out for speed: this runs for many slots.
        if owner == NO_OWNER or (version == 0 and owner != BLOCKED and (bids[a], -robot) > (bid, -owner)):
            return changed(table, {a: (version, _bid(now, bids, a, version), robot)}), a
    if draw is None or freed is None:
        return table, None
    for a in _by_falling_bid(bids):
        version, _, owner = table[a]
        if version > 0 and owner >= 0 and freed(a, version):
            mine = version, draw(a, version), robot
            if rank(mine) > rank(table[a]):
                return changed(table, {a: mine}), a
    return table, None


def _bid(now: AssignmentInput, bids: tuple[float, ...], slot: int, version: int) -> float:
    return bids[slot] if now.draw is None or version == 0 else now.draw(slot, version)


@lru_cache(maxsize=256)
def _by_falling_bid(bids: tuple[float, ...]) -> tuple[int, ...]:
    """Slots by falling bid, those of equal bids by index."""
    return tuple(sorted(range(len(bids)), key=bids.__getitem__, reverse=True))


def gain(
    now: AssignmentInput, there: Point, mine: int, theirs: int, *, straight: bool = False, peer: int = -1
) -> float:
    """Gain of an exchange with a peer at `there`: the fall in the weighted sum of squared ways [units^2]."""
    own, other = now.weights.get(now.robot, 1.0), now.weights.get(peer, 1.0)
    spacing = None if straight else now.spacing
    keep, take = _squared_ways(now.position, now.plan, mine, theirs, spacing, now.roadmap)
    their_keep, their_take = _squared_ways(there, now.plan, theirs, mine, spacing, now.roadmap)
    return own * keep + other * their_keep - own * take - other * their_take


@lru_cache(maxsize=2**16)
def _squared_ways(
    here: Point, plan: Plan, keep: int, take: int, spacing: float | None, roadmap: Roadmap | None
) -> tuple[float, float]:
    """Squared ways to two slots [units^2], straight without a `spacing`; robots ask again in a communication round."""
    if spacing is None:
        kept, taken = ways_to(here, plan, (keep, take), roadmap)
    else:
        kept, taken = path_lengths(here, plan, (keep, take), spacing, roadmap)
    return kept**2, taken**2


def _worth(claim: Claim, now: AssignmentInput, peer: int, slot: int) -> float:
    """The gain of an exchange with a peer on `slot`; minus infinity if the peer is not sensed."""
    there = now.sensed.get(peer)
    if there is None or claim.slot is None:
        return -math.inf
    straight = now.straight or flown_straight(claim.table, claim.slot)
    return gain(now, there, claim.slot, slot, straight=straight, peer=peer)


def _accept(claim: Claim, now: AssignmentInput) -> Claim | None:
    """Accept the best offer heard, if one is good enough and no offer of its own binds this robot."""
    table = claim.table or ()
    good: list[tuple[float, int, Offer]] = []
    for message in now.heard:
        offer = message.offer
        if offer is None or offer.to != now.robot or offer.take != claim.slot:
            continue
        # If two robots offer each other the same exchange, the offer of the lower id stands.
        crossing = claim.offer is not None and claim.offer.to == message.sender and message.sender < now.robot
        if claim.offer is not None and not crossing:
            continue
        if table[offer.give][::2] != (offer.give_version, message.sender) or table[offer.take][0] != offer.take_version:
            continue
        if max(offer.give_version, offer.take_version) >= LAST_EXCHANGED:
            continue
        worth = _worth(claim, now, message.sender, offer.give)
        if worth >= SWAP_GAIN * now.spacing**2:
            good.append((worth, -message.sender, offer))
    if not good:
        return None
    _, minus_sender, offer = max(good, key=lambda item: item[:2])
    assert claim.bids is not None
    bid = _bid(now, claim.bids, offer.give, offer.give_version + 1)
    exchanged: dict[int, BidEntry] = {
        offer.give: (offer.give_version + 1, bid, now.robot),
        offer.take: (offer.take_version + 1, offer.bid, -minus_sender),
    }
    return Claim(slot=offer.give, table=changed(table, exchanged), bids=claim.bids)


def _make_offer(claim: Claim, now: AssignmentInput) -> Claim:
    """Offer the best exchange to a neighbour without an offer, if one is good enough."""
    table, slot = claim.table or (), claim.slot
    assert slot is not None and claim.bids is not None
    good: list[tuple[float, int, int]] = []
    for message in now.heard:
        theirs = message.slot
        if theirs is None or theirs == slot or message.offer is not None or table[theirs][2] != message.sender:
            continue
        if max(table[theirs][0], table[slot][0]) >= LAST_EXCHANGED:
            continue
        worth = _worth(claim, now, message.sender, theirs)
        if worth >= SWAP_GAIN * now.spacing**2:
            good.append((worth, -message.sender, theirs))
    if not good:
        return claim
    _, minus_sender, take = max(good)
    offer = Offer(
        to=-minus_sender,
        give=slot,
        take=take,
        give_version=table[slot][0],
        take_version=table[take][0],
        bid=_bid(now, claim.bids, take, table[take][0] + 1),
    )
    return replace(claim, offer=offer, bound=BOUND_ROUNDS)
