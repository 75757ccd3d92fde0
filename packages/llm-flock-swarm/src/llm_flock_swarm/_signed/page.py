"""The statements that one robot has signed and heard about the slots of one plan."""

from __future__ import annotations

from llm_flock.message import BidEntry, MissionStamp, Offer
from llm_flock_swarm._signed.certificates import Certificate, Context, LastClaim, ReleaseGrant
from llm_flock_swarm._signed.departures import Departures
from llm_flock_swarm._signed.words import Words

NOTHING = Context(MissionStamp(-1, ""), "")  # what evidence is about before there is a plan


class Page:
    """Evidence about one plan. `Evidence` reads and writes it."""

    def __init__(self, context: Context, words: Words, departures: Departures) -> None:
        self.context, self.words, self.departures = context, words, departures
        self.number = 0  # of the last claim or offer that this robot has signed
        self.held: dict[tuple[int, BidEntry], Certificate] = {}  # of the entries in the own table
        self.freed: dict[tuple[int, int, int], ReleaseGrant] = {}  # by slot, version and new owner, or BLOCKED
        self.last: dict[int, tuple[int, int]] = {}  # number and slot of each robot's last claim
        self.last_claims: dict[int, LastClaim] = {}
        self.behind: set[int] = set()  # robots that claim as if they did not know their own last claim
        self.offers: dict[Offer, tuple[int, bytes]] = {}  # the own offer, with its number and signature
        self.heard_offers: dict[int, tuple[Offer, int, bytes]] = {}  # in a communication round, by maker
        self.silent = frozenset[int]()  # robots whose hearts do not beat
