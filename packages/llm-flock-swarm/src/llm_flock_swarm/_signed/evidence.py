"""Evidence of one robot: which claims of others it accepts, what it signs, and the certificates that it can show.

A lying robot holds at most one slot and changes no other's. `certificates` and the page on security state the rules.
"""

from __future__ import annotations

from collections import Counter

import msgspec.structs

from llm_flock.message import BLOCKED, NO_OWNER, UNSAID, BidEntry, BidTable, Message, Offer, claims_in
from llm_flock.protocol import Claim, Occupancy, changed, rank
from llm_flock_swarm._signed.certificates import (
    LEFT,
    LIARS,
    Authenticator,
    Certificate,
    Context,
    ExchangeGrant,
    Grant,
    LastClaim,
    Proofs,
    ReleaseGrant,
    RestlessWord,
    WitnessStatement,
    acceptance_statement,
    claim_statement,
    claims_of,
    drawn_bid,
    left_by,
    most_claims,
    most_exchanges,
    offer_statement,
    plausible,
    restless_statement,
    witnesses,
    word_statement,
)
from llm_flock_swarm._signed.checks import SPARE, Checks, Uncertified
from llm_flock_swarm._signed.departures import Departures
from llm_flock_swarm._signed.page import NOTHING, Page
from llm_flock_swarm._signed.words import Words, in_turn


