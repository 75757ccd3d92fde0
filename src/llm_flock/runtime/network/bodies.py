"""Bodies that are commanded one at a time: straight segments at one speed, each command with a deadline.

A body obeys a command that comes in time and begins where the body is to stop, and answers every command by its number.
When a deadline comes before the end of the way, the body stops where it is: so no body ever moves on old news.
"""

from __future__ import annotations

import math

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Point, Points
from llm_flock.runtime.network.wire import Body, Command

SUBSTEP_S = 0.01
"""Ways have corners, so separation is measured along pieces that are at most so long [s]."""

SAME_PLACE = 1e-9
"""Two places this near are the same [units]."""


class Bodies:
    """True positions, and what each body is doing.

    Args:
        start: shape (n, d) [units].
        speed: of every body [units/s].
        period_s: a command's segment is to be flown in so long [s].
        lag_s: a command may be so old when it comes, and end so much later [s].
        now: the time [s].
    """

    def __init__(self, start: Points, *, speed: float, period_s: float, lag_s: float, now: float) -> None:
        self.positions: Points = np.array(start, dtype=np.float64)
        self.late = 0
        self.smallest = metrics.min_separation(self.positions)
        self._closest = self.smallest
        self._standing: float | None = None
        self._speed, self._period_s, self._lag_s = speed, period_s, lag_s
        self._now = now
        self._ways: list[list[Point]] = [[] for _ in self.positions]
        self._deadlines = [now] * len(self.positions)
        self._answered = [0] * len(self.positions)

    def command(self, robot: int, order: Command, now: float) -> bool:
        """Take a command; whether it is obeyed."""
        self.advance(now)
        if order.number <= self._answered[robot]:
            return False
        self._answered[robot] = order.number
        end = self._end(robot)
        early = now < order.stamp - self._lag_s
        if early or now > order.stamp + self._lag_s or not _usable(order.target, len(end)):
            self.late += 1
            return False
        if len(order.origin) != len(end) or math.dist(order.origin, end) > SAME_PLACE:
            return False
        self._ways[robot].append(order.target)
        self._deadlines[robot] = order.stamp + self._period_s + self._lag_s
        return True

    def advance(self, now: float) -> None:
        """Fly until now, and measure the separation on the way."""
        while self._now < now:
            step = min(SUBSTEP_S, now - self._now)
            if not any(self._ways):
                self._now = now
                return
            before = self.positions.copy()
            for robot, way in enumerate(self._ways):
                if way:
                    self._fly(robot, way, step)
            self._now += step
            nearest = metrics.segment_separation(before, self.positions)
            self._closest = min(self._closest, nearest)
            self.smallest = min(self.smallest, nearest)

    def _fly(self, robot: int, way: list[Point], step: float) -> None:
        left = self._speed * min(step, self._deadlines[robot] - self._now)
        here: Point = tuple(self.positions[robot].tolist())
        while way and left > 0.0:
            distance = math.dist(here, way[0])
            if distance <= left:
                left -= distance
                here = way.pop(0)
            else:
                share = left / distance
                here = tuple(x + share * (y - x) for x, y in zip(here, way[0], strict=True))
                left = 0.0
        if way and self._deadlines[robot] <= self._now + step:
            way.clear()
        self.positions[robot] = here

    def _end(self, robot: int) -> Point:
        way = self._ways[robot]
        return way[-1] if way else tuple(self.positions[robot].tolist())

    def closest(self) -> float:
        """Smallest distance of two bodies since this was asked last, along their segments too [units]."""
        closest, self._closest = self._closest, math.inf
        if closest < math.inf:
            self._standing = None
            return closest
        if self._standing is None:  # the first time that nobody has moved since
            self._standing = metrics.min_separation(self.positions)
        return self._standing

    def frame(self) -> tuple[Body, ...]:
        """Every body, by id."""
        rows: list[Point] = [tuple(row) for row in self.positions.tolist()]
        return tuple(
            Body(position=row, end=self._end(robot), command=self._answered[robot]) for robot, row in enumerate(rows)
        )


def _usable(target: Point, dim: int) -> bool:
    return len(target) == dim and all(map(math.isfinite, target))
