"""The roll call of a large team: once everybody is known, it takes its places at one stroke.

Auctions and exchanges find good places for a few robots in a few communication rounds. In a large team many robots want
the same near places, and what is settled exchange by exchange is settled while they fly. So every robot of a large team
says where it is, and passes on what it hears. Who knows that of everybody works out which assignment has the smallest
sum of squared ways, as C-CAPT does in one place (Turpin, Michael, Kumar: CAPT: Concurrent assignment and planning of
trajectories for multiple robots, IJRR 2014), and writes it in its table. All who do so have the same positions and
write the same; the others hear of it as of any claim.

The roll is called twice. In the first rounds of a mission everybody says where it was when the mission came; a team in
pieces never completes that. Its robots then wait for each other (`llm_flock.protocol.membership.rendezvous`), and
everybody says where it came to wait.

Nothing depends on it: a table is merged as any other table, and whoever still finds itself on no place, or on several,
does what it always does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.optimize import linear_sum_assignment

from llm_flock.arrays import Point
from llm_flock.protocol.membership.search import MANY
from llm_flock.protocol.messages.message import LAST_ROUND, NO_OWNER, BidTable, PositionReport, TeamPositions
from llm_flock.protocol.plan import Plan

ROUNDS = 8
"""Rounds of a mission in which its first roll is called; later on the positions are no longer true."""

SECOND = 0.15
"""The second call takes where everybody waits in the round that is this share of the team size; by then most robots of
a ring have come to its circle, and those who are still on their way are expected where they will come to it."""

VERSION = 1024
"""Version of the claims that come of the first call: above all that were made before. Those of the second call have
twice that."""

LARGEST = 256
"""Larger teams call the roll at the beginning of a mission only: what everybody says anew all the time grows with the
square of their number."""

DECIMALS = 2
"""Positions are said to so many."""

MOVED = 0.1
"""Who waits says anew where it is when it has moved by this share of the spacing."""

PATIENCE = 16
"""Rounds that a robot waits without news of anybody who was unknown."""


class AllToAll:
    """What one robot knows of where everybody is.

    Args:
        robot: own id.
        n_robots: team size N; up to `MANY` robots call no roll.
    """

    def __init__(self, robot: int, n_robots: int) -> None:
        self._robot = robot
        self._n = n_robots
        self.large = n_robots > MANY
        """Whether a team of this size calls a roll at all."""
        self.begin()

    def begin(self) -> None:
        """A mission has come: its roll is called anew."""
        self._known: dict[int, PositionReport] = {}
        self._news: dict[int, PositionReport] = {}
        self._round = 0
        self._waited = 0
        self._taken: str | None = None
        self._look_at_the_round()

    def _look_at_the_round(self) -> None:
        """Which roll is called; asked for with every message, so it is worked out when it may change."""
        self._later = self._round > ROUNDS
        self.waiting = self._later and self.large and self._n <= LARGEST and self._waited <= PATIENCE
        """Whether those who are not known yet are waited for."""
        self.called = self.waiting or (self.large and not self._later)
        """Whether a roll call is under way."""

    @property
    def known(self) -> Mapping[int, PositionReport]:
        """What is known of each robot, by id."""
        return self._known

    @property
    def others(self) -> list[Point]:
        """Where the others are that are known [units; frame of the mission]."""
        return [where for robot, (_, where, _) in self._known.items() if robot != self._robot]

    def begin_round(self) -> None:
        """Another round has begun."""
        self._round += 1
        self._look_at_the_round()
        if self._round == ROUNDS + 1 or not self.called:
            self._known, self._news = {}, {}

    def wait(self, *, there: bool) -> None:
        """Another round is waited for those who are not known yet.

        Args:
            there: whether the robot has come to where it waits.
        """
        self._waited += there
        self._look_at_the_round()

    def hear(self, said: Mapping[int, PositionReport]) -> None:
        """Take in what a neighbour knows."""
        if not self.called:
            return
        known, later = self._known, self._later
        if not later and said.keys() <= known.keys():
            return  # the first call takes down everybody once: who knows all of them need not look inside
        new = {
            robot: seen
            for robot, seen in said.items()
            if (robot not in known or seen[0] > known[robot][0]) and later == (seen[0] > 0)
        }
        if new:
            if not new.keys() <= known.keys():
                self._waited = 0
                self._look_at_the_round()
            known |= new
            self._news |= new

    def complete(self, plan: Plan) -> TeamPositions | None:
        """Where everybody is, once for each plan, when a call is complete."""
        known, later = self._known, self._later
        if not self.called or len(known) < self._n or self._taken == plan.digest:
            return None
        if later and not all(mark for _, _, mark in known.values()):
            return None
        self._taken = plan.digest
        seen = [known[robot] for robot in range(self._n)]
        return (2 * VERSION, tuple(mark for _, _, mark in seen)) if later else (VERSION, tuple(x for _, x, _ in seen))

    def say(
        self, position: Point, *, waits_at: Point | None, greeting: bool, settled: bool, spacing: float
    ) -> dict[int, PositionReport] | None:
        """What to tell the neighbours: all that is known once a round, then what is new; None for nothing.

        Args:
            position: own believed position [units; frame of the mission].
            waits_at: where this robot waits, or comes to wait; None where it does not [units; frame of the mission].
            greeting: whether this is the first broadcast of a round.
            settled: whether the own place was given by a roll call; then nobody needs the second.
            spacing: wanted distance between neighbouring robots [units].
        """
        mine = self._known.get(self._robot)
        if self._later:
            if not self.called or settled or waits_at is None:
                return None
            self._tell(mine, _rounded(waits_at), MOVED * spacing)
        elif self.called:
            self.hear({self._robot: (0, _rounded(position), ())})
        said, self._news = dict(self._known if greeting else self._news), {}
        return said or None

    def _tell(self, mine: PositionReport | None, here: Point, moved: float) -> None:
        """Say anew where this robot waits, if that has changed, and what to take down for the second call."""
        stamp, before, mark = mine or (0, (), ())
        due = not mark and self._round > SECOND * self._n
        if due or not before or math.dist(here, before) > moved:
            # Who was restarted, and hears of its former life, counts on from there.
            self.hear({self._robot: (min(max(self._round, stamp + 1), LAST_ROUND), here, here if due else mark)})


def _rounded(point: Point) -> Point:
    return tuple(round(x, DECIMALS) for x in point)


@lru_cache(maxsize=64)
def assigned(plan: Plan, roll: TeamPositions) -> BidTable:
    """The claims that make the sum of the squared ways as small as can be.

    With more robots than places some get none; with fewer, some places stay free.

    Args:
        plan: has the places.
        roll: where each robot is.
    """
    version, places = roll
    ways = np.linalg.norm(np.array(places)[:, None] - plan.array[None], axis=2)
    table = [(version, 0.0, NO_OWNER)] * len(plan)
    for robot, slot in zip(*linear_sum_assignment(ways**2), strict=True):
        table[slot] = (version, float(-ways[robot, slot].round(DECIMALS)), int(robot))
    return tuple(table)


def given_all_to_all(table: BidTable | None, slot: int | None) -> bool:
    """Whether a place was given by a roll call, or exchanged since."""
    return table is not None and slot is not None and table[slot][0] >= VERSION
