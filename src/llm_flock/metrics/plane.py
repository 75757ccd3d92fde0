"""The best correspondence and rotation between two sets of points of the plane: an exact global optimum.

With centred positions x_i and targets y_j as complex numbers, a correspondence pi has z_pi = sum_i conj(x_i) y_pi(i).
Its best rotation is the argument of z_pi, and its sum of squares is sum |x_i|^2 + sum |y_i|^2 - 2 |z_pi|. So the
problem is to find the longest z_pi. All z_pi lie in a convex polygon, and one linear assignment problem yields the
corner that is farthest in a given direction. Between two such directions, the polygon lies within the triangle of the
two corners and the intersection of their support lines. So a branch and bound on intervals of directions ends after
finitely many corners.
"""

from __future__ import annotations

import cmath
import heapq
import math
import sys
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

ROUNDING = 4 * float(np.finfo(np.float64).eps)
"""Gains below this share, times the number of robots, count as rounding."""

PIECES = 5
"""Initial intervals of directions in the full circle, each less than 90 degrees so that support lines intersect."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Correspondence:
    """A correspondence: robot i has target `columns[i]`, and `z` is its sum z_pi."""

    z: complex
    columns: NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Corner:
    """A corner `z` of the polygon, the direction `angle` in which it is farthest, and its extent `support` in it."""

    angle: float
    support: float
    z: complex


def longest(products: NDArray[np.complex128], symmetry: int = 1) -> Correspondence:
    """The correspondence pi whose z_pi = sum_i products[i, pi(i)] is longest.

    Args:
        products: shape (n, n), conj(x_i) y_j for centred x and y [units^2].
        symmetry: a rotation by 360/symmetry degrees maps the set of all z_pi to itself.
    """
    real, imag = np.ascontiguousarray(products.real), np.ascontiguousarray(products.imag)
    index = np.arange(len(products))
    gap = ROUNDING * len(products)
    tiny = gap * float(np.abs(products).sum(axis=1).max()) + sys.float_info.min
    best = Correspondence(z=0j, columns=index)

    def corner(angle: float) -> _Corner:
        nonlocal best
        direction = cmath.rect(1.0, angle)
        _, columns = linear_sum_assignment(direction.real * real + direction.imag * imag, maximize=True)
        z = complex(products[index, columns].sum())
        if abs(z) > abs(best.z):
            best = Correspondence(z=z, columns=columns)
        return _Corner(angle=angle, support=(z * direction.conjugate()).real, z=z)

    # Climb to a good corner first, so that the bound prunes more.
    first = corner(0.0)
    while (climbed := corner(cmath.phase(first.z))).support > abs(first.z) * (1 + gap):
        first = climbed

    sector = 2 * math.pi / symmetry
    pieces = math.ceil(PIECES / symmetry)
    corners = [climbed, *(corner(climbed.angle + sector * k / pieces) for k in range(1, pieces))]
    turned = climbed.z * cmath.rect(1.0, sector)
    corners.append(_Corner(angle=climbed.angle + sector, support=climbed.support, z=turned))

    branches = [_branch(a, b) for a, b in pairwise(corners)]
    heapq.heapify(branches)
    while branches and -branches[0][0] > abs(best.z) * (1 + gap) + tiny:
        _, _, one, two = heapq.heappop(branches)
        # The direction normal to the line between the corners yields a new corner, or proves that there is none.
        across = -1j * (two.z - one.z) * cmath.rect(1.0, -one.angle)
        between = corner(one.angle + cmath.phase(across))
        known = (one.z * cmath.rect(1.0, -between.angle)).real
        if one.angle < between.angle < two.angle and between.support > known + tiny:
            heapq.heappush(branches, _branch(one, between))
            heapq.heappush(branches, _branch(between, two))
    return best


def _branch(one: _Corner, two: _Corner) -> tuple[float, float, _Corner, _Corner]:
    """An interval of directions, after minus the largest possible length of a corner within it (for a min-heap)."""
    width = two.angle - one.angle
    # In the frame of the first direction the support lines are u = one.support and u cos + v sin = two.support.
    v = (two.support - one.support * math.cos(width)) / math.sin(width)
    # The longest corner is the farthest in its own direction, so the intersection counts only inside the interval.
    inside = 0.0 <= math.atan2(v, one.support) <= width
    bound = math.hypot(one.support, v) if inside else max(one.support, two.support)
    return -bound, one.angle, one, two
