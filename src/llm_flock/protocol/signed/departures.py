"""Who leaves place after place though nobody outbids it: it may own none any more.

With every place that is left, its version rises, and lots are drawn anew. Robots that lie could move on for ever, and
drive the honest from place to place. An honest robot leaves a place only if it is outbid, if others believe it to be
silent for too long, or by an exchange. So every robot counts who leaves without cause, and says so of whoever does it
too often; once one robot more than may lie has said it, that robot's claims on this plan count for nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from llm_flock.protocol.messages.message import BLOCKED, NO_OWNER, BidEntry, BidTable
from llm_flock.protocol.signed.certificates import Certificate, ExchangeGrant, RestlessWord, most_exchanges

MOST_DEPARTURES = 5
"""So often may a robot leave a place of a plan without cause: an honest one may be believed silent now and then.

Where exchanges count, one that comes to nothing may look like a departure; then as many more as there are numbers for
exchanges.
"""


class _Seat(NamedTuple):
    number: int
    slot: int
    version: int


class Departures:
    """What one robot has seen and heard of departures from the places of one plan; `enough` words exclude a robot."""

    def __init__(self, enough: int, *, exchanges: bool) -> None:
        self._enough = enough
        self._exchanges = exchanges
        self._seats: dict[int, _Seat] = {}
        self._left: set[tuple[int, int, int]] = set()
        self._outbid: set[tuple[int, int, int]] = set()
        self._counts: Counter[int] = Counter()
        self._words: dict[int, dict[int, bytes]] = {}

    @property
    def excluded(self) -> frozenset[int]:
        """Robots that may own no place of this plan any more."""
        return frozenset(robot for robot, words in self._words.items() if len(words) >= self._enough)

    def outbid(self, slot: int, entry: BidEntry, by: BidEntry) -> None:
        """Note a claim that outbids an entry, also if the claim does not count any more."""
        if entry[0] == by[0]:
            self._outbid.add((entry[2], slot, entry[0]))

    def look(self, table: BidTable, held: Mapping[tuple[int, BidEntry], Certificate]) -> Iterable[int]:
        """Compare the table with that of the round before; returns who leaves too often. Call once a round.

        A departure counts one round late: the news of who outbid a robot may be on its way.
        """
        for owner, slot, version in self._kept():
            at, _, now = table[slot]
            if now == BLOCKED or (at == version and now not in (owner, NO_OWNER)):
                self._outbid.add((owner, slot, version))
        self._counts.update(owner for owner, _, _ in self._left - self._outbid)
        self._left = set()
        for owner, (seat, exchanged) in _seats(table, held).items():
            before = self._seats.get(owner)
            if before is not None and seat[:2] < before[:2]:
                continue
            if before is not None and seat.slot != before.slot and not exchanged:
                self._left.add((owner, before.slot, before.version))
            self._seats[owner] = seat
        self._outbid &= self._kept()
        most = MOST_DEPARTURES + (most_exchanges(len(table)) if self._exchanges else 0)
        return [owner for owner, count in self._counts.items() if count > most]

    def _kept(self) -> set[tuple[int, int, int]]:
        """Owner, slot and version of each last claim known, and of those left since the round before."""
        return self._left | {(owner, seat.slot, seat.version) for owner, seat in self._seats.items()}

    def knows(self, robot: int, witness: int) -> bool:
        """Whether one more word is of no use: this witness has said it, or enough others have."""
        words = self._words.get(robot, {})
        return witness in words or len(words) >= self._enough

    def keep(self, robot: int, witness: int, signature: bytes) -> None:
        """Keep a checked word that a robot leaves too often."""
        self._words.setdefault(robot, {})[witness] = signature

    def words(self) -> Sequence[RestlessWord]:
        """All words known, to be passed on."""
        return [
            RestlessWord(robot, witness, signature)
            for robot, words in sorted(self._words.items())
            for witness, signature in sorted(words.items())
        ]


def _seats(table: BidTable, held: Mapping[tuple[int, BidEntry], Certificate]) -> dict[int, tuple[_Seat, bool]]:
    """The last claim of each owner, and whether it is of an exchange."""
    seats: dict[int, tuple[_Seat, bool]] = {}
    for slot, entry in enumerate(table):
        certificate = held.get((slot, entry))
        if entry[2] < 0 or certificate is None:
            continue
        seat = _Seat(certificate.number, slot, entry[0])
        if entry[2] not in seats or seat > seats[entry[2]][0]:
            seats[entry[2]] = seat, isinstance(certificate.grant, ExchangeGrant)
    return seats
