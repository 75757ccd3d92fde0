"""Layouts of n points for each named shape, in units of the spacing; the position of the whole is arbitrary.

Every layout takes n, which the shape must allow, and the number of sides, which only `polygon` uses.
"""

from __future__ import annotations

import math

import numpy as np

from llm_flock.arrays import Points


def line(n: int, _: int = 0) -> Points:
    """Points along the x axis."""
    return np.column_stack([np.arange(n, dtype=np.float64), np.zeros(n)])


def outline(corners: Points, per_side: int) -> Points:
    """`per_side` evenly spaced points on each side of a closed outline, including its first corner, not its second."""
    share = np.arange(per_side)[:, None] / per_side
    sides = np.roll(corners, -1, axis=0) - corners
    return (corners[:, None] + share * sides[:, None]).reshape(-1, 2)


def ring(n: int, radius: float, first_rad: float = 0.0) -> Points:
    """Points evenly spaced on a circle, the first at angle `first_rad` from the x axis."""
    angles = first_rad + 2 * math.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def circumradius_of(sides: int, length: float) -> float:
    """Radius of the circle through the corners of a regular polygon with sides of length `length`."""
    return length / (2 * math.sin(math.pi / sides))


def circle(n: int, _: int = 0) -> Points:
    """A circle: the chord between neighbours is the spacing. One robot is at the centre, two form a pair."""
    return np.zeros((1, 2)) if n == 1 else ring(n, circumradius_of(n, 1.0))


def polygon(n: int, sides: int) -> Points:
    """A regular polygon with its first corner at angle 0, as in the paper's example (line 353)."""
    per_side = n // sides
    return outline(ring(sides, circumradius_of(sides, per_side)), per_side)


def triangle(n: int, _: int = 0) -> Points:
    """An equilateral triangle, points along its perimeter."""
    return polygon(n, 3)


def square(n: int, _: int = 0) -> Points:
    """A square with sides parallel to the axes, points along its perimeter."""
    side = n // 4
    return outline(ring(4, circumradius_of(4, side), math.pi / 4), side)


def cross(n: int, _: int = 0) -> Points:
    """The centre and four arms along the axes."""
    steps = np.arange(1.0, n // 4 + 1)[:, None]
    arms = [steps * direction for direction in np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])]
    return np.concatenate([np.zeros((1, 2)), *arms])


def wedge(n: int, _: int = 0) -> Points:
    """Apex ahead (+y), two arms at 45 degrees behind it, filled in turn: for even n, the first arm is longer."""
    steps = (np.arange(n) + 1) // 2
    side = np.where(np.arange(n) % 2 == 1, 1.0, -1.0)
    return np.column_stack([side * steps, -1.0 * steps]) * np.float64(math.sqrt(0.5))


def grid(n: int, _: int = 0) -> Points:
    """A grid with ceil(sqrt(n)) columns. The last row is centred by whole columns only.

    A shift by half a column would leave robots of the last row without a neighbour at exactly the spacing.
    """
    columns = math.isqrt(n - 1) + 1
    row, column = np.divmod(np.arange(n), columns)
    left_over = columns - (n - row[-1] * columns)
    column = np.where(row == row[-1], column + left_over // 2, column)
    return np.column_stack([column, -row]).astype(np.float64)


def star(n: int, _: int = 0) -> Points:
    """A regular pentagon with an equilateral triangle on each side; all ten edges have the same length."""
    edge = n // 10
    tip = edge * (math.cos(math.pi / 5) / (2 * math.sin(math.pi / 5)) + math.sqrt(0.75))
    tips = ring(5, tip, math.pi / 2)
    dents = ring(5, circumradius_of(5, edge), math.pi / 2 + math.pi / 5)
    return outline(np.stack([tips, dents], axis=1).reshape(-1, 2), edge)
