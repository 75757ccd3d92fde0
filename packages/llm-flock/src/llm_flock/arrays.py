"""Array types with named axes: n robots or points, d dimensions of space."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points: TypeAlias = Annotated[NDArray[np.float64], "n d"]
Vector: TypeAlias = Annotated[NDArray[np.float64], "d"]
Pairwise: TypeAlias = Annotated[NDArray[np.float64], "n n"]
Mask: TypeAlias = Annotated[NDArray[np.bool_], "n n"]

Point: TypeAlias = tuple[float, ...]
"""One position as plain numbers, length d [units; world frame]."""

MAX_COORDINATE = 1e6
"""Largest absolute coordinate in a mission or in a model's answer [units]; a double resolves it to about 1e-10."""


def moved(point: Point, by: Point, share: float = 1.0) -> Point:
    """The point moved by `share` times the displacement `by` [units]; the point itself if `by` is empty."""
    return tuple(x + share * d for x, d in zip(point, by, strict=True)) if by else point


def between(here: Point, there: Point, share: float) -> Point:
    """The point at this share of the way to another [units]; beyond it for more than 1, and behind for less than 0."""
    return tuple(x + share * (y - x) for x, y in zip(here, there, strict=True))


def towards(here: Point, there: Point, longest: float) -> Point:
    """The other point, or one this far on the way to it if it is farther [units]."""
    far = math.dist(here, there)
    return there if far <= longest else between(here, there, longest / far)


def flattened(points: ArrayLike, downwash: float) -> Points:
    """Points, shape (n, d), with heights divided by `downwash`: the ellipsoid that robots keep free becomes a sphere.

    This is the one norm in which robots' distances from each other are judged (Preiss, Hönig, Ayanian, Sukhatme:
    Downwash-aware trajectory planning for large quadrotor teams, IROS 2017). No vector gets longer by it. Points of
    the plane, and those of a `downwash` of 1, stay as they are.
    """
    rows = np.asarray(points, dtype=np.float64)
    return rows if downwash == 1.0 or not rows.size else rows / np.array([1.0, 1.0, downwash])


def separation(one: Point, other: Point, downwash: float) -> float:
    """The distance of two robots as `flattened` measures it [units]."""
    if downwash == 1.0:
        return math.dist(one, other)
    x, y, z = (b - a for a, b in zip(one, other, strict=True))
    return math.hypot(x, y, z / downwash)


def grid_rows(n: int) -> Points:
    """The places of a grid with ceil(sqrt(n)) columns and a spacing of 1, shape (n, 2), the last row at the bottom."""
    columns = math.isqrt(n - 1) + 1
    row, column = np.divmod(np.arange(n), columns)
    left_over = columns - (n - row[-1] * columns)
    column = np.where(row == row[-1], column + left_over // 2, column)
    return np.column_stack([column, -row]).astype(np.float64)


def spread(points: Iterable[Point], apart: float, near: Sequence[Point] = ()) -> Iterator[Point]:
    """Those points of which each is farther than `apart` from all before it, and from all of `near` [units]."""
    kept = list(near)
    for point in points:
        if all(math.dist(point, other) > apart for other in kept):
            kept.append(point)
            yield point
