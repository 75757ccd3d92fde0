"""How a mission's numbers and words are written in a prompt."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import chain
from typing import Any

from llm_flock import formations
from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.plan import DECIMALS, Plan

AXES = ("x", "y", "z")

NEAREST = 3
"""So many robots are told where words must be few."""


def number_text(value: float) -> str:
    """A number as short as it can be said, to six decimals at most: `10`, `2.5`."""
    rounded = round(value, DECIMALS)
    return str(int(rounded)) if rounded == int(rounded) else repr(rounded)


def place_text(place: Point) -> str:
    """A place of a plan as it was given, to six decimals at most: `[45.0, 65.388418]`."""
    # Adding zero turns -0.0 into 0.0.
    return repr([round(x, DECIMALS) + 0.0 for x in place])


def position_text(position: Point, decimals: int) -> str:
    """An observed position, with a fixed number of decimals: `[12.346, 3.000]`."""
    return "[" + ", ".join([f"%.{decimals}f"] * len(position)) % position + "]"


def positions_text(positions: Sequence[Point], decimals: int) -> str:
    """Observed positions as `[[x, y], ...]`, or `none`."""
    if not positions:
        return "none"
    # One format for all: a hundred neighbours cost a third of what a format for each would.
    one = "[" + ", ".join([f"%.{decimals}f"] * len(positions[0])) + "]"
    return "[" + ", ".join([one] * len(positions)) % tuple(chain.from_iterable(positions)) + "]"


def short_text(position: Point, decimals: int) -> str:
    """A position as short as it can be said, with so many decimals at most: `[0, 4.25]`."""
    return "[" + ", ".join(number_text(round(x, decimals)) for x in position) + "]"


def nearest_text(position: Point, neighbors: Sequence[Point], mission: Mission) -> str:
    """The nearest robots that one step could come too near to, three at most and nearest first, or `none`."""
    reach = mission.max_step + mission.safe_distance
    by_distance = sorted((math.dist(position, other), other) for other in neighbors)
    near = [other for distance, other in by_distance[:NEAREST] if distance < reach]
    decimals = position_decimals(mission.max_step)
    return ", ".join(short_text(other, decimals) for other in near) or "none"


@lru_cache(maxsize=64)
def position_decimals(length: float) -> int:
    """Decimals of positions where `length` (the step limit, say) matters: 3, more if a thousandth of it is finer."""
    return min(DECIMALS, max(3, 3 - math.floor(math.log10(length))))


@lru_cache(maxsize=1024)
def plan_text(plan: Plan) -> str:
    """A plan as it was given, to six decimals; the same few plans are shown many times in a run."""
    return "[" + ", ".join(map(place_text, plan.points)) + "]"


def shape_text(mission: Mission) -> str:
    """The shape in words; a custom shape is given by its points relative to its centre, in any orientation."""
    if mission.points is None or mission.ideal is None:
        return formations.describe(mission.shape)
    # Rounding, and adding zero, takes away differences like -1e-15, which would be told as -0.000.
    offsets = [
        tuple(round(x - c, DECIMALS) + 0.0 for x, c in zip(row, mission.center, strict=True)) for row in mission.ideal
    ]
    places = positions_text(offsets, position_decimals(mission.spacing))
    return f"a given shape, turned in any direction; relative to its centre its places are {places}"


def obstacles_text(mission: Mission) -> str:
    """The obstacles and the distance to keep from them, in words; empty without any."""
    if not mission.obstacles:
        return ""

    def row(place: Point) -> str:
        return "[" + ", ".join(map(number_text, place)) + "]"

    body = "disc" if mission.dim == 2 else "ball"
    parts = [
        f"a polygon with the corners [{', '.join(map(row, o.polygon))}]"
        if o.polygon is not None
        else f"a {body} of radius {number_text(o.radius or 0.0)} around {row(o.center or ())}"
        for o in mission.obstacles
    ]
    return f"keep your position and every place of a plan {number_text(mission.body_radius)} or more from " + "; ".join(
        parts
    )


def mission_variables(mission: Mission) -> Mapping[str, Any]:
    """What every template but `retry.j2` may use of the mission."""
    axes = ", ".join(AXES[: mission.dim])
    return {
        "shape": shape_text(mission),
        "n_robots": mission.n_robots,
        "places": mission.n_places,
        "dim": mission.dim,
        "center": "[" + ", ".join(map(number_text, mission.center)) + "]",
        "velocity": "" if mission.velocity is None else place_text(mission.velocity),
        "spacing": number_text(mission.spacing),
        "safe_distance": number_text(mission.safe_distance),
        "max_step": number_text(mission.max_step),
        "comm_range": number_text(mission.comm_range),
        "obstacles": obstacles_text(mission),
        "point_format": f"[{axes}]",
        "plan_format": f"[[{axes}], [{axes}], ...]" if mission.n_places > 1 else f"[[{axes}]]",
    }
