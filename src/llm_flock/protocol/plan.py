"""A formation plan: target positions in a fixed order, compared by content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from llm_flock.arrays import Point, Points

DECIMALS = 6
"""Decimals of plan coordinates, so that equal plans are equal on every robot."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """N target positions p_1 .. p_N (paper, section 3.1), hashable and comparable by content.

    Attributes:
        points: N positions of d coordinates each [units; world frame], rounded to DECIMALS.
        digest: 16 hexadecimal digits that identify the content.
        array: the same positions, shape (n, d), read-only [units].
    """

    points: tuple[Point, ...]
    digest: str = field(init=False)
    array: Points = field(init=False, repr=False)

    def __post_init__(self) -> None:
        given = np.array(self.points, dtype=np.float64).reshape(len(self.points), -1)
        array = given.round(DECIMALS) + 0.0  # adding zero turns -0.0 into 0.0
        array.setflags(write=False)
        if array.tobytes() != given.tobytes():
            rows: list[list[float]] = array.tolist()
            object.__setattr__(self, "points", tuple(map(tuple, rows)))
        content = array.astype("<f8").tobytes()
        object.__setattr__(self, "digest", hashlib.blake2b(content, digest_size=8).hexdigest())
        object.__setattr__(self, "array", array)

    @classmethod
    def of(cls, points: Iterable[Iterable[float]]) -> Plan:
        """A plan from any rows of numbers, shape (n, d) [units]."""
        return cls(tuple(tuple(float(x) for x in row) for row in points))

    def __len__(self) -> int:
        return len(self.points)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Plan) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)
