"""Distance of a team from an ideal shape, over all assignments, rotations and translations.

The paper's Procrustes error (Error(t), line 236; appendix, lines 573-645) does not say which robot belongs to which
target point. Here correspondence and rotation minimise the sum of squares jointly.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from llm_flock import formations
from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.metrics.plane import as_complex, longest, proven_match

SYMMETRY_TOLERANCE = 1e-12
"""A shape counts as symmetric if a rotation maps its points to within this share of its radius."""

LARGE = 300
"""Number of points above which `proven_match` is tried first, since `longest` takes the cube of it, many times."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeError:
    """Distance of a team from an ideal shape after the best translation, rotation and correspondence.

    Attributes:
        mean: mean distance of a robot from its target point [units] (paper, line 236).
        mean_squared: mean of the squared distances [units^2] (paper, line 637).
        assignment: for each robot, the index of its target point; a permutation of 0 .. n - 1.
        rotation: rotation of centred positions onto centred targets, shape (d, d), determinant +1.
    """

    mean: float
    mean_squared: float
    assignment: tuple[int, ...]
    rotation: NDArray[np.float64]


class ShapeTarget:
    """An ideal shape for comparison with many teams; computes once whatever depends on the shape alone.

    Args:
        target: ideal points, shape (n, d) [units], d = 2 or 3, in any position and orientation.

    Raises:
        InputError: the points do not have this shape, or are not finite.
    """

    def __init__(self, target: ArrayLike) -> None:
        rows = _rows("target", target)
        self._target = rows - rows.mean(axis=0)
        self._symmetry = formations.rotational_symmetry(rows, SYMMETRY_TOLERANCE)

    def error(self, positions: ArrayLike) -> ShapeError:
        """The team's distance from the shape: the global minimum for d = 2, a local minimum for d = 3.

        If several correspondences are equally good, the choice is arbitrary but repeatable. Their `mean_squared` is
        the same; their `mean` may differ.

        Args:
            positions: shape (n, d) [units], the shape of the target.

        Raises:
            InputError: the positions do not have this shape, or are not finite.
        """
        rows, shape = _rows("positions", positions), self._target.shape
        if rows.shape != shape:
            raise InputError("positions", rows.shape, f"an array of shape {shape}, the shape of the target")
        rows = rows - rows.mean(axis=0)
        if rows.shape[1] == 2:
            columns, rotation = self._best_in_plane(rows)
        else:
            from llm_flock.metrics.space import best_in_space

            columns, rotation = best_in_space(rows, self._target)
        squared = ((rows @ rotation.T - self._target[columns]) ** 2).sum(axis=1)
        return ShapeError(
            mean=float(np.sqrt(squared).mean()),
            mean_squared=float(squared.mean()),
            assignment=tuple(columns.tolist()),
            rotation=rotation,
        )

    def _best_in_plane(self, rows: Points) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        best = proven_match(rows, self._target, self._symmetry) if len(rows) > LARGE else None
        if best is None:
            best = longest(as_complex(rows), as_complex(self._target), self._symmetry)
        angle = cmath.phase(best.z)
        cos, sin = math.cos(angle), math.sin(angle)
        return best.columns, np.array([[cos, -sin], [sin, cos]])


def procrustes(positions: ArrayLike, target: ArrayLike) -> ShapeError:
    """The team's distance from an ideal shape, d = 2 or 3. To compare many teams with one shape, use `ShapeTarget`.

    Raises:
        InputError: the arrays do not have this shape, or are not finite.
    """
    return ShapeTarget(target).error(positions)


def _rows(field: str, values: ArrayLike) -> Points:
    rows = np.asarray(values, dtype=np.float64)
    if rows.ndim != 2 or not len(rows) or rows.shape[1] not in (2, 3):
        raise InputError(field, rows.shape, "an array of shape (n, 2) or (n, 3)")
    if not np.isfinite(rows).all():
        raise InputError(field, rows.tolist(), "finite numbers")
    return rows
