"""The trajectory of a Crazyflie's high-level commander between two points: a polynomial of degree 7 for each axis.

It starts with the given position, velocity and acceleration, ends at rest at the target, and has no jerk at either end
(firmware: `piecewise_plan_7th_order_no_jerk` in `src/modules/src/pptraj.c`). From rest it is a straight line, and the
share of it flown depends only on the share of the duration: robots that start together stay in step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from llm_flock.robots._base import Position

HOLD_S = 1.0
"""Time in which a robot comes to rest on `hold` [s]."""

_Coefficients: TypeAlias = tuple[float, float, float, float, float, float, float]
_REST: Position = (0.0, 0.0, 0.0)


def _coefficients(start: float, velocity: float, acceleration: float, end: float) -> _Coefficients:
    """Coefficients of 1, u, u^2, u^4 .. u^7 in u = t / duration, for derivatives that vanish at u = 1."""
    gap = end - start - velocity - acceleration / 2.0
    slope, bend = -velocity - acceleration, -acceleration
    return (
        start,
        velocity,
        acceleration / 2.0,
        35.0 * gap - 15.0 * slope + 2.5 * bend,
        -84.0 * gap + 39.0 * slope - 7.0 * bend,
        70.0 * gap - 34.0 * slope + 6.5 * bend,
        -20.0 * gap + 10.0 * slope - 2.0 * bend,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """One trajectory [m] to a target, where it ends at rest: from `began_s`, on the clock of `at`, for `duration_s`."""

    start: Position
    target: Position
    duration_s: float
    began_s: float = 0.0
    velocity: Position = _REST
    acceleration: Position = _REST
    _axes: tuple[_Coefficients, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        time = self.duration_s
        axes = tuple(
            _coefficients(p, v * time, a * time * time, end)
            for p, v, a, end in zip(self.start, self.velocity, self.acceleration, self.target, strict=True)
        )
        object.__setattr__(self, "_axes", axes)

    def at(self, now_s: float) -> tuple[Position, Position, Position]:
        """Position [m], velocity [m/s] and acceleration [m/s^2] at a time."""
        time_s = now_s - self.began_s
        if time_s >= self.duration_s:
            return self.target, _REST, _REST
        time, u = self.duration_s, max(0.0, time_s / self.duration_s)
        rows: list[tuple[float, float, float]] = []
        for c0, c1, c2, c4, c5, c6, c7 in self._axes:
            position = c0 + u * (c1 + u * (c2 + u * u * (c4 + u * (c5 + u * (c6 + u * c7)))))
            velocity = c1 + u * (2 * c2 + u * u * (4 * c4 + u * (5 * c5 + u * (6 * c6 + u * 7 * c7))))
            acceleration = 2 * c2 + u * u * (12 * c4 + u * (20 * c5 + u * (30 * c6 + u * 42 * c7)))
            rows.append((position, velocity / time, acceleration / (time * time)))
        x, y, z = rows
        return (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])


def share(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares of a segment from rest to rest, flown in parts of its duration; 0 before it begins, 1 after it ends."""
    u = np.clip(parts, 0.0, 1.0)
    return u**4 * (35.0 + u * (-84.0 + u * (70.0 - 20.0 * u)))


def stopping_point(segment: Segment, now_s: float, within_s: float) -> Position | None:
    """The point at which a robot can rest `within_s` later without turning back [m]; None if its target is as near."""
    if now_s - segment.began_s + within_s >= segment.duration_s:
        return None
    at, velocity, _ = segment.at(now_s)
    way = [v * within_s / 2.0 for v in velocity]
    if math.hypot(*way) >= math.dist(at, segment.target):
        return None
    return (at[0] + way[0], at[1] + way[1], at[2] + way[2])
