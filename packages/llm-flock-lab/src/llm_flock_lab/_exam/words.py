"""Whether an answer in words flies what was wanted: missions field by field, drawings by where robots stand."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, cast

import numpy as np
import scipy
import shapely

from llm_flock.arrays import Points
from llm_flock.formation import Program, parse_program, program_points
from llm_flock.mission import Mission

ANGLES = {"north": 0.0, "west": 90.0, "south": 180.0, "east": 270.0}
SIDES = {"west": "left", "east": "right", "north": "front", "south": "back", "nearest": None}
OTHER_SIDE = {"left": "right", "right": "left", "front": "back", "back": "front"}
FOLDS = {"line": 2, "triangle": 3, "square": 4, "cross": 4, "star": 5, "grid": 2}
"""How often a turn of a full circle shows a shape as it was; a polygon of K corners K times."""
ROUND = ("circle", "sphere", "dome", "cylinder")  # shapes that show no turn
ROBOTS = 60  # robots that show a drawing; groups that are counted have their own

ALIKE = 0.25
"""Two drawings are the same if no robot is farther from those of the other, in distances between neighbours."""


def mission_differs(wanted: Mapping[str, Any], found: Mapping[str, Any], base: Mission) -> str | None:
    """The first part of a mission that would fly otherwise, as a sentence; what is not said stays as in `base`."""
    here, there = _closed(wanted, base), _closed(found, base)
    if here.symmetric_difference(there).area > 0.01 * max(here.area, there.area):
        return f"keep_out is {found.get('keep_out')}, and the words say {wanted.get('keep_out')}."
    left, right = _mission(wanted, base), _mission(found, base)
    wrong = next((name for name in left if left[name] != right[name]), None)
    return None if wrong is None else f"{wrong}: {found.get(wrong)}, and the words say {wanted.get(wrong)}."


def _closed(answer: Mapping[str, Any], base: Mission) -> Any:
    """The area that no robot may enter, as far as it is in the arena."""
    zones: list[Any] = [
        shapely.Polygon(zone["polygon"]).buffer(0)
        if zone.get("polygon")
        else shapely.Point(zone["center"]).buffer(zone["radius"])
        for zone in answer.get("keep_out", ())
    ]
    low, high = base.arena
    return shapely.intersection(shapely.box(low[0], low[1], high[0], high[1]), shapely.union_all(zones))


def _mission(answer: Mapping[str, Any], base: Mission) -> dict[str, Any]:
    """A mission with everything that follows from what it says."""
    team, keeps = base.n_robots, {"center": base.center, "spacing": base.spacing}
    stages: list[Any] = []
    for stage in answer.get("stages", ()):
        parts = [_part(part, keeps) for part in stage["parts"]]
        _complete([part["who"] for part in parts], team)
        stages.append([_sorted(parts), stage.get("hold", 0), stage.get("when") or "formed"])
        if len(parts) == 1:
            keeps |= {name: parts[0][name] for name in keeps if parts[0][name] is not None}
    robots = answer.get("robots")
    preferences = _sorted([one["robot"], one["way"]] for one in answer.get("prefer", ()))
    # The number of robots is known, whether it is said or not.
    return {"robots": robots or team, "gaps": answer.get("gaps"), "prefer": preferences, "stages": stages}


def _sorted(values: Iterable[Any]) -> list[Any]:
    """Values whose order does not matter; numbers as people and models round them, to two decimals."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: plain(one) for name, one in cast("Mapping[str, Any]", value).items()}
        if isinstance(value, list | tuple):
            return [plain(one) for one in cast("Iterable[Any]", value)]
        return round(value, 2) + 0.0 if isinstance(value, int | float) else value

    return sorted(map(plain, values), key=json.dumps)


def _part(part: Mapping[str, Any], keeps: Mapping[str, Any]) -> dict[str, Any]:
    name, _, argument = str(part["shape"]).strip().casefold().partition(":")
    shape = {"polygon:3": "triangle", "polygon:4": "square"}.get(f"{name}:{argument}", f"{name}:{argument}")
    if name == "text":
        shape = "text:" + " ".join(word for word in argument.split() if word not in ("a", "an", "the"))
    name = shape.partition(":")[0]
    turn = part.get("turn")
    if part.get("point") is not None:  # unturned, a line runs from west to east
        turn = ANGLES[part["point"]] + 90.0 * (name == "line")
    if turn is not None:
        turn = None if name in ROUND else turn % (360 / (int(argument) if name == "polygon" else FOLDS.get(name, 1)))
    who: dict[str, Any] = part.get("who") or {}
    side, role, velocity = who.get("side"), (part.get("role") or "").casefold().split(), part.get("velocity")
    return {
        "who": {"count": who.get("count"), "side": SIDES.get(side or "", side), "ids": sorted(who.get("ids") or ())},
        "role": role[-1].removesuffix("s") if role else None,
        "shape": shape,
        "fill": bool(part.get("fill")) and name != "grid",
        "center": part.get("center") or keeps["center"][:2],
        "spacing": part.get("spacing") or (None if part.get("size") else keeps["spacing"]),
        "size": part.get("size"),
        "turn": turn,
        "velocity": velocity if velocity and any(velocity) else None,
    }


def _complete(who: Sequence[dict[str, Any]], team: int) -> None:
    """Say of every sub-team what follows from the others: how many robots, their ids, their side."""
    for one in who:
        one["count"] = len(one["ids"]) or one["count"]
    rest = [one for one in who if one["count"] is None and one["side"] is None]
    others = [one for one in who if one["count"] is not None]
    if len(rest) == 1 and len(others) + 1 == len(who):
        rest[0]["count"] = team - sum(one["count"] for one in others)
        if all(one["ids"] for one in others):
            rest[0]["ids"] = sorted({*range(team)}.difference(*(one["ids"] for one in others)))
    if len(who) == 2 and sum(one["count"] or 0 for one in who) == team:
        for one, other in (who, who[::-1]):
            one["side"] = one["side"] or OTHER_SIDE.get(other["side"])


def drawing_differs(wanted: Program, found: Program) -> str | None:
    """What differs between what two programs draw, as a sentence: roles, size, or where robots stand; else None."""
    left, right = ([(g.role.casefold(), g.count) for g in program.groups or ()] for program in (wanted, found))
    if sorted(map(str, left)) != sorted(map(str, right)):
        return f"the groups are {right}, and the words say {left}."
    if (wanted.size or 0.0) != (found.size or 0.0):
        return f"size is {found.size}, and the words say {wanted.size}."
    one, other = _drawn(wanted.text), _drawn(found.text)
    if one.shape != other.shape:
        return "it is drawn in another number of dimensions."
    away = scipy.spatial.distance.cdist(one, other)
    own = scipy.spatial.distance.cdist(one, one) + np.diag([np.inf] * len(one))
    if max(away.min(axis=0).max(), away.min(axis=1).max()) > ALIKE * float(np.median(own.min(axis=1))):
        return "it draws something else than the words say."
    return None


@lru_cache(maxsize=256)
def _drawn(text: str) -> Points:
    """Where robots stand, around a mean of zero, at a mean square radius of 1: as large as they make it."""
    program = parse_program(text)
    counts = [group.count for group in program.groups or ()]
    n = sum(count or 0 for count in counts) if counts and None not in counts else ROBOTS
    rows = program_points(program.model_copy(update={"size": None}), n, 3 if program.in_space else 2, 1.0)
    rows = rows - rows.mean(axis=0)
    return rows / (float(np.sqrt((rows**2).sum(axis=1).mean())) or 1.0)
