"""The named shapes: their legal team sizes, their descriptions for prompts, and their ideal target points.

Neighbouring points of a named shape are exactly `spacing` apart in a straight line (on a circle: the chord, not the
arc). The paper's shapes are triangle 3 and 6, square 4 and 8, cross 5, circle 5 and 10 (lines 240 and 544).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from llm_flock.arrays import Pairwise, Points, grid_rows
from llm_flock.errors import InputError, unknown
from llm_flock.printable import shape_title

SMALL = 50
"""Largest number of points measured without scipy.spatial, which takes longer to import than a small run takes."""


def distances(points: ArrayLike) -> Pairwise:
    """Distances between all points, shape (n, n) [units], exactly symmetric."""
    rows = np.asarray(points, dtype=np.float64)
    if len(rows) > SMALL:
        return scipy.spatial.distance.cdist(rows, rows)
    # Axis by axis: scipy sums in this order too, so the size of a team does not change a bit.
    return np.sqrt(sum((axis[:, None] - axis) ** 2 for axis in rows.T))


def smallest_distance(points: ArrayLike) -> float:
    """Distance of the closest pair of points, shape (n, d) [units]; infinite for fewer than two."""
    rows = np.asarray(points, dtype=np.float64)
    if len(rows) < 2:
        return math.inf
    if len(rows) <= SMALL:
        return float(distances(rows)[np.triu_indices(len(rows), 1)].min())
    return float(np.asarray(scipy.spatial.KDTree(rows).query(rows, k=2)[0])[:, 1].min())


def widest_gap(points: ArrayLike) -> float:
    """The smallest range within which all points, shape (n, d), are connected [units]; zero for a single point."""
    tree = scipy.sparse.csgraph.minimum_spanning_tree(distances(points))
    return float(tree.max()) if tree.nnz else 0.0


def circumradius(points: ArrayLike, center: Sequence[float]) -> float:
    """Largest distance of the points, shape (n, d), from the centre [units]."""
    return float(np.linalg.norm(np.asarray(points, dtype=np.float64) - np.asarray(center), axis=1).max())


def rotated(points: ArrayLike, center: Sequence[float], angle_rad: float) -> Points:
    """Points, shape (n, d), rotated about the centre, counterclockwise for a positive angle; in space, about axis 3."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    out, middle = np.array(points, dtype=np.float64), np.asarray(center)[:2]
    out[:, :2] = (out[:, :2] - middle) @ np.array([[cos, sin], [-sin, cos]]) + middle
    return out


def rotational_symmetry(points: ArrayLike, tolerance: float = 1e-9) -> int:
    """Largest k such that a rotation by 360/k degrees about the mean maps the set of points, shape (n, d), to itself.

    It is 1 without symmetry, for a single point, and in dimensions other than two. `tolerance` is the largest distance
    of an image from a point, as a share of the largest radius.
    """
    rows = np.asarray(points, dtype=np.float64)
    n, dim = rows.shape
    if dim != 2 or n < 2:
        return 1
    rows = rows - rows.mean(axis=0)
    allowed = tolerance * circumradius(rows, (0.0, 0.0))
    tree = scipy.spatial.KDTree(rows)
    # Points other than one at the mean form orbits of k points, so k divides n or n - 1.
    for k in range(n, 1, -1):
        if n % k > 1:
            continue
        offset, image = map(np.asarray, tree.query(rotated(rows, (0.0, 0.0), 2 * math.pi / k)))
        if offset.max() <= allowed and len(np.unique(image)) == n:
            return k
    return 1


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
    return grid_rows(n)


def star(n: int, _: int = 0) -> Points:
    """A regular pentagon with an equilateral triangle on each side; all ten edges have the same length."""
    edge = n // 10
    tip = edge * (math.cos(math.pi / 5) / (2 * math.sin(math.pi / 5)) + math.sqrt(0.75))
    tips = ring(5, tip, math.pi / 2)
    dents = ring(5, circumradius_of(5, edge), math.pi / 2 + math.pi / 5)
    return outline(np.stack([tips, dents], axis=1).reshape(-1, 2), edge)


