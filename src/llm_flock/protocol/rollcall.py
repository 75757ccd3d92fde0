"""The roll call of a large team: once everybody is known, it takes its places at one stroke.

Auctions and exchanges find good places for a few robots in a few ticks. In a large team many robots want the same near
places, and what is settled exchange by exchange is settled while they fly. So every robot of a large team says where it
is, and passes on what it hears. Who knows that of everybody works out which assignment has the smallest sum of squared
ways, as C-CAPT does in one place (Turpin, Michael, Kumar: CAPT: Concurrent assignment and planning of trajectories for
multiple robots, IJRR 2014), and writes it in its table; the others hear of it as of any claim.

In the first rounds of a mission everybody says where it was when the mission came, so a team in contact has the same
positions and writes the same. A team that starts in pieces completes the call when the last piece is found. By then
everybody has moved, so later on robots say where they are now. Several may complete the call with positions of
different rounds; what comes of the oldest, which has spread farthest, has the highest version.

Nothing depends on it: a table is merged as any other table, and whoever still finds itself on no place, or on several,
does what it always does.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from scipy.optimize import linear_sum_assignment

from llm_flock.arrays import Point
from llm_flock.protocol.messages import LAST_STAMP, NO_OWNER, Sighting, Table
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.search import MANY

ROUNDS = 8
"""Rounds of a mission in which positions at its beginning are said; later on they are no longer true."""

VERSION = 1024
"""Claims of a roll call have versions from here on: above all that were made before."""

LARGEST = 256
"""Larger teams call the roll at the beginning of a mission only: what everybody says anew all the time grows with the
square of their number."""

KINDS = 16
"""Calls with equally old positions differ in version by fewer than so many steps, drawn from the positions."""

OLDEST = KINDS * LARGEST * LAST_STAMP
"""Steps from the version of the newest call to that of the oldest; a step is `VERSION`, so that places can be exchanged
without reaching the next one."""

DECIMALS = 2
"""Positions are said to so many."""

MOVED = 0.1
"""A robot says anew where it is when it has moved by this share of the spacing."""

PATIENCE = 16
"""Rounds that a robot waits where the team meets without news of anybody who was unknown."""


class RollCall:
    """What one robot knows of where everybody is.

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
        self._known: dict[int, Sighting] = {}
        self._news: dict[int, Sighting] = {}
        self._round = 0
        self._waited = 0
        self._taken: str | None = None

    @property
    def known(self) -> Mapping[int, Sighting]:
        """Where each robot was when it last said so, by id."""
        return self._known

    @property
    def waiting(self) -> bool:
        """Whether those who are not known yet are waited for."""
        return self._round > ROUNDS and self._called and self._waited <= PATIENCE

    @property
    def _called(self) -> bool:
        return MANY < self._n and (self._n <= LARGEST or self._round <= ROUNDS)

    def begin_round(self) -> None:
        """Another round has begun."""
        self._round += 1
        if not self._called:
            self._known, self._news = {}, {}

    def waits(self, *, there: bool) -> bool:
        """Whether to wait, where the team meets, for those who are not known yet; ask once a round.

        Args:
            there: whether the robot has come to where it waits.
        """
        waiting = self.waiting
        self._waited += waiting and there
        return waiting

    def hear(self, said: Mapping[int, Sighting]) -> None:
        """Take in what a neighbour knows."""
        if not self._called:
            return
        known = self._known
        new = {robot: seen for robot, seen in said.items() if robot not in known or seen[0] > known[robot][0]}
        if new:
            if self._waited <= PATIENCE and not new.keys() <= known.keys():
                self._waited = 0
            known |= new
            self._news |= new

    def sightings(self, plan: Plan, table: Table | None) -> tuple[Sighting, ...] | None:
        """Where everybody is, by id: once for each plan, when the call is complete and nobody else has completed it.

        Args:
            plan: the plan that is followed.
            table: all claims known on it.
        """
        if len(self._known) < self._n or self._taken == plan.digest or not self._called:
            return None
        self._taken = plan.digest
        if self._round > ROUNDS and table is not None and any(entry[0] >= VERSION for entry in table):
            return None
        return tuple(self._known[robot] for robot in range(self._n))

    def say(
        self, position: Point, *, greeting: bool, settled: bool, spacing: float
    ) -> dict[int, Sighting] | None:
        """What to tell the neighbours: all that is known once a round, what is new in every tick; None for nothing.

        Args:
            position: own believed position [units; frame of the mission].
            greeting: whether this is the first broadcast of a round.
            settled: whether the own place was given by a roll call; then nobody needs another.
            spacing: wanted distance between neighbouring robots [units].
        """
        later = self._round > ROUNDS
        if not self._called or (later and settled):
            return None
        mine = self._known.get(self._robot)
        if mine is None or (later and math.dist(position, mine[1]) > MOVED * spacing):
            stamp = 0 if mine is None and not later else max(self._round, mine[0] + 1 if mine else 0)
            here = tuple(round(x, DECIMALS) for x in position)
            self.hear({self._robot: (min(stamp, LAST_STAMP), here)})
        said, self._news = dict(self._known if greeting else self._news), {}
        return said or None


@lru_cache(maxsize=64)
def assigned(plan: Plan, sightings: Sequence[Sighting]) -> Table:
    """The claims that make the sum of the squared ways as small as can be.

    With more robots than places some get none; with fewer, some places stay free.

    Args:
        plan: has the places.
        sightings: where each robot is, by id.
    """
    places = tuple(place for _, place in sightings)
    news = sum(stamp for stamp, _ in sightings)
    kind = zlib.crc32(repr(places).encode()) % KINDS
    version = VERSION * (OLDEST - (KINDS * news - kind if news else 0))
    ways = np.linalg.norm(np.array(places)[:, None] - plan.array[None], axis=2)
    table = [(version, 0.0, NO_OWNER)] * len(plan)
    for robot, slot in zip(*linear_sum_assignment(ways**2), strict=True):
        table[slot] = (version, float(-ways[robot, slot].round(DECIMALS)), int(robot))
    return tuple(table)


def by_roll(table: Table | None, slot: int | None) -> bool:
    """Whether a place was given by a roll call, or exchanged since."""
    return table is not None and slot is not None and table[slot][0] >= VERSION
