"""Members with valid keys that lie together: what they have heard, and what they can sign."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

from msgspec.structs import replace
from tables import told

from llm_flock.errors import MessageError
from llm_flock.message import NO_OWNER, UNSAID, BidEntry, Message, Offer, decode, encode
from llm_flock.mission import Mission
from llm_flock.protocol._agreement.auction import rank
from llm_flock.protocol._membership.liveness import PER_BEAT
from llm_flock_swarm._signed.certificates import (
    LEFT,
    Authenticator,
    Certificate,
    Context,
    Equivocation,
    ExchangeGrant,
    Proofs,
    ReleaseGrant,
    WitnessStatement,
    acceptance_statement,
    beat_statement,
    claim_statement,
    claims_of,
    drawn_bid,
    left_by,
    offer_statement,
    origin_statement,
    unwrap,
    word_statement,
    wrap,
)

Said: TypeAlias = tuple[int, bytes, frozenset[int] | None]
"""Who says it, the payload, and who hears it; None for all."""

Entries: TypeAlias = dict[int, tuple[BidEntry, Certificate]]


class Gang:
    """Members that lie, one or more, each with its own keys."""

    def __init__(self, keys: Mapping[int, Authenticator], mission: Mission, seed: int = 0) -> None:
        self.keys = dict(keys)
        self.members = sorted(keys)
        self.mission = mission
        self.rng = random.Random(seed)
        self.known: Message | None = None
        self.origin = b""
        self.equivocations: tuple[Equivocation, ...] = ()
        self.payloads: list[bytes] = []
        self.table: dict[int, tuple[BidEntry, Certificate]] = {}
        self.grants: dict[tuple[int, int], ReleaseGrant] = {}
        self.words: dict[tuple[int, int, int], dict[int, bytes]] = {}
        self.moves: dict[int, tuple[int, BidEntry, Certificate]] = {}
        self.sequence = 0
        self.count = 0
        self.numbers: Counter[int] = Counter()
        self.hit: tuple[int, int] | None = None
        self.rounds = 0

    @property
    def honest(self) -> list[int]:
        return [j for j in range(self.mission.n_robots) if j not in self.keys]

    def hear(self, payload: bytes) -> None:
        """Take note of what an honest robot says."""
        try:
            content, proofs = unwrap(payload, self.mission.n_robots)
            message = decode(content, self.mission.n_robots, self.mission.dim)
        except MessageError:
            return
        self.payloads = [*self.payloads[-20:], payload]
        if message.plan is None or message.provenance is None or not proofs.origin:
            return
        if self.known is None or (message.plan, message.provenance) != (self.known.plan, self.known.provenance):
            self.table, self.grants, self.words, self.moves = {}, {}, {}, {}
        self.known, self.origin, self.equivocations = message, proofs.origin, proofs.equivocations
        certificates = proofs.certificates()
        for slot, entry in enumerate(message.table or ()):
            known = self.table.get(slot)
            certificate = certificates.get(slot, Certificate(number=0))
            if known is None or rank(entry) >= rank(known[0]):
                self.table[slot] = entry, certificate
            if isinstance(certificate.grant, ReleaseGrant):
                self.grants[slot, entry[0]] = certificate.grant
        for word in proofs.words:
            self.words.setdefault((word.slot, word.version, word.owner), {})[word.witness] = word.signature

    # --- parts of messages --------------------------------------------------------------------------------------------

    @property
    def about(self) -> Context:
        assert self.known is not None
        return Context(self.known.mission, self.known.plan_digest or "", self.known.provenance)

    @property
    def places(self) -> range:
        assert self.known is not None
        return range(self.known.places)

    def version(self, slot: int) -> int:
        """The version of a place, as far as the gang has heard."""
        return self.table[slot][0][0] if slot in self.table else 0

    def owned(self, member: int) -> list[int]:
        return [slot for slot, (entry, _) in self.table.items() if entry[2] == member]

    def number(self) -> int:
        self.count += 1
        return self.count

    def claim(
        self,
        member: int,
        slot: int,
        *,
        version: int | None = None,
        owner: int | None = None,
        number: int | None = None,
        bid: float | None = None,
    ) -> tuple[BidEntry, Certificate]:
        """A claim with the member's own signature, for any owner of the place, and with the best bid that may be."""
        at = self.version(slot) if version is None else version
        owner = member if owner is None else owner
        if bid is None:
            bid = drawn_bid(self.about, slot, at, owner) if at else -1e-9
        entry: BidEntry = (at, bid, owner)
        number = self.number() if number is None else number
        signature = self.keys[member].sign(claim_statement(self.about, slot, entry, number))
        return entry, Certificate(number=number, signature=signature, grant=self.grants.get((slot, at)))

    def exchange(
        self,
        maker: int,
        to: int,
        give: int,
        take: int,
        at: tuple[int, int] | None = None,
        numbers: tuple[int, int] = (0, 0),
    ) -> Entries:
        """What two have exchanged, `at` these versions; one of the gang signs for who is not a member of it."""
        versions = at or (self.version(give), self.version(take))
        bids = [
            drawn_bid(self.about, a, v + 1, j)
            for a, v, j in zip((take, give), versions[::-1], (maker, to), strict=True)
        ]
        offer = Offer(to=to, give=give, take=take, give_version=versions[0], take_version=versions[1], bid=bids[0])
        number, accepted = numbers if any(numbers) else (self.number(), self.number())
        signed = self.keys[maker].sign(offer_statement(self.about, maker, offer, number))
        grant = ExchangeGrant(maker, to, give, take, *versions, bids[0], number, signed, bids[1], accepted, b"")
        signer = self.keys.get(to, self.keys[maker])
        grant = replace(grant, accepted=signer.sign(acceptance_statement(self.about, grant)))
        return {slot: (entry, Certificate(number=n, grant=grant)) for slot, (entry, n) in grant.entries().items()}

    def word(self, member: int, slot: int, owner: int) -> WitnessStatement:
        at = self.version(slot) + 1
        return WitnessStatement(
            member, slot, at, owner, self.keys[member].sign(word_statement(self.about, slot, at, owner))
        )

    def release(self, slot: int, owner: int) -> ReleaseGrant | None:
        """The gang's own words that a place is free or blocked, if there are enough members."""
        if len(self.members) < 2:
            return None
        at = self.version(slot) + 1
        words = (
            (member, self.keys[member].sign(word_statement(self.about, slot, at, owner))) for member in self.members
        )
        return ReleaseGrant(tuple(words))

    def freed(self, slot: int) -> ReleaseGrant | None:
        """The words that free a place, one of them an honest robot's; None where none has said so."""
        at = self.version(slot) + 1
        for stated in (NO_OWNER, *map(left_by, self.members)):  # words that blame no robot first
            honest = {j: word for j, word in self.words.get((slot, at, stated), {}).items() if j not in self.keys}
            if honest:
                statement = word_statement(self.about, slot, at, stated)
                words = dict(itertools.islice(honest.items(), 1))
                words.update({j: self.keys[j].sign(statement) for j in self.members})
                return ReleaseGrant(tuple(sorted(words.items())), NO_OWNER if stated == NO_OWNER else LEFT - stated)
        return None

    def _beats(self, member: int) -> tuple[int, ...]:
        """A heartbeat of its own, and nothing about others'."""
        return tuple(PER_BEAT * self.sequence if j == member else 0 for j in range(self.mission.n_robots))

    def message(
        self, member: int, entries: Entries | None = None, hears: Sequence[int] | None = None, **more: Any
    ) -> Said:
        """A message on the plan of the honest, signed as it has to be."""
        assert self.known is not None
        words, offer_number = more.pop("words", ()), more.pop("offer_number", 0)
        table = [UNSAID] * self.known.places
        for slot, (entry, _) in (entries or {}).items():
            table[slot] = entry
        self.sequence += 1
        # Who claims lets its heart beat, or its claims would count for nothing; who seems dead costs more time.
        claims = "offer" in more or any(entry[2] == member for entry, _ in (entries or {}).values())
        same = {"plan": self.known.plan, "provenance": self.known.provenance}
        said = Message(
            **{
                "sender": member,
                "sequence": self.sequence,
                "degree": self.mission.n_robots - 1,
                **({"beats": self._beats(member)} if claims else {}),
                **same,
                **told(more.pop("table", tuple(table))),
                **more,
            }
        )
        shown, grants = claims_of({slot: certificate for slot, (_, certificate) in (entries or {}).items()})
        origin, offer, signed = self.origin, None, self.keys[member]
        if said.provenance is not None and said.provenance.proposer == member and said.plan_digest is not None:
            origin = signed.sign(origin_statement(said.provenance, said.plan_digest))
        if said.offer is not None:
            offer = offer_number, signed.sign(offer_statement(self.about, member, said.offer, offer_number))
        beats = None
        if said.beats is not None:
            own = signed.sign(beat_statement(member, said.beats[member]))
            forged = b"x" * 64 if "beats" in more else b""
            beats = tuple(own if j == member else forged for j in range(self.mission.n_robots))
        proofs = Proofs(
            claims=shown,
            grants=grants,
            words=words,
            offer=offer,
            origin=origin,
            beats=beats,
            equivocations=self.equivocations,
        )
        return member, wrap(encode(said), proofs), None if hears is None else frozenset(hears)