@dataclass(frozen=True, slots=True)
class ShapeInfo:
    """Description of a shape for operators."""

    name: str  #: Specification of the shape, with its argument in capitals: `circle`, `polygon:K`.
    legal: str  #: Its legal team sizes, as text that follows "N is".
    description: str  #: The shape as text that follows "form".
    examples: tuple[int, ...]  #: A few legal team sizes (for `polygon:K`: with K = 5).
    #: Its points, by n and the argument K (0 without one); None if they are given otherwise.
    layout: Callable[[int, int], Points] | None = None
    is_legal: Callable[[int, int], bool] = lambda n, _: n >= 1  #: Whether it exists for n and K.
    in_space: bool = False  #: Whether it needs three dimensions.


_LISTED = (
    ShapeInfo("line", "any number", "a straight line", (2, 5, 10), line),
    ShapeInfo(
        "triangle",
        "divisible by 3",
        "an equilateral triangle (robots along its perimeter)",
        (3, 6, 9),
        triangle,
        lambda n, _: n % 3 == 0,
    ),
    ShapeInfo(
        "square",
        "divisible by 4",
        "a square (robots along its perimeter)",
        (4, 8, 12),
        square,
        lambda n, _: n % 4 == 0,
    ),
    ShapeInfo("circle", "any number", "a circle", (3, 5, 10), circle),
    ShapeInfo(
        "polygon:K",
        "divisible by K",
        "a regular polygon with K sides (robots along its perimeter)",
        (5, 10, 15),
        polygon,
        lambda n, sides: n % sides == 0,
    ),
    ShapeInfo(
        "cross",
        "5, 9, 13, ... (the centre and four equal arms)",
        "a cross with four equal arms at right angles and one robot at its centre",
        (5, 9, 13),
        cross,
        lambda n, _: n >= 5 and n % 4 == 1,
    ),
    ShapeInfo(
        "wedge",
        "at least 3",
        "a wedge like the letter V (two straight arms that meet at 90 degrees, one robot at the tip)",
        (3, 5, 10),
        wedge,
        lambda n, _: n >= 3,
    ),
    ShapeInfo("grid", "any number", "a square grid (rows and columns at right angles)", (4, 9, 12), grid),
    ShapeInfo(
        "star",
        "divisible by 10",
        "a five-pointed star (robots along its outline: ten equal edges, tips of 60 degrees)",
        (10, 20, 30),
        star,
        lambda n, _: n % 10 == 0,
    ),
    ShapeInfo("points", "as many as there are points", "a custom shape given by its points", (3, 10)),
    ShapeInfo("text:DESCRIPTION", "any number", "whatever the words say", (4, 10)),
)

_DRAWN = (
    ShapeInfo("letters:TEXT", "enough for every stroke", "letters and digits", (20, 30)),
    *(
        ShapeInfo(name, legal, f"{what} in space ({how})", sizes, in_space=True)
        for name, legal, what, how, sizes in (
            ("sphere", "any number", "a sphere", "robots on its surface", (12, 30)),
            ("dome", "any number", "a half sphere", "robots on its surface", (10, 20)),
            ("cylinder", "any number", "an upright cylinder", "robots on its wall", (12, 30)),
            ("helix", "at least 2", "an upright helix", "two turns", (10, 20)),
            ("cube", "at least 8", "a cube", "rows, columns and layers", (8, 27)),
            ("pyramid", "at least 5", "a pyramid", "square layers", (5, 14)),
        )
    ),
    ShapeInfo("outline:FILE", "enough for every stroke", "the outlines of an SVG drawing", ()),
    ShapeInfo("program:FILE", "enough for every stroke", "what a formation program draws", ()),
)

_SHAPES = {shape.name.partition(":")[0]: shape for shape in (*_LISTED, *_DRAWN)}


