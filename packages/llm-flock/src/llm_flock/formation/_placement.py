"""Places N robots on what a program draws, by one rule: equal programs give equal points on every machine."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import scipy

from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.formation._figure import Lattice, Region, Sketch, draw, mapped
from llm_flock.formation._net import Net, along, nearest, net_of
from llm_flock.formation._program import Element, Group, Program, parse_program

DECIMALS = 6  #: Decimals of places for a spacing of 1, as plans have.
MOST_SAMPLES = 20_000  #: Most samples, where that leaves ten for each place.
SAMPLES = 60  #: Samples of an area for each place in it.
MOVES = 60  #: Rounds of Lloyd's algorithm.
BENDS_PAY = 1.25  #: Corners get points of their own, if that makes the largest gap at most this many times longer.
HEXAGON = math.sqrt(0.75)  #: Area of a place in an evenly filled plane, for a spacing of 1.


def program_points(program: Program, n: int, dim: int, spacing: float) -> Points:
    """Places for `n` robots around the origin, shape (n, dim) [units], no two nearer than the spacing.

    Outlines get a point at every end, junction and, where it pays, corner, and the others evenly by length. In areas
    and on surfaces, points start as farthest points (Gonzalez 1985) and become a centroidal Voronoi tessellation
    (Du, Faber, Gunzburger 1999, by Lloyd's algorithm). The drawing is as large as the spacing makes it, or `size`.

    Raises:
        InputError: too few robots to show it, a drawing in space for robots in a plane, a size or offsets without room.
    """
    points = _places(program.text, n, dim, spacing)
    return points - points.mean(axis=0)


@contextmanager
def _drawable() -> Generator[None]:
    """Refuse a program whose numbers geometry cannot bear, whichever library finds that."""
    try:
        with np.errstate(all="ignore"):
            yield
    except InputError:
        raise
    except (ValueError, ArithmeticError, RuntimeError) as error:
        raise InputError("draw", None, says=f"it cannot be drawn: {error}") from None


@lru_cache(maxsize=256)
def drawn_points(text: str, n: int, dim: int) -> Points:
    """About `n` points evenly over what a program in JSON draws, to compare drawings, shape (m, dim).

    Raises:
        InputError: no program, a drawing in space for a plane, or areas or groups that need another number of points.
    """
    program = _parsed(text, dim)
    with _drawable():
        drawing = None if program.draw is None else draw(program.draw)
    if drawing is None or drawing.regions or drawing.lattices:
        return program_points(program, n, dim, 1.0)
    ends: list[Points] = [np.linalg.norm(np.diff(stroke, axis=0), axis=1).cumsum() for stroke in drawing.strokes]
    step = sum(float(end[-1]) for end in ends if len(end)) / n or 1.0
    rows: list[Points] = []
    for stroke, end in zip(drawing.strokes, ends, strict=True):
        at: Points = np.concatenate([np.zeros(1), end])
        spots = [min((k + 0.5) * step, float(at[-1])) for k in range(max(1, round(float(at[-1]) / step)))]
        rows.append(np.array([np.interp(spots, at, stroke[:, k]) for k in range(3)], dtype=np.float64).T)
    return np.concatenate(rows)[:, :dim]


def _parsed(text: str, dim: int) -> Program:
    program = parse_program(text)
    if dim < 3 and program.in_space:
        raise InputError("program", None, says="a drawing in space needs robots in space, with three coordinates")
    return program


@lru_cache(maxsize=256)
def _places(text: str, n: int, dim: int, spacing: float) -> Points:
    program = _parsed(text, dim)
    if program.draw is not None:
        points = spacing * _unit(program.draw, n)
        points = _sized(points, program.size, spacing)
    else:
        points = _grouped(program.groups or (), n, spacing)
    points = points[:, :dim]
    points.setflags(write=False)
    return points


def _sized(points: Points, size: float | None, spacing: float) -> Points:
    """The points at this largest width, which may not be smaller than their own."""
    width = float(np.ptp(points, axis=0).max())
    if size is None or not width:
        return points
    if size < width * (1 - 1e-9):
        raise InputError(
            "size", size, f"at least {width:.4g}, the width that {len(points)} robots need at spacing {spacing:g}"
        )
    return points * (size / width)


def group_sizes(groups: Sequence[Group], n: int) -> list[int]:
    """The robots of each group in a team of `n`; InputError if they are too few."""
    fixed = sum(group.count or 0 for group in groups)
    shares = [0.0 if group.count else group.share for group in groups]
    if n < fixed or (not any(shares) and n != fixed):
        raise InputError("n_robots", n, f"{'at least ' * any(shares)}{fixed}, the robots of all groups")
    parts = largest_remainder(shares, n - fixed) if any(shares) else [0] * len(groups)
    parts = [group.count or part for group, part in zip(groups, parts, strict=True)]
    if 0 in parts:
        raise InputError("n_robots", n, f"more, so that each of the {len(groups)} groups gets a robot")
    return parts


def _grouped(groups: Sequence[Group], n: int, spacing: float) -> Points:
    rows: list[Points] = []
    for group, part in zip(groups, group_sizes(groups, n), strict=True):
        points = _sized(spacing * _unit(group.draw, part), group.size, spacing)
        at = np.array([*group.at, 0.0][:3])
        rows.append(points - points.mean(axis=0) + at)
    points = np.concatenate(rows)
    if len(points) > 1 and (closest := nearest(points)) < spacing * (1 - 1e-9):
        says = f"places of two groups are {closest:.4g} apart, at least spacing = {spacing:g} is required"
        raise InputError("at", [list(group.at) for group in groups], says=says)
    return points


def _unit(elements: tuple[Element, ...], n: int) -> Points:
    """Places for a spacing of 1, rounded, shape (n, 3). A refusal is remembered as well as an answer."""
    found = _unit_or_refusal(elements, n)
    if isinstance(found, InputError):
        raise found.with_traceback(None)
    return found


@lru_cache(maxsize=256)
def _unit_or_refusal(elements: tuple[Element, ...], n: int) -> Points | InputError:
    try:
        with _drawable():
            return _unit_drawn(elements, n)
    except InputError as refusal:
        return refusal


def _unit_drawn(elements: tuple[Element, ...], n: int) -> Points:
    alone = elements[0]
    if elements == (alone,) and alone.shape == "wedge" and not (alone.fill or alone.repeat) and n > 2 and n % 2 == 0:
        arms = ((1.0, -1.0), (0.0, 0.0), (2 / n - 1, 2 / n - 1))  # the first is longer by one
        elements = (alone.model_copy(update={"shape": None, "points": arms}),)
    drawing = draw(elements)
    parts = _parts(drawing)
    rows = [_place(part, count) for part, count in zip(parts, _shared(parts, n), strict=True)]
    points = np.concatenate(rows)
    if n > 1:
        closest = nearest(points)
        if closest <= 1e-9 * float(np.ptp(points, axis=0).max()):
            raise InputError("draw", None, says="two parts of the drawing need a robot at the same place")
        points = (points / closest).round(DECIMALS)
        points = points / nearest(points)
    return points


@dataclass(frozen=True, slots=True, kw_only=True)
class _Lines:
    """All strokes of a drawing, shape (m, 3) each."""

    strokes: list[Points]
    net: Net  #: Their network, without nodes at corners.


Part: TypeAlias = _Lines | Region | Lattice


def _parts(drawing: Sketch) -> list[Part]:
    strokes = drawing.strokes
    lines = [_Lines(strokes=strokes, net=net_of(strokes, bends=False))] if strokes else []
    return [*lines, *drawing.regions, *drawing.lattices]


def _shared(parts: Sequence[Part], n: int) -> list[int]:
    """How many places each part gets: all parts have about the same spacing."""
    least = [_least(part) for part in parts]
    if n < sum(least):
        raise InputError("n_robots", n, f"at least {sum(least)}, which show every part of the drawing")
    if len(parts) == 1:
        return [n]
    low, high = -20.0, 20.0  # logarithm of the spacing
    for _ in range(60):
        middle = (low + high) / 2
        crowded = sum(_room(part, math.exp(middle)) for part in parts) > n
        low, high = (middle, high) if crowded else (low, middle)
    wanted = [max(0.0, _room(part, math.exp(high)) - few) for part, few in zip(parts, least, strict=True)]
    more = largest_remainder(wanted, n - sum(least))
    return [few + some for few, some in zip(least, more, strict=True)]


def _least(part: Part) -> int:
    if isinstance(part, Lattice):
        return part.least
    return 1 if isinstance(part, Region) else part.net.least


def _room(part: Part, spacing: float) -> float:
    """About how many places a part has at a spacing."""
    if isinstance(part, Lattice):
        return part.room(spacing)
    if isinstance(part, Region):
        return part.area / (HEXAGON * spacing**2)
    return float(part.net.lengths.sum()) / spacing


def largest_remainder(shares: Sequence[float], n: int) -> list[int]:
    """Whole numbers with the sum `n`, in proportion to shares; the first of equal remainders gets more."""
    exact = [round(n * share / (sum(shares) or 1.0), 9) for share in shares]
    parts = [math.floor(x) for x in exact]
    by_remainder = sorted(range(len(parts)), key=lambda k: parts[k] - exact[k])
    for k in range(n - sum(parts)):
        parts[by_remainder[k % len(parts)]] += 1
    return parts


def _place(part: Part, n: int) -> Points:
    if isinstance(part, _Lines):
        return _on_lines(part, n)
    if isinstance(part, Lattice):
        spots = part.places(n)
        return mapped(spots[_farthest(spots, range(part.least), n)], part.world)
    return mapped(_in_region(part, n), part.world)


def _on_lines(part: _Lines, n: int) -> Points:
    plain, bent = part.net, net_of(part.strokes, bends=True)
    if not plain.edges and n > plain.least:
        raise InputError("n_robots", n, f"at most {plain.least}, one for each dot of the drawing")
    points = plain.place(n)
    if bent.least > n or not bent.edges:
        return points
    other = bent.place(n)
    return other if _widest_gap(bent, other) <= BENDS_PAY * _widest_gap(plain, points) else points


def _widest_gap(net: Net, points: Points) -> float:
    """Largest distance of the strokes from the points, for a spacing of 1."""
    if len(points) < 2:
        return math.inf
    dots = [
        along(edge, np.linspace(0, 1, 1 + math.ceil(20 * len(points) * length / net.lengths.sum())))
        for edge, length in zip(net.edges, net.lengths.tolist(), strict=True)
    ]
    far = np.asarray(scipy.spatial.cKDTree(points).query(np.concatenate([*dots, net.nodes]))[0]).max()
    return round(float(far) / max(nearest(points), 1e-12), 6)


def _in_region(region: Region, n: int) -> Points:
    samples = region.sample(min(SAMPLES * n, max(MOST_SAMPLES, 10 * n)) + SAMPLES)
    first = int(np.linalg.norm(samples - samples.mean(axis=0), axis=1).round(9).argmax())
    points = samples[_farthest(samples, [first], n)]
    for _ in range(MOVES):
        owner = np.asarray(scipy.spatial.cKDTree(points).query(samples)[1])
        size = np.maximum(np.bincount(owner, minlength=n), 1)[:, None]
        middle = np.column_stack([np.bincount(owner, axis, minlength=n) for axis in samples.T]) / size
        points = region.onto(middle).round(8)
    return points


def _farthest(points: Points, first: Iterable[int], n: int) -> list[int]:
    """`n` of the points, shape (m, d): after the `first`, each is farthest from those before it."""
    chosen = [*first]
    apart = np.full(len(points), math.inf)
    for k in range(n - 1):
        apart = np.minimum(apart, ((points - points[chosen[k]]) ** 2).sum(axis=1).round(9))
        if k + 1 == len(chosen):
            chosen.append(int(apart.argmax()))
    return chosen
