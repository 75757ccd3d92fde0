"""Enforces the ranges of radio and sensors. Nothing else does: a network of processes reaches every robot.

A real radio replaces `Radio.carries`, and real sensors replace `Radio.frame`. Sensors take precedence: a beacon counts
only while the sensors could not have seen the body.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from llm_flock.arrays import Point
from llm_flock.links import LinkFaults
from llm_flock.mission import Mission
from llm_flock.protocol._motion.shield_async import Sighting

FRESH_BEACONS = 5.0  # largest age of a neighbour's last beacon, in beacon periods


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Position of a body at one time, by the wall clock [s]."""

    stamp: float
    position: Point


class Radio:
    """The messages and sensor readings of one robot, within the ranges of the mission.

    Faults are injected by `rng`, their `delay` in units of `delay_s`. `clock_error_s` is the largest difference between
    two wall clocks of the swarm, `speed` the largest of a body [units/s]. `contradicted` counts beacons that the
    sensors refuted.
    """

    def __init__(
        self,
        robot: int,
        mission: Mission,
        *,
        faults: LinkFaults,
        rng: np.random.Generator,
        beacon_s: float,
        delay_s: float,
        clock_error_s: float,
        speed: float,
    ) -> None:
        self.position: Point | None = None
        self.contradicted = 0
        self.cut: frozenset[int] = frozenset()
        self._robot = robot
        self._reach = mission.comm_range
        self._sight = mission.sensing
        self._faults = faults
        self._rng = rng
        self._fresh_s = FRESH_BEACONS * beacon_s
        self._delay_s = delay_s
        self._speed = speed
        self._clock_error_s = clock_error_s
        self._lost: dict[int, bool] = {}
        self._beacons: dict[int, Seen] = {}
        self._heard: dict[int, Seen] = {}
        self._sensed: dict[int, Seen] = {}
        self._read_s = -math.inf

    def carries(self, sender: int) -> bool:
        """Whether a radio would carry a message of this sender to this robot now, by their positions."""
        there = self._beacons.get(sender)
        if self.position is None or there is None or sender in self.cut:
            return False
        return math.dist(self.position, there.position) <= self._reach

    def deliver(
        self, sender: int, hand_over: Callable[[], None], later: Callable[[float, Callable[[], None]], object]
    ) -> None:
        """Hand a message over if the radio carries it. Injected faults drop it, repeat it, or hand it over `later`."""
        faults, rng = self._faults, self._rng
        if not self.carries(sender):
            return
        if not faults.any:
            hand_over()
            return
        copies = 1 + int(rng.random() < faults.duplicate)
        for _ in range(copies):
            self._lost[sender] = faults.is_lost(self._lost.get(sender, False), rng)
            if self._lost[sender]:
                continue
            delay_s = rng.uniform(0.0, faults.delay * self._delay_s)
            if delay_s > 0.0:
                later(delay_s, hand_over)
            else:
                hand_over()

    def place(self, sender: int, beacon: Seen) -> None:
        """Set a sender's position, for `carries` only: the robot itself does not learn it."""
        self._beacons[sender] = beacon

    def beacon(self, sender: int, beacon: Seen) -> None:
        """Take a beacon that the radio carried."""
        known = self._heard.get(sender)
        if known is None or beacon.stamp > known.stamp:
            self._heard[sender] = beacon
            self.contradicted += self._refutes(sender, beacon)

    def _refutes(self, sender: int, beacon: Seen) -> bool:
        """Whether the last reading of the sensors disproves the position in a beacon."""
        if self.position is None:
            return False
        # An honest beacon holds the position of a reading that may be as old as a beacon period.
        flown = self._speed * (abs(beacon.stamp - self._read_s) + self._fresh_s / FRESH_BEACONS + self._clock_error_s)
        sighting = self._sensed.get(sender)
        if sighting is not None:
            return math.dist(sighting.position, beacon.position) > flown
        return math.dist(self.position, beacon.position) < self._sight - flown

    def frame(self, stamp: float, positions: Sequence[Point]) -> None:
        """Take a reading of the sensors: the own position, and those of bodies within sensing range."""
        here = self.position = positions[self._robot]
        self._read_s = stamp
        for j, there in enumerate(positions):
            if j != self._robot and math.dist(here, there) <= self._sight:
                self._sensed[j] = Seen(stamp=stamp, position=there)
            else:
                self._sensed.pop(j, None)

    def neighbors(self, now: float) -> int:
        """Number of robots heard within radio range, |N_i|."""
        here = self.position
        if here is None:
            return 0
        fresh = (seen for seen in self._heard.values() if now - seen.stamp <= self._fresh_s)
        return sum(math.dist(here, seen.position) <= self._reach for seen in fresh)

    def sensed(self) -> dict[int, Point]:
        """Positions of the bodies in sight, by id."""
        return {j: self._sensed[j].position for j in sorted(self._sensed)}

    def sightings(self, now: float) -> list[Sighting]:
        """Last known positions of all bodies that may be near, with their ages, for the shield.

        A body in sight is where the sensors saw it. For one out of sight, a beacon since the last reading counts,
        unless the sensors would have seen the body there. All others were out of sight `unseen_s` ago.
        """
        heard = (
            seen
            for j, seen in self._heard.items()
            if j not in self._sensed and seen.stamp >= self._read_s and not self._refutes(j, seen)
        )
        return [
            Sighting(position=seen.position, age_s=max(0.0, now - seen.stamp) + self._clock_error_s)
            for seen in (*self._sensed.values(), *heard)
        ]

    def forget_beacons(self) -> None:
        """Forget the beacons of other robots."""
        self._heard.clear()

    def unseen_s(self, now: float) -> float:
        """Age of the last reading [s]: bodies that are not among the sightings were out of sight then."""
        return max(0.0, now - self._read_s) + self._clock_error_s
