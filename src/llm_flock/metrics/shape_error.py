"""How far a team is from an ideal shape, whoever stands where, however the whole is turned and moved.

The Procrustes error of the paper (Error(t), line 236; appendix, lines 573-645) leaves open which robot belongs to which
target point. Here both the correspondence and the rotation are chosen, jointly, so that the sum of squares is least.

In the plane that optimum is exact. With centred positions x_i and targets y_j as complex numbers, a correspondence pi
has z_pi = sum_i conj(x_i) y_pi(i); its best rotation is the argument of z_pi, and its sum of squares is
sum |x_i|^2 + sum |y_i|^2 - 2 |z_pi|. So the longest z_pi is wanted. All z_pi lie in a convex polygon, and one linear
assignment problem gives the corner farthest in any direction. Between two such directions the polygon lies within the
triangle of the two corners and the crossing of their two support lines: a branch and bound on intervals of directions.
"""

from __future__ import annotations

import cmath
import heapq
import math
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from llm_flock import formations
from llm_flock.arrays import Points
from llm_flock.errors import InputError

ROUNDING = 4 * float(np.finfo(np.float64).eps)
"""Gains of less than this share for each robot are rounding, not gains."""

SYMMETRY_TOLERANCE = 1e-12
"""A shape counts as symmetric if a turn moves its points by less than this share of its radius."""

PIECES = 5
"""Intervals of directions in the full circle at the start; support lines need less than a quarter turn to cross."""

REFINED_STARTS = 6
"""In three dimensions: so many of the best starting rotations are refined."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeError:
    """Distance of a team from an ideal shape, after the best translation, rotation and correspondence.

    Attributes:
        mean: average distance of a robot from its target point [units] (paper, line 236).
        mean_squared: average of the squared distances [units^2] (paper, line 637).
        assignment: for each robot, the number of its target point; a permutation of 0 .. n - 1.
        rotation: shape (d, d), determinant +1; turns centred positions onto centred targets.
    """

    mean: float
    mean_squared: float
    assignment: tuple[int, ...]
    rotation: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Corner:
    """A corner of the polygon: the direction in which it is farthest, how far that is, and where it lies."""

    angle: float
    support: float
    z: complex
    columns: NDArray[np.intp]

    def turned(self, angle_rad: float) -> _Corner:
        """The same corner of a polygon that this turn maps onto itself."""
        z = self.z * cmath.rect(1.0, angle_rad)
        return _Corner(angle=self.angle + angle_rad, support=self.support, z=z, columns=self.columns)


class ShapeTarget:
    """An ideal shape to compare teams with; what depends on the shape alone is computed once.

    Args:
        target: ideal points, shape (n, d) [units], d = 2 or 3; where the whole lies and how it is turned is arbitrary.

    Raises:
        InputError: the points do not have this form.
    """

    def __init__(self, target: ArrayLike) -> None:
        rows = _rows("target", target)
        self._shape = rows.shape
        self._target = rows - rows.mean(axis=0)
        self._symmetry = formations.rotational_symmetry(rows, SYMMETRY_TOLERANCE)
        self._complex = _as_complex(self._target)

    def error(self, positions: ArrayLike) -> ShapeError:
        """The team's distance from the shape: the global minimum for d = 2, a local one for d = 3.

        Where several correspondences are equally good, which one is reported is arbitrary but repeatable; their
        `mean_squared` is the same, their `mean` need not be.

        Args:
            positions: shape (n, d) [units], as many rows and columns as the target.

        Raises:
            InputError: the positions do not have this form, or are not finite.
        """
        rows = _rows("positions", positions)
        if rows.shape != self._shape:
            raise InputError("positions", rows.shape, f"an array of shape {self._shape}, as the target has")
        rows = rows - rows.mean(axis=0)
        search = self._best_in_plane if rows.shape[1] == 2 else self._best_in_space
        columns, rotation = search(rows)
        squared = ((rows @ rotation.T - self._target[columns]) ** 2).sum(axis=1)
        return ShapeError(
            mean=float(np.sqrt(squared).mean()),
            mean_squared=float(squared.mean()),
            assignment=tuple(columns.tolist()),
            rotation=rotation,
        )

    # ------------------------------------------------------------ the plane

    def _best_in_plane(self, rows: Points) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        products = np.conj(_as_complex(rows))[:, None] * self._complex
        best = longest_corner(products, self._symmetry)
        cos, sin = math.cos(angle := cmath.phase(best.z)), math.sin(angle)
        return best.columns, np.array([[cos, -sin], [sin, cos]])

    # ------------------------------------------------------------ space

    def _best_in_space(self, rows: Points) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Alternate between the best correspondence and the best rotation, from the best of many starts."""
        first = [(*self._correspond(rows, start), k) for k, start in enumerate(_starting_rotations())]
        first.sort(key=lambda found: (-found[0], found[2]))
        best_fit, best = -math.inf, first[0][1]
        for fit, columns, _ in first[:REFINED_STARTS]:
            while True:
                better, refined = self._correspond(rows, proper_rotation(rows, self._target[columns]))
                if better <= fit * (1 + ROUNDING * len(rows)):
                    break
                fit, columns = better, refined
            if fit > best_fit:
                best_fit, best = fit, columns
        return best, proper_rotation(rows, self._target[best])

    def _correspond(self, rows: Points, rotation: NDArray[np.float64]) -> tuple[float, NDArray[np.intp]]:
        gain = (rows @ rotation.T) @ self._target.T
        index, columns = linear_sum_assignment(gain, maximize=True)
        return float(gain[index, columns].sum()), columns


