"""Formats the numbers and the shape of a mission for a prompt."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import chain
from typing import Any

from llm_flock import shapes as formations
from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.plan import DECIMALS, Plan

AXES = ("x", "y", "z")

IN_PLACE = "in exactly this orientation"  #: Marks an oriented shape.

FARTHEST = 10.0
"""Distance of the farthest goal in brief prompts [step limits]: small models lose the direction of farther ones."""


def number_text(value: float) -> str:
    """A number in the shortest form, with six decimals at most: `10`, `2.5`."""
    rounded = round(value, DECIMALS)
    return str(int(rounded)) if rounded == int(rounded) else repr(rounded)


def place_text(place: Point) -> str:
    """A place of a plan, with six decimals at most: `[45.0, 65.388418]`, or of whole numbers."""
    # Adding zero turns -0.0 into 0.0.
    return repr([x if isinstance(x, int) else round(x, DECIMALS) + 0.0 for x in place])


def position_text(position: Point, decimals: int) -> str:
    """An observed position, with a fixed number of decimals: `[12.346, 3.000]`."""
    return "[" + ", ".join([f"%.{decimals}f"] * len(position)) % position + "]"


def positions_text(positions: Sequence[Point], decimals: int) -> str:
    """Observed positions as `[[x, y], ...]`, or `none`."""
    if not positions:
        return "none"
    # One format for all takes a third of the time of one for each.
    one = "[" + ", ".join([f"%.{decimals}f"] * len(positions[0])) + "]"
    return "[" + ", ".join([one] * len(positions)) % tuple(chain.from_iterable(positions)) + "]"


def _row(point: Point) -> str:
    return "[" + ", ".join(map(number_text, point)) + "]"


def short_text(position: Point, decimals: int) -> str:
    """A position in the shortest form, with at most `decimals` decimals: `[0, 4.25]`."""
    return _row(tuple(round(x, decimals) for x in position))


def nearest_text(position: Point, neighbors: Sequence[Point], mission: Mission) -> str:
    """The at most three nearest robots that one step could come too near to, nearest first, or `none`."""
    reach = mission.max_step + mission.safe_distance
    by_distance = sorted((mission.separation(position, other), other) for other in neighbors)
    near = [other for distance, other in by_distance[:3] if distance < reach]
    decimals = position_decimals(mission.max_step)
    return ", ".join(short_text(other, decimals) for other in near) or "none"


def nearer_goal(position: Point, goal: Point, max_step: float) -> Point:
    """The goal, or the point `FARTHEST` step limits towards it, rounded to a hundredth of the step limit."""
    distance = math.dist(position, goal)
    if distance <= FARTHEST * max_step:
        return goal
    share, decimals = FARTHEST * max_step / distance, 2 - math.floor(math.log10(max_step))
    return tuple(round(x + share * (g - x), decimals) for x, g in zip(position, goal, strict=True))


@lru_cache(maxsize=64)
def position_decimals(length: float) -> int:
    """Decimals of positions beside a `length` such as the step limit: 3, or more if a thousandth of it is finer."""
    return min(DECIMALS, max(3, 3 - math.floor(math.log10(length))))


@lru_cache(maxsize=1024)
def plan_text(plan: Plan) -> str:
    """A plan, with six decimals at most. Cached, as a run shows few plans many times."""
    return "[" + ", ".join(map(place_text, plan.points)) + "]"


def shape_text(mission: Mission) -> str:
    """The shape as text; one that is custom, drawn or oriented by its points relative to its centre."""
    drawn, oriented = formations.is_drawn(mission.shape), mission.turn is not None
    if mission.ideal is None or not (mission.points or drawn or oriented):
        return formations.describe(mission.shape)
    # Rounding and adding zero remove values like -1e-15, which would be written as -0.000.
    offsets = [
        tuple(round(x - c, DECIMALS) + 0.0 for x, c in zip(row, mission.center, strict=True)) for row in mission.ideal
    ]
    places = positions_text(offsets, position_decimals(mission.spacing))
    name = "a given shape" if mission.points else formations.describe(mission.shape)
    return (
        f"{name}, {IN_PLACE if oriented else 'turned in any direction'}; relative to its centre its places are {places}"
    )


def obstacles_text(mission: Mission) -> str:
    """The obstacles and the distance to keep from them, as text; empty without obstacles."""
    if not mission.obstacles:
        return ""
    body = "disc" if mission.dim == 2 else "ball"
    parts = [
        f"a polygon with the corners [{', '.join(map(_row, o.polygon))}]"
        if o.polygon is not None
        else f"a {body} of radius {number_text(o.radius or 0.0)} around {_row(o.center or ())}"
        for o in mission.obstacles
    ]
    distance = number_text(mission.body_radius)
    return f"keep your position and every place of a plan {distance} or more from {'; '.join(parts)}"


def _axes(mission: Mission) -> str:
    return f"[{', '.join(AXES[: mission.dim])}]"


MISSION: Mapping[str, Callable[[Mission], Any]] = {
    "shape": shape_text,
    "n_robots": lambda mission: mission.n_robots,
    "places": lambda mission: mission.n_places,
    "dim": lambda mission: mission.dim,
    "center": lambda mission: _row(mission.center),
    "velocity": lambda mission: "" if mission.velocity is None else place_text(mission.velocity),
    "spacing": lambda mission: number_text(mission.spacing),
    "safe_distance": lambda mission: f"{number_text(mission.safe_distance)}{mission.by_height}",
    "max_step": lambda mission: number_text(mission.max_step),
    "comm_range": lambda mission: number_text(mission.comm_range),
    "obstacles": obstacles_text,
    "point_format": _axes,
    "plan_format": lambda m: f"[{_axes(m)}, {_axes(m)}, ...]" if m.n_places > 1 else f"[{_axes(m)}]",
}
"""Variables of a mission, with the functions that write them. Every template but `retry.j2` may use them."""