class Evidence:
    """Signatures about the slots of the plan in force and of earlier ones; `liars` robots may lie together."""

    def __init__(self, robot: int, authenticator: Authenticator, liars: int = LIARS) -> None:
        self.rejected: Counter[str] = Counter()
        self._checks = Checks(authenticator, liars)
        self._turn = 0
        self._robot = robot
        self._authenticator = authenticator
        self._pages: dict[int, Page] = {}
        self._page = self._blank(NOTHING)

    def _blank(self, context: Context) -> Page:
        departures = Departures(self._checks.witnesses, exchanges=self._checks.exchanges)
        return Page(context, Words(self._robot, self._checks.witnesses), departures)

    @property
    def liars(self) -> int:
        return self._checks.witnesses - 1

    @property
    def _context(self) -> Context:
        return self._page.context

    def turn_to(self, context: Context) -> bool:
        """Turn to what is known about a plan of this mission and origin; whether that is nothing.

        Of each proposer the last plan is remembered: robots come back to it where a later one turns out to be void.
        """
        before = self._context
        if context == before:
            return False
        pages = {**self._pages, before.proposer: self._page} if context.mission == before.mission else {}
        self._pages, known = pages, pages.get(context.proposer)
        self._page = known if known is not None and known.context == context else self._blank(context)
        return self._page is not known

    def signed_by(self, member: int, statement: bytes, signature: bytes) -> bool:
        return self._checks.signed_by(member, statement, signature)

    def admit(self, message: Message, proofs: Proofs, table: BidTable) -> Message:
        """The message without entries that lack a certificate; entries that change nothing are left out unchecked.

        `table` has the entries held now, of the same plan. A message is read up to its first statement
        without a valid signature, so a forged message costs the time of one check.
        """
        certificates, entries = proofs.certificates(), [UNSAID] * len(message.table or ())
        offer = None
        try:
            # The latest claims first: of all that one message gives to a robot, only its last is taken.
            for slot in sorted(range(len(entries)), key=lambda a: -certificates[a].number if a in certificates else 0):
                entry = (message.table or ())[slot]
                if entry is UNSAID:
                    continue
                if entry == table[slot]:
                    self._renew(slot, table, certificates.get(slot))
                if rank(entry) > rank(table[slot]):
                    entries[slot] = self._fit(message, slot, certificates.get(slot), table)
            for word in proofs.words:
                self._hear_word(word, table)
            for restless in proofs.restless:
                self._hear_restless(restless)
            for cause in proofs.causes:
                self._hear_cause(cause, table)
            offer = self._hear_offer(message, proofs, len(table))
        except Uncertified:
            self.rejected["uncertified"] += 1
        self._hear_last(proofs, len(table))
        claims = None if message.claims is None else claims_in(tuple(entries))
        return msgspec.structs.replace(message, claims=claims, offer=offer)

    def _hear_last(self, proofs: Proofs, places: int) -> None:
        """Go on from the last claim of a former life of this robot, if a neighbour shows one."""
        last = next((last for last in proofs.last if last.owner == self._robot), None)
        if last is None or not self._page.number <= last.number < most_claims(places):
            return
        held = (last.slot, last.entry) in self._page.held
        if not held and self._holds(last.slot, last.entry, last.certificate, places):
            self._page.number = last.number + 1

    def _renew(self, slot: int, table: BidTable, certificate: Certificate | None) -> None:
        """Its owner has claimed a slot again that it has and no other: the higher number counts."""
        entry = table[slot]
        held = self._page.held.get((slot, entry))
        if certificate is None or held is None or not held.number < certificate.number <= most_claims(len(table)):
            return
        if sum(other[2] == entry[2] for other in table) == 1 and self._holds(slot, entry, certificate, len(table)):
            self._keep(slot, entry, certificate)

    def _fit(self, message: Message, slot: int, certificate: Certificate | None, table: BidTable) -> BidEntry:
        """The part of an entry that may be merged: all of it, that its version was freed, or nothing."""
        entry = (message.table or ())[slot]
        owner = entry[2]
        if (slot, entry) in self._page.held:
            certificate = self._page.held[slot, entry]
        else:
            certificate = certificate or Certificate(number=0)
            self._certify(slot, entry, certificate, len(table))
            if certificate.number > most_claims(len(table)):
                # Its owner may be honest, and have been driven from place to place by liars.
                self.rejected["many_claims"] += 1
                return UNSAID
        if owner < 0:
            self._hear_freed(slot, entry, certificate.grant, table)
            return entry
        place = (certificate.number, slot)
        # A slot that the others give to this robot is welcome if it has no other: its last claim was never heard.
        welcome = owner == self._robot and all(other[2] != owner or a == slot for a, other in enumerate(table))
        outdated = place < self._page.last.get(owner, place) and not welcome
        if not outdated and not self._counts_not(owner):
            self._hear_freed(slot, entry, certificate.grant, table)
            self._keep(slot, entry, certificate)
            return entry
        if outdated and owner == message.sender:
            self._page.behind.add(owner)
        if entry[0] > table[slot][0] and isinstance(certificate.grant, ReleaseGrant):
            # The words that freed it count all the same. As a cause or a departure, the claim would be a reason for a
            # word of this robot, and liars could show such claims on any number of later versions.
            self._hear_freed(slot, entry, certificate.grant, table)
            return (entry[0], 0.0, NO_OWNER)
        self._page.departures.explain(LastClaim.of(slot, entry, certificate))
        if outdated:
            self._page.departures.outdate(slot, entry)
        return UNSAID

    def _keep(self, slot: int, entry: BidEntry, certificate: Certificate) -> None:
        self._page.held[slot, entry] = certificate
        owner, place = entry[2], (certificate.number, slot)
        if place >= self._page.last.get(owner, place):
            self._page.last[owner] = place
            self._page.last_claims[owner] = LastClaim.of(slot, entry, certificate)
        if owner == self._robot:
            self._page.number = max(self._page.number, certificate.number)

    def _hear_freed(self, slot: int, entry: BidEntry, grant: Grant | None, table: BidTable) -> None:
        """Keep the words that freed or blocked a slot, and count the departure that they tell of."""
        version, _, owner = entry
        if isinstance(grant, ReleaseGrant):
            self._page.freed[slot, version, min(owner, NO_OWNER)] = grant
            if grant.by != NO_OWNER:
                self._page.departures.count(grant.by, slot, version, table)

    def _holds(self, slot: int, entry: BidEntry, certificate: Certificate, places: int) -> bool:
        return self._checks.holds(self._context, slot, entry, certificate, places)

    def _certify(self, slot: int, entry: BidEntry, certificate: Certificate, places: int) -> None:
        """Raise where no honest robot could write an entry, or its certificate does not prove it."""
        likely = plausible(self._context, slot, entry, certificate.number)
        if not likely or not self._holds(slot, entry, certificate, places):
            raise Uncertified

    def _hear_word(self, word: WitnessStatement, table: BidTable) -> None:
        """Keep a statement about the next version of an entry held; of departures, those of who may have claimed it."""
        slot, version, owner = word.slot, word.version, word.owner
        if slot >= len(table) or version != table[slot][0] + 1 or self._page.words.knows(word):
            return
        highest = self._page.departures.highest(slot, version - 1, table)
        if owner <= LEFT and LEFT - owner not in (table[slot][2], highest):
            return
        if not self.signed_by(word.witness, word_statement(self._context, slot, version, owner), word.signature):
            raise Uncertified
        self._page.words.keep(word)

    def _hear_restless(self, word: RestlessWord) -> None:
        """Keep a word about a robot of which a departure is known: others would only fill memory and messages."""
        if not self._page.departures.suspects(word.robot) or self._page.departures.knows(word.robot, word.witness):
            return
        if not self.signed_by(word.witness, restless_statement(self._context, word.robot), word.signature):
            raise Uncertified
        self._page.departures.keep(word.robot, word.witness, word.signature)

    def _hear_cause(self, cause: LastClaim, table: BidTable) -> None:
        """Note a claim that does not count any more, but is why the owner in the table has left."""
        slot, entry, owner = cause.slot, cause.entry, cause.owner
        if slot >= len(table) or entry[0] != table[slot][0] or rank(entry) <= rank(table[slot]):
            return
        outdated = (cause.number, slot) < self._page.last.get(owner, (0, 0))
        if not (outdated or self._counts_not(owner)):
            return
        if not self._page.departures.explained(cause):
            self._certify(slot, entry, cause.certificate, len(table))
            self._page.departures.explain(cause)
        if outdated:
            self._page.departures.outdate(slot, entry)

    def _counts_not(self, owner: int) -> bool:
        """Whether a robot claims in vain: it is excluded, or does not seem to live."""
        return owner in self.excluded or (owner in self._page.silent and owner != self._robot)

    @property
    def excluded(self) -> frozenset[int]:
        """Robots whose claims on the plan count for nothing: they left place after place."""
        return self._page.departures.excluded

    def without_excluded(self, table: BidTable) -> BidTable:
        """The table with the places of excluded robots free, where it can be shown that this version was freed."""
        new: dict[int, BidEntry] = {}
        for slot, (version, _, owner) in enumerate(table):
            if owner in self.excluded and (version == 0 or self.freed(slot, version)):
                # Its claim stays the highest there was: the robots that it outbid have left with cause.
                if (certificate := self._page.held.get((slot, table[slot]))) is not None:
                    self._page.departures.explain(LastClaim.of(slot, table[slot], certificate))
                new[slot] = (version, 0.0, NO_OWNER) if version else UNSAID
        return changed(table, new)

    def draw(self, slot: int, version: int) -> float:
        return drawn_bid(self._context, slot, version, self._robot)

    def freed(self, slot: int, version: int) -> bool:
        """Whether this robot can show the words that freed this version of a slot."""
        return (slot, version, NO_OWNER) in self._page.freed

    def may_exchange(self, places: int) -> bool:
        """Whether exchanges count in this team, and this robot has not used up its numbers for them."""
        return self._checks.exchanges and self._page.number + SPARE <= most_exchanges(places)

    def _hear_offer(self, message: Message, proofs: Proofs, places: int) -> Offer | None:
        if (offer := message.offer) is None:
            return None
        number, signature = proofs.offer or (0, b"")
        if not (
            0 < number <= most_exchanges(places)
            and offer.bid == drawn_bid(self._context, offer.take, offer.take_version + 1, message.sender)
            and self.signed_by(message.sender, offer_statement(self._context, message.sender, offer, number), signature)
        ):
            raise Uncertified
        self._page.heard_offers[message.sender] = (offer, number, signature)
        return offer

    def precedence(self, slot: int, entry: BidEntry) -> tuple[int, int]:
        """Precedence of a claim among several of one robot: the last one counts."""
        return (self._page.held[slot, entry].number, slot)

    def witness(self, table: BidTable, seen: Occupancy) -> None:
        """State, once a round, of which slots this robot can say that they are free, or blocked."""
        for slot, entry in enumerate(table):
            certificate = self._page.held.get((slot, entry))
            if certificate is not None and (certificate.number, slot) < self._page.last[entry[2]]:
                self._page.departures.outdate(slot, entry)
        self._page.silent = seen.silent
        # A robot that hears too few to be sure of an honest one blames none: it may have missed other claims.
        sure = seen.alive > 2 * self.liars
        departed = self._page.departures.departed(table)
        own = {(slot, version + 1, left_by(owner) if sure else NO_OWNER) for slot, version, owner in departed}
        for slot, (version, _, owner) in enumerate(table):
            if slot in seen.blocked and owner != BLOCKED:
                own = {what for what in own if what[0] != slot} | {(slot, version + 1, BLOCKED)}
            elif owner in seen.silent or owner in self.excluded or (owner == BLOCKED and slot in seen.clear):
                own.add((slot, version + 1, NO_OWNER))
        self._page.words.state(own, lambda stated: self._authenticator.sign(word_statement(self._context, *stated)))
        for robot in self._page.departures.restless(len(table)) if sure else ():
            if not self._page.departures.knows(robot, self._robot):
                signature = self._authenticator.sign(restless_statement(self._context, robot))
                self._page.departures.keep(robot, self._robot, signature)

    def granted(self, table: BidTable) -> BidTable:
        """Entries that enough robots have stated together, to be merged; UNSAID elsewhere."""
        entries: list[BidEntry] = [UNSAID] * len(table)
        for slot, version, owner, grant in self._page.words.grants(table):
            entry = (version, 0.0, owner)
            self._hear_freed(slot, entry, grant, table)
            entries[slot] = max(entry, entries[slot], key=rank)
        return tuple(entries)

    def attest(self, claim: Claim) -> None:
        """Sign what this robot has just written into its table."""
        table = claim.table
        if table is None:
            return
        for maker, (offer, number, signature) in self._page.heard_offers.items():
            self._accept(table, maker, offer, number, signature)
        self._page.heard_offers = {}
        for slot, entry in enumerate(table):
            if entry[2] != self._robot:
                continue
            held = self._page.held.get((slot, entry))
            if held is None:
                self._claim(slot, entry, self._page.freed[slot, entry[0], NO_OWNER] if entry[0] else None)
            elif slot == claim.slot and claim.offer is None and held.number < self._page.number:
                # Somebody may have heard of a later claim, or accepted an offer, of which nothing came.
                self._claim(slot, entry, held.grant)
        self._page.held = {key: certificate for key, certificate in self._page.held.items() if table[key[0]] == key[1]}
        self._page.departures.forget_causes(table)
        self._page.freed = {key: freed for key, freed in self._page.freed.items() if key[1] >= table[key[0]][0]}

    def _claim(self, slot: int, entry: BidEntry, grant: Grant | None) -> None:
        self._page.number += 1
        signature = self._authenticator.sign(claim_statement(self._context, slot, entry, self._page.number))
        self._keep(slot, entry, Certificate(number=self._page.number, signature=signature, grant=grant))

    def _accept(self, table: BidTable, maker: int, offer: Offer, number: int, signature: bytes) -> None:
        """Sign the acceptance of an offer, if the table has it."""
        given, taken = table[offer.give], table[offer.take]
        new = (offer.give_version + 1, self._robot), (offer.take_version + 1, offer.bid, maker)
        held = self._page.held
        if (given[::2], taken) != new or (offer.give, given) in held or (offer.take, taken) in held:
            return
        self._page.number += 1
        done = ExchangeGrant(
            maker,
            *msgspec.structs.astuple(offer),
            number=number,
            signature=signature,
            accepted_bid=given[1],
            accepted_number=self._page.number,
            accepted=b"",
        )
        accepted = self._authenticator.sign(acceptance_statement(self._context, done))
        done = msgspec.structs.replace(done, accepted=accepted)
        self._keep(offer.give, given, Certificate(number=self._page.number, grant=done))
        self._keep(offer.take, taken, Certificate(number=number, grant=done))

    def prove(self, message: Message) -> Proofs:
        """The certificates of the claims in one of this robot's own messages."""
        certificates: dict[int, Certificate] = {}
        for slot, entry in enumerate(message.table or ()):
            version, _, owner = entry
            if owner >= 0:
                certificates[slot] = self._page.held[slot, entry]
            elif version > 0:
                certificates[slot] = Certificate(number=0, grant=self._page.freed[slot, version, owner])
        claims, grants = claims_of(certificates)
        self._turn += 1
        restless = self._page.departures.words()
        own = [word for word in restless if word.witness == self._robot]
        # With few witnesses, enough of them are found among the neighbours.
        others = self._page.words.of_others() if self._checks.witnesses > witnesses(LIARS) else ()
        last, self._page.behind = tuple(self._page.last_claims[j] for j in sorted(self._page.behind)), set()
        return Proofs(
            claims=claims,
            grants=grants,
            words=(*self._page.words.own(), *in_turn(others, self._turn)),
            offer=self._offer(message.offer),
            last=last,
            restless=(*own, *in_turn([word for word in restless if word not in own], self._turn)),
            causes=in_turn(self._page.departures.causes, self._turn),
        )

    def _offer(self, offer: Offer | None) -> tuple[int, bytes] | None:
        """The signed offer; it has a number of its own, which counts as that of a claim if it is accepted."""
        if offer is None:
            return None
        if offer not in self._page.offers:
            self._page.number += 1
            statement = offer_statement(self._context, self._robot, offer, self._page.number)
            self._page.offers = {offer: (self._page.number, self._authenticator.sign(statement))}
        return self._page.offers[offer]
