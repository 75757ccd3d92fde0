"""What one robot has signed and heard about the slots of one plan."""

from __future__ import annotations

from dataclasses import dataclass, field

from llm_flock.message import BidEntry, MissionStamp, Offer
from llm_flock_swarm._signed.certificates import Certificate, Context, LastClaim, ReleaseGrant
from llm_flock_swarm._signed.departures import Departures
from llm_flock_swarm._signed.words import Words

NOTHING = Context(MissionStamp(-1, ""), "")  # what evidence is about before there is a plan


@dataclass(slots=True)
class Page:
    """Evidence about one plan. `Evidence` reads and writes it.

    Attributes:
        context: the plan, its mission and its origin.
        words: statements of witnesses.
        departures: who left which slots.
        number: of the last claim or offer that this robot has signed.
        held: certificates of the entries in the own table.
        freed: words that freed or blocked a version of a slot, by slot, version and new owner.
        last: number and slot of each robot's last claim.
        last_claims: these claims.
        behind: robots that claim as if they did not know their own last claim.
        offers: this robot's offer, with its number and signature.
        heard_offers: offers to this robot in a communication round, by maker.
        silent: robots whose hearts do not beat.
    """

    context: Context
    words: Words
    departures: Departures
    number: int = 0
    held: dict[tuple[int, BidEntry], Certificate] = field(default_factory=dict[tuple[int, BidEntry], Certificate])
    freed: dict[tuple[int, int, int], ReleaseGrant] = field(default_factory=dict[tuple[int, int, int], ReleaseGrant])
    last: dict[int, tuple[int, int]] = field(default_factory=dict[int, tuple[int, int]])
    last_claims: dict[int, LastClaim] = field(default_factory=dict[int, LastClaim])
    behind: set[int] = field(default_factory=set[int])
    offers: dict[Offer, tuple[int, bytes]] = field(default_factory=dict[Offer, tuple[int, bytes]])
    heard_offers: dict[int, tuple[Offer, int, bytes]] = field(default_factory=dict[int, tuple[Offer, int, bytes]])
    silent: frozenset[int] = frozenset()