def shapes() -> tuple[ShapeInfo, ...]:
    """All shapes with points or words of their own, in the order in which the command line lists them."""
    return _LISTED


def drawn_shapes() -> tuple[ShapeInfo, ...]:
    """Shapes that a formation program draws (`llm_flock.formation`), in the order in which they are listed."""
    return _DRAWN


def shape_name(spec: str) -> str:
    """The part of a shape specification before the colon.

    Raises:
        InputError: no shape has this name.
    """
    name = spec.partition(":")[0]
    if name not in _SHAPES:
        raise InputError("shape", spec, says=unknown("shape", name, (shape.name for shape in (*_LISTED, *_DRAWN))))
    return name


def _argument(spec: str) -> int:
    """Number of sides of `polygon:K`, 0 for other shapes. Checks the argument of every specification."""
    name, (_, colon, argument) = shape_name(spec), spec.partition(":")
    if name == "outline":
        raise InputError("shape", spec, says="only configurations and flags read outline:FILE, as a program")
    if name == "text":
        if not argument.strip():
            raise InputError("shape", spec, "a description of the shape after 'text:'")
    elif name == "polygon":
        if not (argument.isascii() and argument.isdecimal() and len(argument) <= 9 and int(argument) >= 3):
            raise InputError("shape", spec, "polygon:K with a whole number K >= 3")
        return int(argument)
    elif colon and name not in ("letters", "program"):
        raise InputError("shape", spec, f"{name!r} alone: it takes no argument")
    return 0


def describe(spec: str) -> str:
    """The shape as text that follows "form": `a circle`; for `text:DESCRIPTION`, the description itself.

    Raises:
        InputError: no shape has this name, or its argument is not allowed.
    """
    sides, name = _argument(spec), shape_name(spec)
    if name == "text":
        return " ".join(spec.partition(":")[2].split())
    if name in ("letters", "program"):
        return f"the {name} {shape_title(spec).partition(':')[2]}".rstrip()
    return _SHAPES[name].description.replace(" K ", f" {sides} ")


def names_file(spec: object) -> bool:
    """Whether a shape is to be read from a file: `points:FILE`, `outline:FILE` or `program:FILE`."""
    name, colon, rest = spec.partition(":") if isinstance(spec, str) else ("", "", "")
    return bool(colon) and (name in ("points", "outline") or (name == "program" and rest.lstrip()[:1] != "{"))


def is_drawn(spec: str) -> bool:
    """Whether a formation program draws the shape; InputError if no shape has this name."""
    return _SHAPES[shape_name(spec)] in _DRAWN


def in_space(spec: str) -> bool:
    """Whether a shape needs three dimensions; InputError as for `shape_name`."""
    if spec.partition(":")[0] != "program":
        return _SHAPES[shape_name(spec)].in_space
    from llm_flock.formation import program_of

    program = program_of(spec)
    return program is not None and program.in_space


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
        shape (n, d) [units; world frame], or None for free text, which has no known ideal. What a program draws
        has at least `spacing` between neighbours, not exactly that.

    Raises:
        InputError: no shape has this name, the shape does not exist for this number of points or dimensions, or a
            program cannot be drawn.
    """
    name, argument = shape_name(spec), _argument(spec)
    shape = _SHAPES[name]
    if name == "points":
        points = _custom(n, len(center), custom)
    elif shape in _DRAWN:
        if len(center) != 3 and in_space(spec):
            raise InputError("center", list(center), f"3 coordinates for shape {shape_title(spec)!r}")
        from llm_flock.formation import program_of, program_points

        program = program_of(spec)
        assert program is not None, "all shapes that are drawn are programs"
        points = program_points(program, n, len(center), spacing)
    else:
        if not (n >= 1 and shape.is_legal(n, argument)):
            legal = [str(k) for k in range(1, 10_000) if shape.is_legal(k, argument)][:4]
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
