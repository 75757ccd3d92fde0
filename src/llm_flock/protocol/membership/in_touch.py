"""Joint assignment of the robots in touch, in teams that collect nothing all-to-all.

A small team starts in pieces too, and bids and exchanges place the robots of a piece one by one while all fly. So each
robot reports its position once a round and passes on what it hears. Whoever knows more robots than its bid table places
computes the assignment of all these with the smallest sum of squared distances, and writes it into its table. When two
pieces meet, both know more robots than before, and the assignment of both follows.

The version of these claims is the number of robots that they place, and below that a digest of the positions: so of two
tables the one that places more wins as a whole, and of two that place as many the same one everywhere. As in
`llm_flock.protocol.membership.all_to_all`, the table is merged like any other.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping

import msgspec

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.membership.all_to_all import DECIMALS, PATIENCE, VERSION
from llm_flock.protocol.membership.search import MANY
from llm_flock.protocol.messages.message import BLOCKED, LAST_ROUND, BidTable, PositionReport, TeamPositions
from llm_flock.protocol.plan import Plan

DIGESTS = 2**16
"""Number of digests; two joint assignments of as many robots share one by chance, and are then sorted out by bids."""


class InTouch:
    """The positions that one robot knows in a team of at most `MANY` without keys (else `enabled` is false)."""

    def __init__(self, robot: int, n_robots: int, *, enabled: bool = True) -> None:
        self._robot, self._n = robot, n_robots
        self._enabled = enabled and n_robots <= MANY
        self.begin()

    def begin(self) -> None:
        """Forget all reports. Call at the start of each mission."""
        self.known: dict[int, PositionReport] = {}
        """The newest report of each robot, by id; another object whenever it has changed."""
        self._heard_in: dict[int, int] = {}
        self._news: dict[int, PositionReport] = {}
        self._round = self._waited = 0

    def begin_round(self) -> None:
        """Count a round."""
        self._round += 1
        self._waited += 1

    @property
    def collecting(self) -> bool:
        """Whether reports are exchanged: a robot that was unknown has been heard of not too long ago."""
        return self._enabled and self._waited <= PATIENCE

    def hear(self, reports: Mapping[int, PositionReport]) -> None:
        """Merge the reports that a neighbour passes on."""
        if not self.collecting:
            return
        new = {j: report for j, report in reports.items() if j not in self.known or report[0] > self.known[j][0]}
        if not new:
            return
        if not new.keys() <= self.known.keys():
            self._waited = 0
        self.known = self.known | new
        self._news |= new
        self._heard_in |= dict.fromkeys(new, self._round)

    def report(self, position: Point, table: BidTable | None, *, greeting: bool) -> dict[int, PositionReport] | None:
        """The reports to broadcast: those that are new, and the own one [units; frame of the mission] in a `greeting`.

        None where the table places all robots.
        """
        if not self.collecting or placed(table) >= self._n:
            self._news = {}
            return None
        if greeting:
            # A robot that was restarted, and hears of its former life, counts on from there.
            stamp = self.known.get(self._robot, (0, (), ()))[0]
            here = tuple(round(x, DECIMALS) for x in position)
            self.hear({self._robot: (min(max(self._round, stamp + 1), LAST_ROUND), here, ())})
        reports, self._news = dict(self.known if greeting else self._news), {}
        return reports or None

    def positions(
        self, mission: Mission, plan: Plan, table: BidTable | None, silent: Collection[int]
    ) -> TeamPositions | None:
        """Where the known robots are that live, if they are more than the table of this plan places; else None.

        A robot of which nothing new was heard is taken to have flown on to its place.
        """
        ids = sorted(self.known.keys() - silent)
        if not self.collecting or len(ids) < 2 or len(ids) <= placed(table):
            return None
        slots = {owner: a for a, (_, _, owner) in enumerate(table or ())}
        if BLOCKED in slots:
            return None
        where = list[Point]()
        for j in ids:
            here = self.known[j][1]
            flown = mission.max_step * (self._round - self._heard_in[j])
            where.append(_towards(here, plan.points[slots[j]], flown) if flown and j in slots else here)
        digest = hashlib.blake2b(msgspec.msgpack.encode((ids, where)), digest_size=2).digest()
        version = VERSION * (len(ids) * DIGESTS + int.from_bytes(digest))
        return version, tuple(ids), tuple(where)


def placed(table: BidTable | None) -> int:
    """How many robots the joint assignment in a table places, without a place for those that are too many."""
    return max((version for version, _, _ in table or ()), default=0) // (VERSION * DIGESTS)


def _towards(here: Point, goal: Point, longest: float) -> Point:
    away = math.dist(here, goal)
    share = 1.0 if away <= longest else longest / away
    return tuple(round(x + share * (y - x), DECIMALS) for x, y in zip(here, goal, strict=True))
