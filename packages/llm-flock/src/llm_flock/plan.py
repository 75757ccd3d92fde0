"""A formation plan: target positions in a fixed order, compared by content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cached_property, lru_cache
from typing import Annotated

import msgspec
import numpy as np
from msgspec.structs import force_setattr, replace

from llm_flock.arrays import MAX_COORDINATE, Point, Points, moved
from llm_flock.bounds import MAX_LENGTH, MAX_PROGRAM_BYTES, MAX_ROBOTS
from llm_flock.errors import InputError
from llm_flock.shapes import rotated

DECIMALS = 6  #: Decimals of plan coordinates, so that equal plans are equal on every robot.

Coordinate = Annotated[float, msgspec.Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
"""A coordinate that a message may have; the bounds are checked when it is decoded."""

Length = Annotated[float, msgspec.Meta(gt=0, le=MAX_LENGTH)]


class Drawing(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """Where a formation program puts a team: `llm_flock.formation.program_points`, scaled, turned and moved."""

    program: Annotated[str, msgspec.Meta(max_length=MAX_PROGRAM_BYTES)]  #: Its canonical text.
    places: Annotated[int, msgspec.Meta(ge=1, le=MAX_ROBOTS)]  #: Their number N.
    spacing: Length  #: Distance between neighbours before `scale` [units].
    center: tuple[Coordinate, ...]  #: Mean of the places, d coordinates [units; world frame].
    scale: Length = 1.0
    turn_rad: Coordinate = 0.0  #: About the centre, anticlockwise; in space, about the third axis.

    def __post_init__(self) -> None:
        force_setattr(self, "center", tuple(round(x, DECIMALS) + 0.0 for x in self.center))

    def placed(self, points: Points) -> Points:
        """Points around the origin as this drawing scales, turns and moves them, shape (n, d) [units]."""
        return rotated(self.scale * points, (0.0, 0.0), self.turn_rad) + np.array(self.center)


@lru_cache(maxsize=256)
def _drawn(drawing: Drawing) -> tuple[Point, ...]:
    from llm_flock.formation import parse_program, program_points

    program, dim = parse_program(drawing.program), len(drawing.center)
    rows = drawing.placed(program_points(program, drawing.places, dim, drawing.spacing)).round(DECIMALS) + 0.0
    if not float(np.abs(rows).max()) <= MAX_COORDINATE:
        raise InputError("program", None, f"places of coordinates up to {MAX_COORDINATE:g}")
    return tuple(map(tuple, rows.tolist()))


class Plan(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True, eq=False, dict=True):
    """N target positions p_1 .. p_N (paper, section 3.1), hashable and comparable by content.

    Attributes:
        given: N positions of d coordinates each [units; world frame], rounded to DECIMALS; empty with a drawing.
        drawing: what a formation program draws, in place of positions.
    """

    given: tuple[tuple[Coordinate, ...], ...] = ()
    drawing: Drawing | None = None

    def __post_init__(self) -> None:
        if self.drawing is not None:
            if self.given:
                raise ValueError("a plan has positions or a drawing")
            return
        given = np.array(self.given, dtype=np.float64).reshape(len(self.given), -1)
        array = given.round(DECIMALS) + 0.0  # adding zero turns -0.0 into 0.0
        if array.tobytes() != given.tobytes():
            rows: list[list[float]] = array.tolist()
            force_setattr(self, "given", tuple(map(tuple, rows)))

    @cached_property
    def points(self) -> tuple[Point, ...]:
        """The N positions [units; world frame]; InputError if the program cannot be drawn, which `decode` checks."""
        return self.given if self.drawing is None else _drawn(self.drawing)

    @property
    def program(self) -> str:
        """Canonical text of the formation program that draws the positions; empty if they were given."""
        return "" if self.drawing is None else self.drawing.program

    @cached_property
    def array(self) -> Points:
        """The same positions, shape (n, d), read-only [units]."""
        array = np.array(self.points, dtype=np.float64)
        array.setflags(write=False)
        return array

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits that identify the content."""
        if self.drawing is not None:
            return hashlib.blake2b(msgspec.msgpack.encode(self.drawing), digest_size=8, person=b"drawing").hexdigest()
        return hashlib.blake2b(self.array.astype("<f8").tobytes(), digest_size=8).hexdigest()

    @classmethod
    def of(cls, points: Iterable[Iterable[float]]) -> Plan:
        """A plan from any rows of numbers, shape (n, d) [units]."""
        return cls(tuple(tuple(float(x) for x in row) for row in points))

    def mapped(self, origin: Point, unit: float = 1.0) -> Plan:
        """The plan with each point x at `origin + unit * x` [units]; the plan itself if `origin` is empty."""
        if not origin:
            return self
        if self.drawing is None:
            return Plan.of(moved(origin, x, unit) for x in self.given)
        center = moved(origin, self.drawing.center, unit)
        return Plan(drawing=replace(self.drawing, center=center, scale=self.drawing.scale * unit))

    def __len__(self) -> int:
        return len(self.given) if self.drawing is None else self.drawing.places

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Plan) and self.digest == other.digest

    def __ne__(self, other: object) -> bool:
        return not self == other  # a Struct has one of its own, which does not ask __eq__

    def __hash__(self) -> int:
        return hash(self.digest)
