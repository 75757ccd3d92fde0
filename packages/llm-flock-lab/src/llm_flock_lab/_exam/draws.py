"""Draw missions and positions for questions, with the numbers rounded as an operator would write them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from llm_flock import shapes as formations
from llm_flock.arrays import Point, Points
from llm_flock.errors import InputError
from llm_flock.mission import Mission, build_mission
from llm_flock.shapes import rotated

STEP_TEAMS: tuple[tuple[str, int], ...] = (
    ("triangle", 3),
    ("square", 4),
    ("cross", 5),
    ("circle", 6),
    ("wedge", 7),
    ("line", 8),
    ("circle", 10),
    ("grid", 12),
    ("polygon:5", 15),
    ("star", 20),
)
"""Teams of questions for steps, from 3 to 20 places."""


def draw_fields(
    rng: np.random.Generator,
    shape: str,
    n: int,
    *,
    points: Sequence[Point] | None = None,
    dim: int = 2,
    small: bool = False,
    tight: bool = False,
) -> dict[str, Any]:
    """Fields of a mission with a random centre, spacing and limits; `points` are those of the shape, in spacings.

    `small` gives lengths of about a metre, as for real drones, and `tight` walls close to the formation.
    """
    decimals, unit = (2, 0.1) if small else (1, 1.0)
    spacing = round(float(rng.uniform(5.0, 15.0)) * unit, decimals)
    center = tuple(round(float(x) * unit, decimals) for x in rng.uniform(-40.0, 120.0, dim))
    fields: dict[str, Any] = {"shape": shape, "n_robots": n, "center": center, "spacing": spacing}
    if points is not None:
        fields["points"] = tuple(tuple(round(spacing * x, 3) for x in row) for row in points)
    custom = fields.get("points")
    ideal = formations.ideal_points("circle" if shape.startswith("text:") else shape, n, center, spacing, custom)
    assert ideal is not None, "only shapes whose points are known are drawn"
    reach = formations.circumradius(ideal, center) + (0.1 if tight else 5.0) * spacing
    low, high = (tuple(round(x + sign * math.ceil(reach), 2) for x in center) for sign in (-1, 1))
    if small:
        low, high = (tuple(round(x + sign * reach, 2) for x in center) for sign in (-1, 1))
    fields["safe_distance"] = round(0.3 * spacing, 2)
    fields["max_step"] = round(float(rng.uniform(0.3, 0.8)) * spacing, 2)
    fields["comm_range"] = round(1.5 * spacing + 2 * fields["max_step"], 2)
    fields["arena"] = (low, high)
    return fields


def lattice(rng: np.random.Generator, n: int, dim: int) -> tuple[Point, ...]:
    """A random connected piece of a square or cubic lattice: n points, each one spacing from another [spacings]."""
    found: list[tuple[int, ...]] = [(0,) * dim]
    while len(found) < n:
        at = list(found[int(rng.integers(len(found)))])
        at[int(rng.integers(dim))] += int(rng.choice([-1, 1]))
        if tuple(at) not in found:
            found.append(tuple(at))
    return tuple(tuple(map(float, row)) for row in found)


def draw_plan(rng: np.random.Generator, mission: Mission) -> Points:
    """The mission's shape in a random orientation, shape (n, d) [units; world frame]."""
    angle_rad = float(rng.uniform(0.0, 2 * math.pi))
    if mission.obstacles:
        return mission.placed(*next(mission.placements(angle_rad)))
    assert mission.ideal is not None, "only shapes whose points are known are drawn"
    return rotated(np.array(mission.ideal), mission.center, angle_rad)


def direction(rng: np.random.Generator, dim: int) -> Point:
    while True:
        row = rng.normal(size=dim)
        length = float(np.linalg.norm(row))
        if length > 1e-3:
            return tuple(float(x) / length for x in row)


def unit(here: Point, there: Point) -> Point:
    """The unit vector from one point to another; zeros where they are the same."""
    length = max(math.dist(here, there), 1e-12)
    return tuple((t - x) / length for x, t in zip(here, there, strict=True))


def away(point: Point, distance: float, toward: Point) -> Point:
    """The point at a distance along a unit vector [units]."""
    return tuple(x + distance * u for x, u in zip(point, toward, strict=True))


def round_point(point: Point, length: float) -> Point:
    """A point with a thousandth of a length of ten units, finer where lengths are small."""
    decimals = 3 if length >= 2 else 4
    return tuple(round(float(x), decimals) + 0.0 for x in point)


def rounded_rows(rows: Points, length: float) -> tuple[Point, ...]:
    """Points, shape (n, d), as rows of rounded numbers."""
    plain: list[list[float]] = rows.tolist()
    return tuple(round_point(tuple(row), length) for row in plain)


def inside(mission: Mission, point: Point) -> bool:
    """Whether a point is within the walls and clear of obstacles."""
    low, high = mission.arena
    within = all(a <= x <= b for a, x, b in zip(low, point, high, strict=True))
    return within and all(o.distance(point) >= mission.body_radius for o in mission.obstacles)


def try_mission(fields: Mapping[str, Any]) -> Mission | None:
    """The mission of these fields, None where they are not allowed: the caller draws others."""
    try:
        return build_mission(**fields)
    except InputError:
        return None
