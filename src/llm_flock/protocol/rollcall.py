"""A roll call at the beginning of a mission: a large team that is in contact takes its places at one stroke.

Auctions and exchanges find good places for a few robots in a few ticks. In a large team many robots want the same near
places, and what is settled exchange by exchange is settled while they fly. So in the first rounds of a mission every
robot of a large team says where it was when the mission came, and passes on what it hears. Who knows that of everybody
works out which assignment has the smallest sum of squared ways, as C-CAPT does in one place (Turpin, Michael, Kumar:
CAPT: Concurrent assignment and planning of trajectories for multiple robots, IJRR 2014), and writes it in its table.
All who do so have the same positions and write the same; the others hear of it as of any claim. A team in pieces never
completes the call, and bids as ever.

Nothing depends on it: a table is merged as any other table, and whoever still finds itself on no place, or on several,
does what it always does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from scipy.optimize import linear_sum_assignment

from llm_flock.arrays import Point
from llm_flock.protocol.messages import NO_OWNER, Table
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.search import MANY

ROUNDS = 8
"""Rounds of a mission in which its roll is called; later on the positions are no longer true."""

VERSION = 1024
"""Version of the claims that come of a roll call: above all that were made before."""

DECIMALS = 2
"""Positions are said to so many."""


class RollCall:
    """What one robot knows of where everybody was when the mission came.

    Args:
        robot: own id.
        n_robots: team size N; up to `MANY` robots call no roll.
    """

    def __init__(self, robot: int, n_robots: int) -> None:
        self._robot = robot
        self._n = n_robots
        self.begin()

    def begin(self) -> None:
        """A mission has come: its roll is called anew."""
        self._known: dict[int, Point] = {}
        self._news: dict[int, Point] = {}
        self._left = ROUNDS if self._n > MANY else 0
        self._places: tuple[Point, ...] | None = None
        self._taken: str | None = None

    def begin_round(self) -> None:
        """Another round has begun; after the last one nothing is known any more."""
        self._left -= 1
        if self._left < 0:
            self._known, self._news, self._places = {}, {}, None

    def hear(self, said: Mapping[int, Point]) -> None:
        """Take in what a neighbour knows [units; frame of the mission]."""
        if self._left < 0 or self._places is not None:
            return
        new = {robot: place for robot, place in said.items() if robot not in self._known}
        if new:
            self._known |= new
            self._news |= new
            if len(self._known) == self._n:
                self._places = tuple(self._known[robot] for robot in range(self._n))

    def places(self, plan: Plan) -> tuple[Point, ...] | None:
        """Where everybody was, by id [units; frame of the mission]: once for each plan, when the call is complete."""
        if self._places is None or self._taken == plan.digest:
            return None
        self._taken = plan.digest
        return self._places

    def say(self, position: Point, *, greeting: bool) -> dict[int, Point] | None:
        """What to tell the neighbours: all that is known once a round, what is new in every tick; None for nothing.

        Args:
            position: own believed position [units; frame of the mission].
            greeting: whether this is the first broadcast of a round.
        """
        if self._left < 0:
            return None
        self.hear({self._robot: tuple(round(x, DECIMALS) for x in position)})
        said, self._news = dict(self._known if greeting else self._news), {}
        return said or None


@lru_cache(maxsize=64)
def assigned(plan: Plan, places: Sequence[Point]) -> Table:
    """The claims that make the sum of the squared ways as small as can be.

    With more robots than places some get none; with fewer, some places stay free.

    Args:
        plan: has the places.
        places: where each robot is, by id [units; frame of the plan].
    """
    ways = np.linalg.norm(np.array(places)[:, None] - plan.array[None], axis=2)
    table = [(VERSION, 0.0, NO_OWNER)] * len(plan)
    for robot, slot in zip(*linear_sum_assignment(ways**2), strict=True):
        table[slot] = (VERSION, float(-ways[robot, slot].round(DECIMALS)), int(robot))
    return tuple(table)


def by_roll(table: Table | None, slot: int) -> bool:
    """Whether a place was given by a roll call, or exchanged since."""
    return table is not None and table[slot][0] >= VERSION
