"""Checks signatures under statements of members, and certificates of entries of a bid table."""

from __future__ import annotations

from llm_flock.message import NO_OWNER, UNSAID, BidEntry
from llm_flock.protocol import LAST_EXCHANGED
from llm_flock_swarm._signed.certificates import (
    Certificate,
    Context,
    ExchangeGrant,
    ReleaseGrant,
    Verifier,
    acceptance_statement,
    claim_statement,
    left_by,
    most_exchanges,
    offer_statement,
    witnesses,
    word_statement,
)

SPARE = 4  # numbers that a robot may use up between the decision to exchange and the exchange
REMEMBERED = 4096  # most signatures that are remembered as good


class Uncertified(Exception):
    """A statement without a valid signature, or that no honest robot makes."""


class Checks:
    """Checks of one robot, of which `liars` others may lie together; good signatures are remembered."""

    def __init__(self, verifier: Verifier, liars: int) -> None:
        self.witnesses = witnesses(liars)
        # Both signatures under an exchange may be liars', if there may be two.
        self.exchanges = liars < 2
        self._verifier = verifier
        self._good: set[tuple[int, bytes, bytes]] = set()

    def signed_by(self, member: int, statement: bytes, signature: bytes) -> bool:
        """Whether a member signed this; each good signature is checked once."""
        key = (member, statement, signature)
        if key in self._good:
            return True
        good = self._verifier.check(member, statement, signature)
        if good:
            if len(self._good) >= REMEMBERED:
                self._good.clear()
            self._good.add(key)
        return good

    def holds(self, page: Context, slot: int, entry: BidEntry, certificate: Certificate, places: int) -> bool:
        """Whether the certificate proves the entry of a slot."""
        version, _, owner = entry
        grant = certificate.grant
        if isinstance(grant, ExchangeGrant):
            made, number = grant.entries().get(slot, (UNSAID, 0))
            if made != entry or not self._is_exchange_granted(page, grant, most_exchanges(places)):
                return False
            if certificate.number <= number:
                return certificate.number == number
        elif version == 0 and (grant is not None or owner == NO_OWNER):
            return grant is None
        elif version > 0 and not (grant is not None and self._free(page, slot, version, min(owner, NO_OWNER), grant)):
            return False
        statement = claim_statement(page, slot, entry, certificate.number)
        return owner < 0 or self.signed_by(owner, statement, certificate.signature)

    def _free(self, page: Context, slot: int, version: int, owner: int, grant: ReleaseGrant) -> bool:
        if grant.by != NO_OWNER and owner != NO_OWNER:
            return False  # who left it has not blocked it
        stated = owner if grant.by == NO_OWNER else left_by(grant.by)
        statement = word_statement(page, slot, version, stated)
        # Exactly as many as are needed: every robot that merges the entry has to pass the grant on.
        return len(grant.words) == len({robot for robot, _ in grant.words}) == self.witnesses and all(
            self.signed_by(robot, statement, signature) for robot, signature in grant.words
        )

    def _is_exchange_granted(self, page: Context, done: ExchangeGrant, most: int) -> bool:
        offer = offer_statement(page, done.maker, done.offer(), done.number)
        return (
            self.exchanges
            and done.maker != done.to
            and done.give != done.take
            and max(done.give_version, done.take_version) < LAST_EXCHANGED
            and max(done.number, done.accepted_number) <= most
            and self.signed_by(done.maker, offer, done.signature)
            and self.signed_by(done.to, acceptance_statement(page, done), done.accepted)
        )
