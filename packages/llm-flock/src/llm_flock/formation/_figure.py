"""Draws a program: its elements as strokes, areas, surfaces and lattices, in the program's own coordinates."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from llm_flock.arrays import Points, grid_rows
from llm_flock.errors import InputError
from llm_flock.formation._letters import GAP, GLYPHS
from llm_flock.formation._paths import strokes_of
from llm_flock.formation._program import SPACE, Element, Repeat

MAX_CORNERS = 2_000  #: Most corners of all polylines of a drawing: each pair of sides is compared.
MAX_COPIES = 500  #: Most elements after repetition.
MAX_SAMPLES = 1_000_000  #: Most points from which the places in an area are chosen.
WIDEST = 1e9  #: Largest coordinate of what is drawn, before it is scaled.

Affine: TypeAlias = NDArray[np.float64]
"""A map of space, shape (4, 4), for columns [x, y, z, 1]."""

GOLDEN = math.pi * (3 - math.sqrt(5))  #: Angle between one of many evenly spread points and the next [rad].


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A piece of a plane or surface. All in its own coordinates; `world` maps them to the drawing's."""

    world: Affine
    area: float  #: In the drawing's coordinates.
    sample: Callable[[int], Points]  #: About this number of points, evenly spread, shape (m, 3).
    onto: Callable[[Points], Points]  #: The points of the region that points near it stand for.


@dataclass(frozen=True, slots=True, kw_only=True)
class Lattice:
    """Places in rows or layers; its corners come first."""

    world: Affine
    room: Callable[[float], float]  #: About how many places it has at a spacing in the drawing's coordinates.
    least: int  #: Its corners, the fewest places that show it.
    places: Callable[[int], Points]  #: The places of the smallest such body with at least n, shape (m, 3), m >= n.


@dataclass(slots=True)
class Sketch:
    """What a program draws."""

    strokes: list[Points] = field(default_factory=list[Points])  #: Polylines, shape (m, 3).
    regions: list[Region] = field(default_factory=list[Region])
    lattices: list[Lattice] = field(default_factory=list[Lattice])
    copies: int = 0
    polygons: list[tuple[Any, Affine]] = field(default_factory=list[tuple[Any, Affine]])  #: Areas, not yet united.
    corners: list[Points] = field(
        default_factory=list[Points]
    )  #: All corners, also of areas, and of boxes round bodies.


def draw(elements: Sequence[Element]) -> Sketch:
    """Draw elements, one over the other, scaled to a width of 1.

    Raises:
        InputError: too much to draw, or a filled outline is open or crosses itself.
    """
    drawing, whole = Sketch(), Sketch()
    for element in elements:
        _draw(element, np.eye(4), whole)
    width = float(np.ptp(np.concatenate(whole.corners or [np.zeros((1, 3))]), axis=0).max()) or 1.0
    for element in elements:
        _draw(element, np.diag([1 / width] * 3 + [1.0]), drawing)
    drawing.regions = [*_united(drawing.polygons), *drawing.regions]
    return drawing


def _draw(element: Element, outer: Affine, into: Sketch) -> None:
    inner = _own_map(element)
    for _ in range(element.repeat.times if element.repeat else 1):
        own = outer @ inner
        into.copies += 1
        if into.copies > MAX_COPIES:
            raise InputError("repeat", None, f"at most {MAX_COPIES} elements in all, with their repetitions")
        if element.union is not None:
            for part in element.union:
                _draw(part.model_copy(update={"fill": part.fill or element.fill}), own, into)
        elif element.shape == "grid":
            area = 4 * float(np.linalg.norm(np.cross(own[:3, 0], own[:3, 1])))
            _add_corners([mapped(_grid(4), own)], into)
            into.lattices.append(Lattice(world=own, room=lambda s, area=area: area / s**2, least=1, places=_grid))
        elif element.shape in SPACE:
            _draw_in_space(element, own, into)
        else:
            _draw_strokes(element, own, into)
        inner = _step_map(element.repeat) @ inner if element.repeat else inner


