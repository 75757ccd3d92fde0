"""All-to-all assignment: a large team collects the positions of all its robots and assigns all slots at once.

Auctions and exchanges find good slots for a few robots in a few communication rounds. In a large team many robots want
the same near slots, and exchanges settle while the robots already fly. So each robot of a large team reports its
position and passes on the positions it hears. A robot that knows all positions computes the assignment with the
smallest sum of squared distances, as C-CAPT does in one place (Turpin, Michael, Kumar: CAPT: Concurrent assignment and
planning of trajectories for multiple robots, IJRR 2014), and writes it into its bid table. All robots that do so have
the same positions and write the same table; the others merge it like any claim.

There are two collections. The first takes the positions at the start of the mission; a team in pieces cannot complete
it. Its robots then wait for each other (`llm_flock.protocol.membership.rendezvous`), and the second collection takes
the positions at which they wait.

Nothing depends on it: the table is merged like any other, and a robot without a slot, or with several, proceeds as
usual.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import scipy

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.membership.rendezvous import landing
from llm_flock.protocol.membership.search import MANY
from llm_flock.protocol.messages.message import LAST_ROUND, NO_OWNER, BidTable, PositionReport, TeamPositions
from llm_flock.protocol.path_length import ways
from llm_flock.protocol.plan import Plan
from llm_flock.roadmap import Roadmap

ROUNDS = 8
"""Rounds of a mission in which the first collection runs; after that the positions are out of date."""

SECOND = 0.15
"""The second collection takes waiting positions in the round that is this share of the team size. By then most robots
of a ring have reached its circle, and for the others it takes the point at which they will reach it."""

VERSION = 1024
"""Version of the claims that follow from the first collection, above all earlier claims. The second has twice that."""

LARGEST = 256
"""Larger teams have the first collection only: the traffic of the second grows with the square of the team size."""

DECIMALS = 2
"""Decimals of reported positions."""

MOVED = 0.1
"""A waiting robot reports its position again when it has moved by this share of the spacing."""

PATIENCE = 16
"""Rounds that a robot waits without news of a robot that was unknown."""


class AllToAll:
    """The positions of the team that one robot knows.

    Teams of up to `MANY` robots collect nothing, nor do teams with keys (`enabled` is false): reports are not signed.
    """

    def __init__(self, robot: int, n_robots: int, *, enabled: bool = True) -> None:
        self._robot, self._n = robot, n_robots
        self.large = enabled and n_robots > MANY
        """Whether a team of this size collects positions at all."""
        self.begin()

    def begin(self) -> None:
        """Start with the first collection. Call for each mission."""
        self.known: dict[int, PositionReport] = {}
        """The newest report of each robot, by id."""
        self._news: dict[int, PositionReport] = {}
        self._round = 0
        self._waited = 0
        self._taken: str | None = None
        self._choose_collection()

    def _choose_collection(self) -> None:
        self._second = self._round > ROUNDS
        self.waiting = self._second and self.large and self._n <= LARGEST and self._waited <= PATIENCE
        """Whether the second collection runs, and robots wait for those that are unknown."""
        self.collecting = self.waiting or (self.large and not self._second)
        """Whether a collection runs."""

    @property
    def others(self) -> list[Point]:
        """Known positions of other robots [units; frame of the mission]."""
        return [where for robot, (_, where, _) in self.known.items() if robot != self._robot]

    def begin_round(self) -> None:
        """Count a round."""
        self._round += 1
        self._choose_collection()
        if self._round == ROUNDS + 1 or not self.collecting:
            self.known, self._news = {}, {}

    def wait(self, *, there: bool) -> None:
        """Count a round of waiting; `there` says whether the robot has reached the point where it waits."""
        self._waited += there
        self._choose_collection()

    def hear(self, reports: Mapping[int, PositionReport]) -> None:
        """Merge the reports that a neighbour knows."""
        if not self.collecting:
            return
        known, second = self.known, self._second
        if not second and (len(known) == self._n or reports.keys() <= known.keys()):
            return  # the first collection takes one report of each robot
        new = {
            robot: report
            for robot, report in reports.items()
            if (robot not in known or report[0] > known[robot][0]) and second == (report[0] > 0)
        }
        if new:
            if not new.keys() <= known.keys():
                self._waited = 0
                self._choose_collection()
            known |= new
            self._news |= new

    def complete(self, plan: Plan) -> TeamPositions | None:
        """The position of every robot, once for each plan, when a collection is complete."""
        known, second = self.known, self._second
        if not self.collecting or len(known) < self._n or self._taken == plan.digest:
            return None
        if second and not all(mark for _, _, mark in known.values()):
            return None
        self._taken = plan.digest
        reports = [known[robot] for robot in range(self._n)]
        ids = tuple(range(self._n))
        if second:
            return 2 * VERSION, ids, tuple(mark for _, _, mark in reports)
        return VERSION, ids, tuple(where for _, where, _ in reports)

    def report(
        self, mission: Mission, plan: Plan | None, position: Point, *, settled: bool, greeting: bool
    ) -> dict[int, PositionReport] | None:
        """The reports to broadcast: all that are known in the `greeting`, which is the first broadcast of a round.

        Then only new ones; also in greetings once the first collection was complete, because neighbours that lack some
        get the table that follows from it. Call while collecting, with the own position [units; frame of the mission].
        A robot is `settled` if its slot is from a joint assignment; it needs no second collection.
        """
        if not self._second:
            self.hear({self._robot: (0, _rounded(position), ())})
        else:
            point = None if plan is None else landing(mission, plan, position)
            if point is None or settled:
                return None
            self._report_waiting(_rounded(point), MOVED * mission.spacing)
        repeated = greeting and (self._second or self._taken is None)
        reports, self._news = dict(self.known if repeated else self._news), {}
        return reports or None

    def _report_waiting(self, here: Point, moved: float) -> None:
        """Report the waiting position if it has changed, and mark it for the second collection when that is due."""
        stamp, before, mark = self.known.get(self._robot, (0, (), ()))
        due = not mark and self._round > SECOND * self._n
        if due or not before or math.dist(here, before) > moved:
            # A robot that was restarted, and hears of its former life, counts on from there.
            self.hear({self._robot: (min(max(self._round, stamp + 1), LAST_ROUND), here, here if due else mark)})


def _rounded(point: Point) -> Point:
    return tuple(round(x, DECIMALS) for x in point)


@lru_cache(maxsize=64)
def optimal_assignment(plan: Plan, positions: TeamPositions, roadmap: Roadmap | None = None) -> BidTable:
    """The bid table with the smallest sum of squared lengths of ways, round obstacles where there is a roadmap.

    With more robots than places some robots get no slot; with fewer, some slots stay free.
    """
    version, ids, places = positions
    distances = np.array([ways(place, plan.array, roadmap) for place in places])
    table = [(version, 0.0, NO_OWNER)] * len(plan)
    for row, slot in zip(*scipy.optimize.linear_sum_assignment(distances**2), strict=True):
        table[slot] = (version, 0.0, ids[row])
    return tuple(table)


def given_all_to_all(table: BidTable | None, slot: int | None) -> bool:
    """Whether a slot was given by an all-to-all assignment, or exchanged since."""
    return given_jointly(table, slot) and table is not None and slot is not None and table[slot][0] < 3 * VERSION


def given_jointly(table: BidTable | None, slot: int | None) -> bool:
    """Whether a slot was given by any joint assignment, or exchanged since."""
    return table is not None and slot is not None and table[slot][0] >= VERSION
