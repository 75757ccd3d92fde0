"""Joint assignment: robots in touch report positions, and a robot that knows enough of them assigns all their slots.

As C-CAPT (Turpin, Michael, Kumar, IJRR 2014); see membership.md in the docs. The version of these claims combines
the number of placed robots and a digest of the positions. So a table that places more robots wins as a whole, and
between tables that place equally many every robot prefers the same one.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from functools import lru_cache

import msgspec
import numpy as np
import scipy

from llm_flock.arrays import Point, towards
from llm_flock.bounds import MAX_WAITING
from llm_flock.message import BLOCKED, LAST_ROUND, NO_OWNER, BidTable, PositionReport, TeamPositions
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.preferences import costs
from llm_flock.protocol._membership.rendezvous import landing
from llm_flock.protocol._membership.search import MANY
from llm_flock.protocol._path_length import ways
from llm_flock.roadmap import Roadmap

ROUNDS = 8  # rounds of a mission in which a large team passes on positions at the start; then they are out of date
SECOND = 0.15  # share of the team size, in rounds, after which waiting robots report a final position for one table
VERSION = 2**22  # version of a joint assignment for each robot that it places: above all earlier claims
DIGESTS = 2**16  # if two joint assignments of equally many robots share a digest by chance, bids decide
DECIMALS = 2  # decimals of reported positions
MOVED = 0.1  # a waiting robot reports its position again when it has moved by this share of the spacing
PATIENCE = 16  # rounds without news of an unknown robot after which a robot stops to wait, or to report positions


class JointAssignment:
    """The positions that one robot knows. In a team with keys `enabled` is false, as reports are not signed."""

    def __init__(self, robot: int, n_robots: int, *, enabled: bool = True) -> None:
        self._robot, self._n, self._enabled = robot, n_robots, enabled
        self._large = n_robots > MANY
        self.begin()

    def begin(self) -> None:
        """Forget all reports. Call at the start of each mission."""
        self._round = self._waited = 0
        self._forget()

    def _forget(self) -> None:
        self.known: dict[int, PositionReport] = {}
        """The newest report of each robot, by id. A new object after each change."""
        self._heard_in: dict[int, int] = {}
        self._news: dict[int, PositionReport] = {}

    @property
    def _starting(self) -> bool:
        """Whether positions at the start of the mission are passed on, in a large team."""
        return self._large and self._round <= ROUNDS

    @property
    def waiting(self) -> bool:
        """Whether the robots of a large team in pieces wait for each other."""
        return self._large and self.collecting and not self._starting

    @property
    def collecting(self) -> bool:
        """Whether reports are exchanged: at the start, then until PATIENCE rounds brought no unknown robot."""
        if not self._enabled or self._starting:
            return self._enabled
        return self._n <= MAX_WAITING and self._waited <= PATIENCE

    @property
    def others(self) -> list[Point]:
        """Known positions of other robots [units; frame of the mission]."""
        return [where for robot, (_, where, _) in self.known.items() if robot != self._robot]

    def begin_round(self) -> None:
        self._round += 1
        self._waited += not self._large
        if self._large and (self._round == ROUNDS + 1 or not self.collecting):
            self._forget()

    def wait(self, *, there: bool) -> None:
        """Count a round of waiting; `there` says whether the robot has reached its waiting point."""
        self._waited += there

    def hear(self, reports: Mapping[int, PositionReport]) -> None:
        """Merge the reports that a neighbour passes on."""
        known, starting = self.known, self._starting
        if not self.collecting or (starting and reports.keys() <= known.keys()):
            return
        new = {
            robot: report
            for robot, report in reports.items()
            if (robot not in known or report[0] > known[robot][0]) and starting == (report[0] == 0)
        }
        if new:
            if not new.keys() <= known.keys():
                self._waited = 0
            self.known = known | new
            self._news |= new
            self._heard_in |= dict.fromkeys(new, self._round)

    def report(
        self, mission: Mission, plan: Plan | None, table: BidTable | None, position: Point, *, greeting: bool
    ) -> dict[int, PositionReport] | None:
        """The reports to broadcast: new ones, and in the `greeting`, the first broadcast of a round, all known ones.

        None if nothing is to be sent: the table places all robots, or there is no circle to wait on.
        """
        if not self.collecting or placed(table) >= self._n:
            self._news = {}
            return None
        here, (stamp, before, mark) = position, self.known.get(self._robot, (0, (), ()))
        due = not before if self._starting else greeting
        if self.waiting:
            point = None if plan is None else landing(mission, plan, position)
            if point is None:
                return None
            here, marks = point, not mark and self._round > SECOND * self._n
            mark = _round_point(here) if marks else mark
            due = marks or not before or math.dist(_round_point(here), before) > MOVED * mission.spacing
        if due:
            # After a restart, a robot continues the count of its earlier reports.
            stamp = 0 if self._starting else min(max(self._round, stamp + 1), LAST_ROUND)
            self.hear({self._robot: (stamp, _round_point(here), mark)})
        reports, self._news = dict(self.known if greeting else self._news), {}
        return reports or None

    def positions(
        self, mission: Mission, plan: Plan, table: BidTable | None, silent: Collection[int]
    ) -> TeamPositions | None:
        """Present positions of known living robots, if they are more than the table places; else None."""
        if not self.collecting or (self._large and len(self.known) < self._n):
            return None
        ids = sorted(self.known.keys() - silent)
        slots = {owner: a for a, (_, _, owner) in enumerate(table or ())}
        least = self._n if self._large else 2
        if len(ids) < least or len(ids) <= placed(table) or BLOCKED in slots:
            return None
        where = list[Point]()
        for j in ids:
            _, here, mark = self.known[j]
            flown = 0.0 if self._large else mission.max_step * (self._round - self._heard_in[j])
            where.append(
                _round_point(towards(here, plan.points[slots[j]], flown)) if flown and j in slots else mark or here
            )
            if self.waiting and not mark:
                return None
        digest = hashlib.blake2b(msgspec.msgpack.encode((ids, where)), digest_size=2).digest()
        version = VERSION * len(ids) + VERSION // DIGESTS * int.from_bytes(digest)
        return version, tuple(ids), tuple(where)


def placed(table: BidTable | None) -> int:
    """Number of robots in the joint assignment of a table, including those for which no place was left."""
    return max(table or ((0, 0.0, NO_OWNER),))[0] // VERSION


def _round_point(point: Point) -> Point:
    return tuple(round(x, DECIMALS) for x in point)


@lru_cache(maxsize=64)
def optimal_assignment(
    plan: Plan, positions: TeamPositions, roadmap: Roadmap | None = None, preferences: Mission | None = None
) -> BidTable:
    """The bid table with the smallest sum of squared ways, as the mission's `preferences` count them.

    Robots or slots may be left over.
    """
    version, ids, places = positions
    distances = np.array([ways(place, plan.array, roadmap) for place in places])
    cost = distances**2 if preferences is None else costs(preferences, plan, ids, np.array(places), distances)
    table = [(version, 0.0, NO_OWNER)] * len(plan)
    for row, slot in zip(*scipy.optimize.linear_sum_assignment(cost), strict=True):
        table[slot] = (version, 0.0, ids[row])
    return tuple(table)


def given_jointly(table: BidTable | None, slot: int | None) -> bool:
    """Whether a slot was given by a joint assignment, or exchanged since."""
    return table is not None and slot is not None and table[slot][0] >= VERSION


def flown_straight(table: BidTable | None, slot: int | None) -> bool:
    """Whether a slot given jointly is exchanged by straight distances, as in a large team, not along the formation."""
    return given_jointly(table, slot) and table is not None and len(table) > MANY
