"""Optimal reciprocal collision avoidance in the plane, a baseline of `benchmarks.arrivals`.

van den Berg, Guy, Lin, Manocha: Reciprocal n-body collision avoidance (Robotics Research, 2011). Vectors are complex
numbers, lengths in units, times in rounds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

from llm_flock.arrays import Points

PARALLEL = 1e-9
"""Lines count as parallel if the sine of the angle between them is at most this."""

Line: TypeAlias = tuple[complex, complex]
"""A point of a line and its unit direction; velocities to the left of it, as complex numbers, are allowed."""


def _dot(a: complex, b: complex) -> float:
    return (a.conjugate() * b).real


def _left(a: complex, b: complex) -> float:
    """How far b is to the left of the unit direction a."""
    return (a.conjugate() * b).imag


def orca_line(offset: complex, own: complex, other: complex, diameter: float, horizon: float, period: float) -> Line:
    """The velocities that a robot may choose if the other, at this offset, takes the other half of the change.

    The velocity obstacle is a cone cut off by a disc; the relative velocity is moved to its boundary by the smallest
    change. Discs that overlap have to come apart within one `period`.
    """
    relative, apart = own - other, abs(offset)
    time = horizon if apart > diameter else period
    from_disc = relative - offset / time
    behind = _dot(from_disc, offset)
    if apart <= diameter or (behind < 0.0 and behind**2 > diameter**2 * abs(from_disc) ** 2):
        outward = from_disc / abs(from_disc) if from_disc else -offset / apart
        return own + (diameter / time - abs(from_disc)) * outward / 2.0, -1j * outward
    leg = math.sqrt(apart**2 - diameter**2)
    side = 1.0 if _left(offset, from_disc) > 0.0 else -1.0
    along = side * offset * complex(leg, side * diameter) / apart**2
    return own + (_dot(along, relative) * along - relative) / 2.0, along


def _on_line(lines: Sequence[Line], k: int, longest: float, wish: complex, farthest: bool) -> complex | None:
    """The best velocity on line k that the lines before it and the speed limit allow; None if there is none."""
    point, along = lines[k]
    middle = -_dot(along, point)
    inside = middle**2 + longest**2 - abs(point) ** 2
    if inside < 0.0:
        return None
    low, high = middle - math.sqrt(inside), middle + math.sqrt(inside)
    for other, direction in lines[:k]:
        turn, gap = _left(along, direction), _left(direction, point - other)
        if abs(turn) <= PARALLEL:
            if gap < 0.0:
                return None
            continue
        if turn > 0.0:
            high = min(high, gap / turn)
        else:
            low = max(low, gap / turn)
        if low > high:
            return None
    if farthest:
        return point + (high if _dot(along, wish) > 0.0 else low) * along
    return point + min(max(_dot(along, wish - point), low), high) * along


def _in_plane(lines: Sequence[Line], longest: float, wish: complex, farthest: bool = False) -> tuple[int, complex]:
    """Number of lines satisfied one after the other, and their velocity nearest to `wish`, or farthest along it."""
    best = wish * longest if farthest else wish * min(1.0, longest / max(abs(wish), PARALLEL))
    for k, (point, along) in enumerate(lines):
        if _left(along, best - point) < 0.0:
            found = _on_line(lines, k, longest, wish, farthest)
            if found is None:
                return k, best
            best = found
    return len(lines), best


def _least_bad(lines: Sequence[Line], first: int, longest: float, best: complex) -> complex:
    """The velocity whose largest violation of a line is smallest; all lines before `first` are satisfied."""
    worst = 0.0
    for k, (point, along) in enumerate(lines[first:], first):
        if _left(along, point - best) <= worst:
            continue
        equal: list[Line] = []  # where line k is violated as much as an earlier one
        for other, direction in lines[:k]:
            turn = _left(along, direction)
            if abs(turn) <= PARALLEL:
                if _dot(along, direction) > 0.0:
                    continue
                crossing = (point + other) / 2.0
            else:
                crossing = point + _left(direction, point - other) / turn * along
            equal.append((crossing, (direction - along) / abs(direction - along)))
        satisfied, found = _in_plane(equal, longest, 1j * along, farthest=True)
        best = found if satisfied == len(equal) else best
        worst = _left(along, point - best)
    return best


def orca_velocity(lines: Sequence[Line], longest: float, wish: complex) -> complex:
    """The allowed velocity nearest to `wish`, no faster than `longest`; where none is allowed, the least bad."""
    satisfied, best = _in_plane(lines, longest, wish)
    return best if satisfied == len(lines) else _least_bad(lines, satisfied, longest, best)


def to_complex(points: Points) -> list[complex]:
    """Points of shape (n, 2) as complex numbers."""
    return [complex(x, y) for x, y in points.tolist()]


def orca_velocities(
    here: Sequence[complex],
    speeds: Sequence[complex],
    wishes: Sequence[complex],
    *,
    diameter: float,
    longest: float,
    horizon: float,
    period: float,
) -> list[complex]:
    """The next velocity of each robot, for one `period` [units per round].

    Args:
        here: positions of all robots.
        speeds: their present velocities.
        wishes: the velocities that they would choose alone.
        diameter: of each robot.
        longest: highest speed.
        horizon: time for which the velocities avoid collisions.
        period: time for which they are flown, shorter than `horizon`.
    """
    reach = diameter + 2.0 * longest * horizon  # nobody beyond can be met in time
    found: list[complex] = []
    for i, x in enumerate(here):
        near = sorted((abs(y - x), j) for j, y in enumerate(here) if j != i and abs(y - x) < reach)
        lines = [orca_line(here[j] - x, speeds[i], speeds[j], diameter, horizon, period) for _, j in near]
        found.append(orca_velocity(lines, longest, wishes[i]))
    return found
