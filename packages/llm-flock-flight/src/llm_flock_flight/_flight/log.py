"""Records a flight: events, samples of every drone, and measurements over both."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from llm_flock.arrays import flattened
from llm_flock.record import BodySample, FlightEvent, RecordSink
from llm_flock.robots import RobotState, Segment
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.lag import Tracking

SAMPLE_S = 0.1  # time between two samples in the record [s]


class FlightLog:
    """Writes the entries of a record that only flights have, and keeps measurements over drones in the air.

    `nearest_m` is the smallest distance of a drone in the air from another one, by the drones' own estimates.
    """

    def __init__(self, config: FlightConfig, sink: RecordSink) -> None:
        self.round = 0
        self.nearest_m, self.worst_m = math.inf, 0.0
        self.squares, self.counted = 0.0, 0
        self._lags: dict[float, tuple[float, float]] = {}  # by the start of a motion: weighted delays, and weights
        self.fan_outs_s: list[float] = []
        self._safety = config.safety
        self._sink = sink
        self._began = time.monotonic()
        self._sampled = -math.inf

    @property
    def lag_s(self) -> float:
        """Longest delay of a round's motion [s].

        That of a motion is the mean of its delays by the squared speeds of the set-points: one that rests tells none.
        """
        return max((delays / weights for delays, weights in self._lags.values() if weights > 0.0), default=0.0)

    def note(self, kind: str, robot: int | None = None, **detail: Any) -> None:
        seconds = round(time.monotonic() - self._began, 3)
        self._sink.write(FlightEvent(round=self.round, time_s=seconds, kind=kind, robot=robot, detail=detail))

    def look(
        self,
        now_s: float,
        states: Sequence[RobotState],
        motions: Sequence[Segment],
        airborne: frozenset[int],
        aloft: frozenset[int],
        tracking: Tracking,
    ) -> None:
        """Measure all drones, those `aloft` until they are down; every `SAMPLE_S` also record them."""
        commanded = [motion.at(state.stamp_s)[0] for state, motion in zip(states, motions, strict=True)]
        for robot in airborne:
            off = tracking.off_m[robot]
            self.worst_m = max(self.worst_m, off)
            self.squares += off * off
            self.counted += 1
            motion, delay_s = motions[robot], tracking.delay_s[robot]
            if self.round and math.dist(motion.start, motion.target) > self._safety.tracking_m:
                weight = math.hypot(*motion.at(states[robot].stamp_s - delay_s)[1]) ** 2
                delays, weights = self._lags.get(motion.began_s, (0.0, 0.0))
                self._lags[motion.began_s] = (delays + weight * delay_s, weights + weight)
        places = flattened([state.position for state in states], self._safety.downwash)
        for robot in aloft:  # from each other, and from those that stand
            others = np.delete(places, robot, axis=0)
            self.nearest_m = min(self.nearest_m, *np.linalg.norm(others - places[robot], axis=1).tolist(), math.inf)
        if now_s - self._sampled >= SAMPLE_S:
            self._sampled = now_s
            sample = BodySample(
                round=self.round,
                time_s=round(now_s - self._began, 3),
                measured=[[round(x, 4) for x in state.position] for state in states],
                commanded=[[round(x, 4) for x in point] for point in commanded],
                flying=[state.flying for state in states],
                battery_v=[state.battery_v for state in states],
                link=[0.0 if state.link_lost else state.link for state in states],
            )
            self._sink.write(sample)
