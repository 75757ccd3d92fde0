"""Set-points: the intended position of each drone at any time, and the checks of every command before it is sent."""

from __future__ import annotations

import math
from collections.abc import Sequence

from llm_flock import metrics
from llm_flock.robots import PEAK_SPEED, Position, Segment
from llm_flock_flight._flight.config import FlightConfig

SLACK_M = 1e-4  # set-points may be nearer than planned by this: a generous bound of the shield's rounding [m]


def resting(position: Position) -> Segment:
    """A set-point that does not move."""
    return Segment(start=position, target=position, duration_s=1.0, began_s=-math.inf)


class SetPointCheck:
    """Checks the set-points of a round."""

    def __init__(self, config: FlightConfig) -> None:
        safety = config.safety
        self._low, self._high = config.inner_fence
        self._fastest = safety.max_speed_m_s
        self._beside = safety.min_separation_m + 2 * safety.tracking_m
        self._downwash = (safety.downwash_m + 2 * config.height_tracking_m) / self._beside

    def separation(self, before: Sequence[Position], after: Sequence[Position]) -> float:
        """Smallest distance of two set-points during the motion, heights scaled by the vertical rule [m]."""
        return metrics.segment_separation(before, after, downwash=self._downwash)

    def faults(self, before: Sequence[Position], after: Sequence[Position], duration_s: float) -> list[str]:
        """The limits that a joint motion from rest to rest would break; empty if it may be flown [m, s]."""
        found: list[str] = []
        for robot, (start, end) in enumerate(zip(before, after, strict=True)):
            found += self._one(robot, start, end, duration_s)
        nearest = self.separation(before, after)
        if nearest < self._beside - SLACK_M:
            found.append(f"two set-points come as near as {nearest:.3f} m; at least {self._beside:g} m is asked for")
        return found

    def _one(self, robot: int, before: Position, after: Position, duration_s: float) -> list[str]:
        found: list[str] = []
        if not all(map(math.isfinite, after)):
            return [f"robot {robot}: {after} is no place"]
        if not all(a - SLACK_M <= x <= b + SLACK_M for a, x, b in zip(self._low, after, self._high, strict=True)):
            x, y, z = after
            found.append(f"robot {robot}: ({x:.3f}, {y:.3f}, {z:.3f}) m is not within the geofence and its margin")
        peak = PEAK_SPEED * math.dist(before, after) / duration_s
        if peak > self._fastest * (1 + 1e-6):
            found.append(f"robot {robot}: {peak:.3f} m/s on the way; at most {self._fastest:g} m/s")
        return found
