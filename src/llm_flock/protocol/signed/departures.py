"""Who leaves place after place though nobody outbids it: it may own none any more.

With every place that is left, its version rises, and lots are drawn anew. Robots that lie could move on for ever, and
drive the honest from place to place. So whoever frees a place because its owner left it says so, by name, and these
departures are counted; of a robot that leaves too often every robot says that it is restless. Once one robot more than
may lie has said it, the claims of that robot on this plan count for nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from llm_flock.protocol.agreement.auction import rank
from llm_flock.protocol.messages.message import UNSAID, BidEntry, BidTable
from llm_flock.protocol.signed.certificates import LastClaim, RestlessWord, most_exchanges

MOST_DEPARTURES = 5
"""So often may a robot leave a place of a plan: an honest one may seem to, where news of who outbid it is lost.

Where exchanges count, one that comes to nothing may look like a departure; then as many more as there are numbers for
exchanges.
"""


class Departures:
    """Departures from the places of one plan, and words about who is restless; `enough` of these exclude a robot."""

    def __init__(self, enough: int, *, exchanges: bool) -> None:
        self._enough = enough
        self._exchanges = exchanges
        self._left: dict[int, set[tuple[int, int]]] = {}
        self._words: dict[int, dict[int, bytes]] = {}
        self._outdated: set[tuple[int, BidEntry]] = set()
        self._outdated_before: set[tuple[int, BidEntry]] = set()
        self._causes: dict[int, LastClaim] = {}

    def outdate(self, slot: int, entry: BidEntry) -> None:
        """Note that an owner has another claim since."""
        self._outdated.add((slot, entry))

    def explain(self, cause: LastClaim) -> None:
        """Note a checked claim that does not count any more, but outbids the one in the table."""
        self._causes[cause.slot] = cause
        self.outdate(cause.slot, entry_of(cause))

    def explained(self, cause: LastClaim) -> bool:
        """Whether this claim has been noted and checked before."""
        return self._causes.get(cause.slot) == cause

    @property
    def causes(self) -> Sequence[LastClaim]:
        """Claims that do not count any more, but are why owners in the table have gone."""
        return tuple(self._causes.values())

    def forget_causes(self, table: BidTable) -> None:
        """Keep those that outbid an entry of the table, at its version."""
        self._causes = {
            slot: cause
            for slot, cause in self._causes.items()
            if cause.version == table[slot][0] and rank(entry_of(cause)) > rank(table[slot])
        }

    def claimants(self, slot: int, table: BidTable) -> set[int]:
        """Who holds a slot, or has outbid who holds it by a claim that does not count any more."""
        cause = self._causes.get(slot)
        return {table[slot][2]} if cause is None else {table[slot][2], cause.owner}

    def departed(self, table: BidTable) -> Iterable[tuple[int, BidEntry]]:
        """The highest claims on slots whose owners have others since, though nobody outbid them. Call once a round."""
        highest: dict[int, BidEntry] = {}
        for slot, entry in self._outdated:
            if rank(entry) >= rank(max(table[slot], highest.get(slot, UNSAID), key=rank)):
                highest[slot] = entry
        # Twice in a row: an honest robot that moved on was outbid, and the news of it is on its way.
        left = highest.items() & self._outdated_before
        self._outdated_before, self._outdated = self._outdated, set()
        return left

    @property
    def excluded(self) -> frozenset[int]:
        """Robots that may own no place of this plan any more."""
        return frozenset(robot for robot, words in self._words.items() if len(words) >= self._enough)

    def count(self, robot: int, slot: int, version: int) -> None:
        """Note that this version of a place is free because a robot left it."""
        self._left.setdefault(robot, set()).add((slot, version))

    def restless(self, places: int) -> Sequence[int]:
        """Who has left too often."""
        most = MOST_DEPARTURES + (most_exchanges(places) if self._exchanges else 0)
        return [robot for robot, left in self._left.items() if len(left) > most]

    def knows(self, robot: int, witness: int) -> bool:
        """Whether one more word is of no use: this witness has said it, or enough others have."""
        words = self._words.get(robot, {})
        return witness in words or len(words) >= self._enough

    def keep(self, robot: int, witness: int, signature: bytes) -> None:
        """Keep a checked word that a robot is restless."""
        self._words.setdefault(robot, {})[witness] = signature

    def words(self) -> Sequence[RestlessWord]:
        """All words known, to be passed on."""
        return [
            RestlessWord(robot, witness, signature)
            for robot, words in sorted(self._words.items())
            for witness, signature in sorted(words.items())
        ]


def entry_of(claim: LastClaim) -> BidEntry:
    """The claim as an entry of a table."""
    return (claim.version, claim.bid, claim.owner)
