"""A formation plan: target positions in a fixed order, compared by content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cached_property
from typing import Annotated

import msgspec
import numpy as np

from llm_flock.arrays import MAX_COORDINATE, Points
from llm_flock.bounds import MAX_PROGRAM_BYTES

DECIMALS = 6  #: Decimals of plan coordinates, so that equal plans are equal on every robot.

Coordinate = Annotated[float, msgspec.Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
"""A coordinate that a message may have; the bounds are checked when it is decoded."""


class Plan(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True, eq=False, dict=True):
    """N target positions p_1 .. p_N (paper, section 3.1), hashable and comparable by content.

    Attributes:
        points: N positions of d coordinates each [units; world frame], rounded to DECIMALS.
        program: canonical text of the formation program that draws them; empty if they were given as points.
    """

    points: tuple[tuple[Coordinate, ...], ...]
    program: Annotated[str, msgspec.Meta(max_length=MAX_PROGRAM_BYTES)] = ""

    def __post_init__(self) -> None:
        given = np.array(self.points, dtype=np.float64).reshape(len(self.points), -1)
        array = given.round(DECIMALS) + 0.0  # adding zero turns -0.0 into 0.0
        if array.tobytes() != given.tobytes():
            rows: list[list[float]] = array.tolist()
            msgspec.structs.force_setattr(self, "points", tuple(map(tuple, rows)))

    @cached_property
    def array(self) -> Points:
        """The same positions, shape (n, d), read-only [units]."""
        array = np.array(self.points, dtype=np.float64)
        array.setflags(write=False)
        return array

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits that identify the content."""
        content = self.array.astype("<f8").tobytes() + self.program.encode(errors="surrogatepass")
        return hashlib.blake2b(content, digest_size=8).hexdigest()

    @classmethod
    def of(cls, points: Iterable[Iterable[float]], program: str = "") -> Plan:
        """A plan from any rows of numbers, shape (n, d) [units]."""
        return cls(tuple(tuple(float(x) for x in row) for row in points), program)

    def __len__(self) -> int:
        return len(self.points)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Plan) and self.digest == other.digest

    def __ne__(self, other: object) -> bool:
        return not self == other  # a Struct has one of its own, which does not ask __eq__

    def __hash__(self) -> int:
        return hash(self.digest)