def _draw_strokes(element: Element, world: Affine, into: Sketch) -> None:
    strokes = [np.array(stroke, dtype=np.float64) for stroke in _strokes(element)]
    if not strokes or not all(map(len, strokes)):
        raise InputError("draw", None, says="a path draws nothing")
    _add_corners([mapped(stroke, world) for stroke in strokes], into)
    if element.fill:
        into.polygons.append((_polygon(element, strokes), world))
        return
    for stroke in strokes:
        if len(stroke) > 3 and (stroke[0] == stroke[-1]).all() and element.points is not None:
            _check_simple(stroke)
        into.strokes.append(mapped(stroke, world))


def _add_corners(corners: list[Points], into: Sketch) -> None:
    into.corners += corners
    if (count := sum(map(len, into.corners))) > MAX_CORNERS:
        raise InputError(
            "draw", None, f"at most {MAX_CORNERS:,} corners in all, curves counted in pieces (here {count:,})"
        )
    if not all((np.abs(rows) <= WIDEST).all() for rows in corners):  # nor what is no number
        raise InputError("draw", None, f"coordinates up to {WIDEST:g}")


def mapped(points: Points, world: Affine) -> Points:
    rows = np.zeros((len(points), 3))
    rows[:, : points.shape[1]] = points
    return rows @ world[:3, :3].T + world[:3, 3]


def _strokes(element: Element) -> list[list[tuple[float, ...]]]:
    """Corners of an element's polylines, y upwards; closed ones end where they begin."""
    if element.points is not None:
        dim = max(map(len, element.points))
        rows = [(*row, 0.0)[:dim] for row in element.points]
        return [[*rows, rows[0]] if element.closed or element.fill else rows]
    if element.path is not None:
        return [[(z.real, -z.imag) for z in stroke] for stroke in strokes_of(element.path)]
    if element.text is not None:
        return _letters(element.text)
    start, end = element.arc or (0.0, 360.0)
    match element.shape:
        case "line":
            return [[(-1.0, 0.0), (1.0, 0.0)]]
        case "cross":
            return [[(-1.0, 0.0), (1.0, 0.0)], [(0.0, -1.0), (0.0, 1.0)]]
        case "wedge":
            return [[(-1.0, -1.0), (0.0, 0.0), (1.0, -1.0)]]
        case "circle":
            return [_ring(max(4, math.ceil((end - start) / 5)), 1.0, start, end)]
        case "star":  # all ten edges of one length, tips of 60 degrees, as the shape of a mission has them
            inner = 1 / (math.cos(math.pi / 5) + 2 * math.sin(math.pi / 5) * math.sqrt(0.75))
            tips, dents = _ring(5, 1.0, 90.0, 450.0), _ring(5, inner, 126.0, 486.0)
            return [[corner for pair in zip(tips, dents, strict=True) for corner in pair][:-1]]
        case "square":
            return [_ring(4, math.sqrt(2), 45.0, 405.0)]
        case _:
            return [_ring(element.sides or 3, 1.0, 90.0, 450.0)]


def _ring(sides: int, radius: float, start: float, end: float) -> list[tuple[float, ...]]:
    angles = [math.radians(start + (end - start) * k / sides) for k in range(sides + 1)]
    ring = [(radius * math.cos(a), radius * math.sin(a)) for a in angles]
    return [*ring[:-1], ring[0] if end - start == 360.0 else ring[-1]]


def _letters(text: str) -> list[list[tuple[float, ...]]]:
    strokes: list[list[tuple[float, ...]]] = []
    x = 0.0
    for letter in text:
        width, path = GLYPHS[letter]
        strokes += [[(x + z.real, 10.0 - z.imag) for z in stroke] for stroke in strokes_of(path)]
        x += width + GAP
    return strokes


def _own_map(element: Element) -> Affine:
    scale = element.scale if isinstance(element.scale, tuple) else (element.scale,) * 3
    grow, flip = np.diag([*scale, 1.0, 1.0][:3] + [1.0]), np.eye(4)
    if element.mirror is not None:
        flip["xyz".index(element.mirror), "xyz".index(element.mirror)] = -1.0
    turn = element.turn if element.point is None else -90.0 * ("north", "east", "south", "west").index(element.point)
    return _shift(element.move) @ _about(0, element.tilt) @ _about(2, turn) @ flip @ grow


def _step_map(repeat: Repeat) -> Affine:
    return _shift(repeat.move) @ _about(2, repeat.turn) @ np.diag([repeat.scale] * 3 + [1.0])


