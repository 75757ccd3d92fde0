"""Array types with named axes: n robots or points, d dimensions of space."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Points: TypeAlias = NDArray[np.float64]
    Vector: TypeAlias = NDArray[np.float64]
    Pairwise: TypeAlias = NDArray[np.float64]
    Mask: TypeAlias = NDArray[np.bool_]
else:
    from jaxtyping import Bool, Float

    Points = Float[np.ndarray, "n d"]
    Vector = Float[np.ndarray, "d"]
    Pairwise = Float[np.ndarray, "n n"]
    Mask = Bool[np.ndarray, "n n"]

Point: TypeAlias = tuple[float, ...]
"""One position as plain numbers, length d [units; world frame]."""

MAX_COORDINATE = 1e6
"""Largest absolute coordinate in a mission or in a model's answer [units]; a double resolves it to about 1e-10."""


def moved(point: Point, by: Point, share: float = 1.0) -> Point:
    """The point moved by `share` times the displacement `by` [units]; the point itself if `by` is empty."""
    return tuple(x + share * d for x, d in zip(point, by, strict=True)) if by else point