def longest_corner(products: NDArray[np.complex128], symmetry: int = 1) -> _Corner:
    """The correspondence pi whose z_pi = sum_i products[i, pi(i)] is longest, exactly.

    Args:
        products: shape (n, n), conj(x_i) y_j.
        symmetry: a turn by 360/symmetry degrees is known to map the set of all z_pi to itself.
    """
    real, imag = np.ascontiguousarray(products.real), np.ascontiguousarray(products.imag)
    index = np.arange(len(products))
    gap = ROUNDING * len(products)

    def corner(angle: float) -> _Corner:
        direction = cmath.rect(1.0, angle)
        _, columns = linear_sum_assignment(direction.real * real + direction.imag * imag, maximize=True)
        z = complex(products[index, columns].sum())
        return _Corner(angle=angle, support=(z * direction.conjugate()).real, z=z, columns=columns)

    # Climb to a good corner first: the bound prunes all the more.
    best = corner(0.0)
    while (climbed := corner(cmath.phase(best.z))).support > abs(best.z) * (1 + gap):
        best = climbed
    best = climbed if abs(climbed.z) > abs(best.z) else best

    sector = 2 * math.pi / symmetry
    pieces = math.ceil(PIECES / symmetry)
    start = climbed.angle
    corners = [climbed, *(corner(start + sector * k / pieces) for k in range(1, pieces)), climbed.turned(sector)]
    best = max(best, *corners, key=lambda c: abs(c.z))
    tiny = gap * float(np.abs(products).sum(axis=1).max()) + 1e-300

    branches = [_branch(a, b) for a, b in pairwise(corners)]
    heapq.heapify(branches)
    while branches and -branches[0][0] > abs(best.z) * (1 + gap) + tiny:
        _, _, one, two = heapq.heappop(branches)
        # The direction at right angles to the line between the corners finds a new one, or proves there is none.
        between = corner(one.angle + cmath.phase((two.z - one.z) * -1j * cmath.rect(1.0, -one.angle)))
        if abs(between.z) > abs(best.z):
            best = between
        known = (one.z * cmath.rect(1.0, -between.angle)).real
        if one.angle < between.angle < two.angle and between.support > known + tiny:
            heapq.heappush(branches, _branch(one, between))
            heapq.heappush(branches, _branch(between, two))
    return best


def _branch(one: _Corner, two: _Corner) -> tuple[float, float, _Corner, _Corner]:
    """An interval of directions, with minus the length that a corner within it may reach at most (for a min-heap)."""
    width = two.angle - one.angle
    # In the frame of the first direction the support lines are u = one.support and u cos + v sin = two.support.
    v = (two.support - one.support * math.cos(width)) / math.sin(width)
    # The longest corner is the farthest one in its own direction: it only counts where that lies in the interval.
    inside = 0.0 <= math.atan2(v, one.support) <= width
    bound = math.hypot(one.support, v) if inside else max(one.support, two.support)
    return -bound, one.angle, one, two


def procrustes(positions: ArrayLike, target: ArrayLike) -> ShapeError:
    """The team's distance from an ideal shape; for many teams and one shape, `ShapeTarget` is faster.

    Args:
        positions: shape (n, d) [units], d = 2 or 3.
        target: shape (n, d) [units].

    Raises:
        InputError: the arrays do not have this form, or are not finite.
    """
    return ShapeTarget(target).error(positions)


def proper_rotation(rows: Points, target: Points) -> NDArray[np.float64]:
    """The rotation R, shape (d, d), that minimises the sum of |R x_i - y_i|^2 for centred points.

    With the singular value decomposition U S V^T of sum y_i x_i^T it is U diag(1, .., det(U V^T)) V^T (Kabsch 1976).
    The paper flips the sign of a singular value instead (line 626), which leaves U V^T a reflection.
    """
    u, _, vt = np.linalg.svd(target.T @ rows)
    signs = np.ones(rows.shape[1])
    signs[-1] = np.sign(np.linalg.det(u @ vt))
    return (u * signs) @ vt


def _starting_rotations() -> list[NDArray[np.float64]]:
    """The 24 rotations of a cube: no rotation of space is farther than 63 degrees from one of them."""
    matrices: list[NDArray[np.float64]] = []
    for first, second in product(range(3), range(3)):
        if first != second:
            for signs in product((1.0, -1.0), repeat=2):
                x, y = np.zeros(3), np.zeros(3)
                x[first], y[second] = signs
                matrices.append(np.array([x, y, np.cross(x, y)]))
    return matrices


def _rows(field: str, values: ArrayLike) -> Points:
    rows = np.asarray(values, dtype=np.float64)
    if rows.ndim != 2 or not len(rows) or rows.shape[1] not in (2, 3):
        raise InputError(field, rows.shape, "an array of shape (n, 2) or (n, 3)")
    if not np.isfinite(rows).all():
        raise InputError(field, rows.tolist(), "finite numbers")
    return rows


def _as_complex(rows: Points) -> NDArray[np.complex128]:
    return rows[:, 0] + 1j * rows[:, 1]
