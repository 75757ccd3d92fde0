"""Restless robots leave their places again and again without being outbid. Their claims are then ignored.

A departure raises the version of the place, and all bids for it are drawn again: liars could drive the honest from
place to place. So witnesses name the robot that left, and every robot counts departures and reports a robot that leaves
too often. When more robots report it than may lie, its claims on this plan are ignored.
"""

from __future__ import annotations

from collections.abc import Sequence

from llm_flock.message import UNSAID, BidEntry, BidTable
from llm_flock.protocol import rank
from llm_flock_swarm._signed.certificates import LastClaim, RestlessWord, most_exchanges

MAX_DEPARTURES = 5
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
        self._due: set[tuple[int, int]] = set()
        self._causes: dict[tuple[int, int], LastClaim] = {}

    def outdate(self, slot: int, entry: BidEntry) -> None:
        self._outdated.add((slot, entry))

    def explain(self, cause: LastClaim) -> None:
        """Note a checked claim that does not count, but outbids the one in the table; the highest there is kept."""
        if not self.explained(cause):
            self._causes[cause.slot, cause.version] = cause

    def explained(self, cause: LastClaim) -> bool:
        """Whether this claim, or a higher one on the same version of the slot, has been noted and checked before."""
        known = self._causes.get((cause.slot, cause.version))
        return known is not None and rank(known.entry) >= rank(cause.entry)

    @property
    def causes(self) -> Sequence[LastClaim]:
        """Claims that do not count, but are why owners in the table have gone."""
        return tuple(self._causes.values())

    def forget_causes(self, table: BidTable) -> None:
        """Keep those that outbid an entry of the table."""
        self._causes = {
            (slot, version): cause
            for (slot, version), cause in self._causes.items()
            if rank(cause.entry) > rank(table[slot])
        }

    def highest(self, slot: int, version: int, table: BidTable) -> int:
        """Owner of the highest claim known on a version of a slot, whether it counts or not; NO_OWNER if none is."""
        cause = self._causes.get((slot, version))
        claims = [table[slot]] if table[slot][0] == version else []
        return max(claims if cause is None else [*claims, cause.entry], key=rank, default=UNSAID)[2]

    def departed(self, table: BidTable) -> Sequence[tuple[int, int, int]]:
        """Slot and version of claims whose owners have others since, and the owner of the highest one there.

        Call once a round. Twice in a row: an honest robot that moved on was outbid, and the news of it is on its way.
        """
        due = {(a, entry[0]) for a, entry in self._outdated if rank(entry) >= rank(table[a])}
        left, self._due, self._outdated = due & self._due, due, set()
        return [(slot, version, self.highest(slot, version, table)) for slot, version in sorted(left)]

    @property
    def excluded(self) -> frozenset[int]:
        """Robots that may own no place of this plan any more."""
        return frozenset(robot for robot, words in self._words.items() if len(words) >= self._enough)

    def count(self, robot: int, slot: int, version: int, table: BidTable) -> None:
        """Note that this version of a place is free because a robot left it, if its claim was the highest known."""
        if self.highest(slot, version - 1, table) == robot:
            self._left.setdefault(robot, set()).add((slot, version))

    def suspects(self, robot: int) -> bool:
        return robot in self._left

    def restless(self, places: int) -> Sequence[int]:
        most = MAX_DEPARTURES + (most_exchanges(places) if self._exchanges else 0)
        return [robot for robot, left in self._left.items() if len(left) > most]

    def knows(self, robot: int, witness: int) -> bool:
        """Whether one more word is of no use: this witness has said it, or enough others have."""
        words = self._words.get(robot, {})
        return witness in words or len(words) >= self._enough

    def keep(self, robot: int, witness: int, signature: bytes) -> None:
        """Keep a checked word that a robot is restless."""
        self._words.setdefault(robot, {})[witness] = signature

    def words(self) -> Sequence[RestlessWord]:
        return [
            RestlessWord(robot, witness, signature)
            for robot, words in sorted(self._words.items())
            for witness, signature in sorted(words.items())
        ]
