"""The lag of a team behind its set-points, and the distance of each drone from its set-point of that time.

A controller without feed-forward follows a moving set-point at a distance. Drones that lag alike are still in step:
each is where its own set-point was some time ago, the same time for all, and then the set-points were apart. So the
distance that counts is that from the set-point *then* (docs/explanation/decisions/0020-lag-in-step.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from llm_flock.robots import Equipment, Position, RobotState, Segment, share
from llm_flock_flight._flight.config import FlightConfig

LAG_FACTOR = 1.5
LAG_MARGIN_S = 0.25
"""The longest delay allowed is that expected of the controller, times the factor, plus the margin [s]: the loops below
the position's add to it, and estimates arrive late."""

TRIES = 17  # delays tried at once, twice: the step is 1/128 of the longest one


def lag_bound_s(config: FlightConfig, equipment: Iterable[Equipment]) -> float:
    """The longest delay of a healthy team behind its set-points: of the flight file, or by its controllers [s]."""
    if config.safety.lag_s is not None:
        return config.safety.lag_s
    return LAG_MARGIN_S + LAG_FACTOR * max((each.lag_s or 0.0 for each in equipment), default=0.0)


def distance_m(config: FlightConfig, a: Position, b: Position) -> float:
    """Distance with heights scaled so that `height_tracking_m` counts as `tracking_m` [m]."""
    weight = config.safety.tracking_m / config.height_tracking_m
    return math.hypot(math.dist(a[:2], b[:2]), weight * (a[2] - b[2]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracking:
    """Of each robot: its delay [s], its set-point that long ago [m], and how far it was from there by `distance_m`."""

    delay_s: tuple[float, ...]
    expected: tuple[Position, ...]
    off_m: tuple[float, ...]


class LagTracker:
    """Finds the delay of each joint motion. Reads no clock."""

    def __init__(self, config: FlightConfig) -> None:
        self._config = config
        self._scale = np.array([1.0, 1.0, config.safety.tracking_m / config.height_tracking_m])

    def look(self, states: Sequence[RobotState], motions: Sequence[Segment], robots: Iterable[int]) -> Tracking:
        """Compare all estimates with their motions; those of `robots` that began a motion together have one delay."""
        n = len(states)
        together: dict[tuple[float, float], list[int]] = {}
        for robot in sorted(robots):
            together.setdefault((motions[robot].began_s, motions[robot].duration_s), []).append(robot)
        most_s = lag_bound_s(self._config, (state.equipment for state in states))
        delays = [0.0] * n
        for group in together.values():
            delay_s = self._common(states, motions, group, most_s)
            for robot in group:
                delays[robot] = delay_s
        expected = tuple(
            motion.at(state.stamp_s - delay_s)[0]
            for state, motion, delay_s in zip(states, motions, delays, strict=True)
        )
        off = [distance_m(self._config, state.position, place) for state, place in zip(states, expected, strict=True)]
        return Tracking(delay_s=tuple(delays), expected=expected, off_m=tuple(off))

    def _common(
        self, states: Sequence[RobotState], motions: Sequence[Segment], group: Sequence[int], most_s: float
    ) -> float:
        """The delay for which a group's distances sum up to least: so most of them tell how late all should be."""
        motion = motions[group[0]]
        if states[group[0]].stamp_s - most_s >= motion.began_s + motion.duration_s:
            return 0.0  # all set-points have rested for longer than any delay
        scale = self._scale
        start = np.array([motions[robot].start for robot in group]) * scale
        way = np.array([motions[robot].target for robot in group]) * scale - start
        here = np.array([states[robot].position for robot in group]) * scale
        time_s = np.array([states[robot].stamp_s for robot in group]) - motion.began_s

        def best(delays_s: NDArray[np.float64]) -> float:
            flown = share((time_s[None, :] - delays_s[:, None]) / motion.duration_s)
            off = np.linalg.norm(here - start - flown[:, :, None] * way, axis=2).sum(axis=1)
            return float(delays_s[int(off.argmin())])

        rough = best(np.linspace(0.0, most_s, TRIES))
        step = most_s / (TRIES - 1)
        return best(np.linspace(max(0.0, rough - step), min(most_s, rough + step), TRIES))
