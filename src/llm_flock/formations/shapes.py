"""The named shapes: their legal team sizes, their descriptions for prompts, and their ideal target points.

Neighbouring points of a named shape are exactly `spacing` apart in a straight line (on a circle: the chord, not the
arc). The paper's shapes are triangle 3 and 6, square 4 and 8, cross 5, circle 5 and 10 (lines 240 and 544).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from llm_flock.arrays import Points
from llm_flock.errors import InputError, unknown
from llm_flock.formations import layouts


@dataclass(frozen=True, slots=True)
class ShapeInfo:
    """Description of a shape for operators.

    Attributes:
        name: specification of the shape, with its argument in capitals: `circle`, `polygon:K`.
        legal: its legal team sizes, in words that follow "N is".
        description: the shape in words that follow "form".
        examples: a few legal team sizes (for `polygon:K`: with K = 5).
    """

    name: str
    legal: str
    description: str
    examples: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Shape(ShapeInfo):
    """A shape with its layout, and the test of a team size; both take n and the argument K (0 without one)."""

    layout: Callable[[int, int], Points] | None = None
    is_legal: Callable[[int, int], bool] = lambda n, _: n >= 1


_LISTED = (
    _Shape("line", "any number", "a straight line", (2, 5, 10), layouts.line),
    _Shape(
        "triangle",
        "divisible by 3",
        "an equilateral triangle (robots along its perimeter)",
        (3, 6, 9),
        layouts.triangle,
        lambda n, _: n % 3 == 0,
    ),
    _Shape(
        "square",
        "divisible by 4",
        "a square (robots along its perimeter)",
        (4, 8, 12),
        layouts.square,
        lambda n, _: n % 4 == 0,
    ),
    _Shape("circle", "any number", "a circle", (3, 5, 10), layouts.circle),
    _Shape(
        "polygon:K",
        "divisible by K",
        "a regular polygon with K sides (robots along its perimeter)",
        (5, 10, 15),
        layouts.polygon,
        lambda n, sides: n % sides == 0,
    ),
    _Shape(
        "cross",
        "5, 9, 13, ... (the centre and four equal arms)",
        "a cross with four equal arms at right angles and one robot at its centre",
        (5, 9, 13),
        layouts.cross,
        lambda n, _: n >= 5 and n % 4 == 1,
    ),
    _Shape(
        "wedge",
        "at least 3",
        "a wedge like the letter V (two straight arms that meet at 90 degrees, one robot at the tip)",
        (3, 5, 10),
        layouts.wedge,
        lambda n, _: n >= 3,
    ),
    _Shape("grid", "any number", "a square grid (rows and columns at right angles)", (4, 9, 12), layouts.grid),
    _Shape(
        "star",
        "divisible by 10",
        "a five-pointed star (robots along its outline: ten equal edges, tips of 60 degrees)",
        (10, 20, 30),
        layouts.star,
        lambda n, _: n % 10 == 0,
    ),
    _Shape("points", "as many as there are points", "a custom shape given by its points", (3, 10)),
    _Shape("text:DESCRIPTION", "any number", "whatever the words say", (4, 10)),
)
MOST_TRIED = 10_000
"""Largest number of robots that an error tries in order to list the numbers that a shape takes."""

_SHAPES = {shape.name.partition(":")[0]: shape for shape in _LISTED}


def shapes() -> tuple[ShapeInfo, ...]:
    """All shapes, in the order in which the command line lists them."""
    return _LISTED


def shape_name(spec: str) -> str:
    """The part of a shape specification before the colon.

    Raises:
        InputError: no shape has this name.
    """
    name = spec.partition(":")[0]
    if name not in _SHAPES:
        raise InputError("shape", spec, says=unknown("shape", name, (shape.name for shape in _LISTED)))
    return name


def _argument(spec: str) -> int:
    """Number of sides of `polygon:K`, 0 for other shapes. Checks the argument of every specification."""
    name, (_, colon, argument) = shape_name(spec), spec.partition(":")
    if name == "text":
        if not argument.strip():
            raise InputError("shape", spec, "a description of the shape after 'text:'")
    elif name == "polygon":
        if not (argument.isascii() and argument.isdecimal() and len(argument) <= 9 and int(argument) >= 3):
            raise InputError("shape", spec, "polygon:K with a whole number K >= 3")
        return int(argument)
    elif colon:
        raise InputError("shape", spec, f"{name!r} alone: it takes no argument")
    return 0


def describe(spec: str) -> str:
    """The shape in words that follow "form": `a circle`; for `text:DESCRIPTION`, the description itself.

    Raises:
        InputError: no shape has this name, or its argument is not allowed.
    """
    sides, name = _argument(spec), shape_name(spec)
    if name == "text":
        return " ".join(spec.partition(":")[2].split())
    return _SHAPES[name].description.replace(" K ", f" {sides} ")


def ideal_points(
    spec: str, n: int, center: Sequence[float], spacing: float, custom: Sequence[Sequence[float]] | None = None
) -> Points | None:
    """Ideal target points of a shape in its reference orientation, with their mean at `center`.

    Args:
        spec: name of a shape, with its argument if it takes one.
        n: number of points.
        center: d coordinates [units; world frame]; named shapes need d = 2.
        spacing: distance between neighbouring points [units].
        custom: points of the shape `points`, n rows [units]; only their position relative to their mean counts.

    Returns:
        shape (n, d) [units; world frame], or None for free text, which has no known ideal.

    Raises:
        InputError: no shape has this name, or the shape does not exist for this number of points or dimensions.
    """
    name, argument = shape_name(spec), _argument(spec)
    shape = _SHAPES[name]
    if name == "points":
        points = _custom(n, len(center), custom)
    else:
        if not (n >= 1 and shape.is_legal(n, argument)):
            legal = [str(k) for k in range(1, MOST_TRIED) if shape.is_legal(k, argument)][:4]
            sizes = ", ".join([*legal, "..."]) if legal else shape.legal.replace(" K", f" {argument}")
            raise InputError("n_robots", n, says=f"a {spec} takes {sizes} robots")
        if shape.layout is None:
            return None
        if len(center) != 2:
            raise InputError("center", list(center), f"2 coordinates for shape {spec!r}")
        points = shape.layout(n, argument) * spacing
    return points - points.mean(axis=0) + np.asarray(center, dtype=np.float64)


def _custom(n: int, dim: int, custom: Sequence[Sequence[float]] | None) -> Points:
    if not custom:
        raise InputError("points", custom, "at least one row of coordinates for shape 'points'")
    if len(custom) != n:
        raise InputError("n_robots", n, f"{len(custom)}, one for each point")
    if any(len(row) != dim for row in custom):
        raise InputError("points", f"{len(custom)} rows", f"{dim} coordinates in each row, as the centre has")
    return np.array(custom, dtype=np.float64)
