"""Which robots are alive: heartbeats that every robot passes on, merged by the element-wise maximum.

A gossip-style failure detector (van Renesse, Minsky, Hayden, Middleware 1998). A silent robot may still be alive.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

CANNOT_FLY, NO_PLAN = 1, 2  # flags in a heartbeat: geometry flies the robot; the robot follows no plan
PER_BEAT = 4  # a heartbeat is the own count times this, plus the flags: the greater of two is the newer one
BODY = 1  # heartbeat of a robot of which only the body was sensed; lower than that of any robot awake
FEW = 20  # in a team of at most this size, heartbeats reach every robot well within the time-out
ROUNDS_PER_ROBOT = 0.6  # more rounds of time-out for each further robot: heartbeats travel one hop a round
GAP_WEIGHT = 0.1  # weight of the newest gap between two heartbeats of a robot in their average
GAPS = 8.0  # rounds of time-out for each round usually missed between heartbeats (phi accrual, Hayashibara 2004)
MAX_TIME_OUT = 5  # longest time-out, as a multiple of the configured one


def patience(time_out: int, n_robots: int) -> int:
    """Rounds without a heartbeat after which a robot of a team of this size counts as dead."""
    return time_out + int(ROUNDS_PER_ROBOT * max(0, n_robots - FEW))


class Liveness:
    """The heartbeats known to one robot. Those of `silent` robots have stopped; `strangers` never had any."""

    def __init__(self, robot: int, n_robots: int, time_out: int) -> None:
        self._robot = robot
        self.time_out = patience(time_out, n_robots)
        self._beats = np.zeros(n_robots, dtype=np.int64)
        self._advanced = np.full(n_robots, -1, dtype=np.int64)
        self._gap = np.ones(n_robots)
        self._counted_on = np.zeros(n_robots, dtype=np.bool_)
        self._beats[robot] = BODY
        self._round = 0
        self._mute_for: dict[int, int] = {}
        self.silent: frozenset[int] = frozenset()
        self.strangers: frozenset[int] = frozenset(range(n_robots)) - {robot}

    @property
    def beats(self) -> tuple[int, ...]:
        return tuple(self._beats.tolist())

    @property
    def alive(self) -> int:
        return len(self._beats) - len(self.silent) - len(self.strangers)

    @property
    def present(self) -> frozenset[int]:
        """Robots that count as alive, this one included."""
        return frozenset(range(len(self._beats))) - self.silent - self.strangers

    @property
    def living(self) -> frozenset[int]:
        """Robots whose counter was heard to advance, and that are not silent. A first count may be of a dead robot."""
        return frozenset(np.flatnonzero(self._counted_on).tolist()) - self.silent

    @property
    def without_plan(self) -> frozenset[int]:
        """Other robots that followed no plan when they were last heard of."""
        matches = (self._beats >= PER_BEAT) & (self._beats & NO_PLAN != 0)
        return frozenset(np.flatnonzero(matches).tolist()) - {self._robot}

    def begin_round(self, round_number: int, near: frozenset[int], state: int = 0) -> None:
        """Count a heartbeat with its state, and find counters that stood still; `near` are sensed in radio range."""
        self._round = round_number
        self._beats[self._robot] = (self._beats[self._robot] // PER_BEAT + 1) * PER_BEAT + state
        self._advanced[self._robot] = round_number
        self._mute_for = {j: self._mute_for.get(j, 0) + 1 for j in near & self.strangers}
        mute = [j for j, rounds in self._mute_for.items() if rounds > self.time_out]
        if mute:
            self._beats[mute] = BODY
            self._advanced[mute] = self._long_ago
        self._look()

    def hear(self, heard: Sequence[NDArray[np.int64]]) -> None:
        """Merge counters, each of shape (N,). After a restart, the own counter continues from its earlier value."""
        if not heard:
            return
        highest = heard[0]
        for beats in heard[1:]:
            highest = np.maximum(highest, beats)
        mine = int(highest[self._robot])
        if mine > self._beats[self._robot]:
            self._beats[self._robot] = (mine // PER_BEAT + 1) * PER_BEAT + self._beats[self._robot] % PER_BEAT
        newer = highest > self._beats
        if not newer.any():
            return
        known = newer & (self._beats > BODY)
        gaps = self._round - self._advanced[known]
        self._gap[known] += GAP_WEIGHT * (np.minimum(gaps, MAX_TIME_OUT * self.time_out) - self._gap[known])
        self._advanced[newer] = self._round
        if self.strangers:  # some may be known by their bodies only
            self._advanced[newer & (highest == BODY)] = self._long_ago
        self._counted_on |= known
        self._beats[newer] = highest[newer]
        self._look()

    @property
    def _long_ago(self) -> int:
        return self._round - MAX_TIME_OUT * self.time_out - 1

    def _look(self) -> None:
        since = self._round - self._advanced
        if not (self.strangers or self.silent) and since.max() <= self.time_out:
            return
        never = self._beats == 0
        allowed = np.minimum(self.time_out + GAPS * (self._gap - 1.0), MAX_TIME_OUT * self.time_out)
        late = ~never & (since > allowed)
        if late.any() or self.silent:
            self.silent = frozenset(np.flatnonzero(late).tolist())
        if self.strangers:
            self.strangers = frozenset(np.flatnonzero(never).tolist())