def _shift(move: Sequence[float] | None) -> Affine:
    world = np.eye(4)
    world[: len(move or ()), 3] = move or ()
    return world


def _about(axis: int, degrees: float) -> Affine:
    """The turn about an axis, exact for right angles."""
    cos, sin = (round(f(math.radians(degrees)), 15) for f in (math.cos, math.sin))
    world, (a, b) = np.eye(4), ((axis + 1) % 3, (axis + 2) % 3)
    world[[a, a, b, b], [a, b, a, b]] = cos, -sin, sin, cos
    return world


# ---------------------------------------------------------------- areas


def _check_simple(stroke: Points) -> None:
    """Refuse a closed outline that crosses itself."""
    import shapely

    ring = shapely.LinearRing(stroke[:, :2])
    if not ring.is_simple:
        why = shapely.is_valid_reason(shapely.Polygon(stroke[:, :2]))
        place = why.partition("[")[2].rstrip("]") or "a place"
        raise InputError("draw", None, says=f"a closed outline crosses itself at {place}; draw its parts as a union")


def _polygon(element: Element, strokes: list[Points]) -> Any:
    """The area inside outlines of the plane; what is inside an even number of them is a hole."""
    import shapely

    area: Any = shapely.Polygon()
    for stroke in strokes:
        if stroke.shape[1] > 2 and stroke[:, 2].any():
            raise InputError("fill", True, says="fills outlines of the plane only: give tilt or move for the whole")
        apart = float(np.abs(stroke[0] - stroke[-1]).max())
        if len(stroke) < 4 or apart > 1e-6 * float(np.ptp(stroke, axis=0).max()):
            ends = f"it begins at {_at(stroke[0])} and ends at {_at(stroke[-1])}"
            raise InputError("fill", True, says=f"the outline is open: {ends}; a path is closed by Z")
        _check_simple(stroke)
        area = area.symmetric_difference(shapely.Polygon(stroke[:, :2]))
    if area.area <= 0:
        raise InputError("fill", True, says="there is no area inside the outline")
    return area


def _at(point: NDArray[np.float64]) -> str:
    return f"[{', '.join(f'{x + 0.0:.4g}' for x in point.tolist())}]"


def _united(polygons: list[tuple[Any, Affine]]) -> list[Region]:
    """Areas at one height as one; others as they are."""
    import shapely
    from shapely import affinity

    level: dict[float, list[Any]] = {}
    regions: list[Region] = []
    for area, world in polygons:
        if world[2, :2].any():
            regions.append(_area(area, world))
        else:
            (a, b), (c, d) = world[:2, :2].tolist()
            moved = affinity.affine_transform(area, [a, b, c, d, *world[:2, 3].tolist()])
            level.setdefault(round(float(world[2, 3]), 9), []).append(moved)
    return [*(_area(shapely.unary_union(areas), _shift((0.0, 0.0, z))) for z, areas in level.items()), *regions]


def _area(area: Any, world: Affine) -> Region:
    import shapely

    def sample(count: int) -> Points:
        box: Points = np.array(area.bounds, dtype=np.float64).reshape(2, 2)
        width: Points = box[1] - box[0]
        m = math.ceil(count * float(np.prod(width)) / float(area.area))
        if m > MAX_SAMPLES:
            raise InputError("fill", True, says="the area is too thin to be filled; draw it as a line")
        # Multiples of powers of the plastic number: evenly spread, no two distances are equal.
        steps = np.arange(1, m + 1, dtype=np.float64)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])
        rows: Points = box[0] + width * ((0.5 + steps) % 1)
        return _in_space(rows[shapely.contains_xy(area, rows[:, 0], rows[:, 1])])

    def onto(points: Points) -> Points:
        spots: Any = shapely.points(points[:, :2])
        lines: Any = cast("Any", shapely).shortest_line(area, spots)
        near: Points = shapely.get_coordinates(lines).reshape(-1, 2, 2)[:, 0]
        inside = np.asarray(shapely.contains(area, spots), dtype=bool)
        return _in_space(np.where(inside[:, None], points[:, :2], near))

    grown = float(np.linalg.norm(np.cross(world[:3, 0], world[:3, 1])))
    return Region(world=world, area=area.area * grown, sample=sample, onto=onto)


def _in_space(rows: Points) -> Points:
    return np.column_stack([rows, np.zeros(len(rows))])


# ---------------------------------------------------------------- space


def _draw_in_space(element: Element, world: Affine, into: Sketch) -> None:
    grown = abs(float(np.linalg.det(world[:3, :3])))
    _add_corners([mapped(_cube(8), world)], into)
    match element.shape:
        case "helix":
            turns = element.turns or 2.0
            if 36 * turns > MAX_CORNERS:
                raise InputError("turns", turns, f"at most {MAX_CORNERS // 36}")
            share = np.linspace(0.0, 1.0, math.ceil(36 * turns) + 1)
            angle = 2 * math.pi * turns * share
            into.strokes.append(mapped(np.column_stack([np.cos(angle), np.sin(angle), 2 * share - 1]), world))
            _add_corners(into.strokes[-1:], into)
        case "cube":
            into.lattices.append(Lattice(world=world, room=lambda s: 8 * grown / s**3, least=8, places=_cube))
        case "pyramid":
            into.lattices.append(
                Lattice(world=world, room=lambda s: 4 / 3 * math.sqrt(2) * grown / s**3, least=5, places=_pyramid)
            )
        case _:
            area, sample, onto = _SURFACES[str(element.shape)]
            into.regions.append(Region(world=world, area=area * grown ** (2 / 3), sample=sample, onto=onto))


def _spiral(count: int, low: float, *, round_: bool) -> Points:
    """Points of a spiral around the z axis, evenly spread by area, from z = 1 down to `low`."""
    k = np.arange(count)
    z = 1 - (1 - low) * (k + 0.5) / count
    radius = np.sqrt(1 - z * z) if round_ else np.ones(count)
    return np.column_stack([radius * np.cos(GOLDEN * k), radius * np.sin(GOLDEN * k), z])


def _unit(points: Points) -> Points:
    lengths = np.linalg.norm(points, axis=1, keepdims=True)
    return points / np.where(lengths > 0, lengths, 1.0)


def _onto_dome(points: Points) -> Points:
    return _unit(np.column_stack([points[:, :2], np.maximum(points[:, 2], 0.0)]))


def _onto_cylinder(points: Points) -> Points:
    return np.column_stack([_unit(points[:, :2]), points[:, 2]])


_SURFACES: dict[str, tuple[float, Callable[[int], Points], Callable[[Points], Points]]] = {
    "sphere": (4 * math.pi, lambda m: _spiral(m, -1.0, round_=True), _unit),
    "dome": (2 * math.pi, lambda m: _spiral(m, 0.0, round_=True), _onto_dome),
    "cylinder": (4 * math.pi, lambda m: _spiral(m, -1.0, round_=False), _onto_cylinder),
}
"""Area, points and projection of each surface of radius 1; a cylinder is 2 high and has no lids."""


def _grid(n: int) -> Points:
    rows = grid_rows(n)
    return _in_space((rows - (rows.max(axis=0) + rows.min(axis=0)) / 2) * (2 / max(1.0, float(rows[:, 0].max()))))


def _cube(n: int) -> Points:
    k = 2
    while k**3 < n:
        k += 1
    side = np.linspace(-1.0, 1.0, k)
    places = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    return places[np.argsort(np.abs(places).min(axis=1) < 1, kind="stable")]


def _pyramid(n: int) -> Points:
    """Square layers, each one smaller than the one below, in whose gaps it stands: all edges have one length."""
    k = 2
    while k * (k + 1) * (2 * k + 1) // 6 < n:
        k += 1
    layers: list[Points] = []
    for row in range(k):
        side = (2 * np.arange(row + 1) - row) / (k - 1)
        x, y = np.meshgrid(side, side, indexing="ij")
        height = np.full(x.size, math.sqrt(2) * (0.5 - row / (k - 1)))
        layers.append(np.column_stack([x.ravel(), y.ravel(), height]))
    places = np.concatenate(layers)
    corner = (np.arange(len(places)) == 0) | (np.abs(places[:, :2]).min(axis=1) == 1)
    return places[np.argsort(~corner, kind="stable")]
