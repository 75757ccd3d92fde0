"""Whether an answer in words flies what was wanted: missions field by field, and drawings by where robots stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import shapely


NEAR = 0.011
"""Two numbers of a mission are the same if they are so near: people and models round to two decimals."""

ARENA = shapely.box(0, 0, 100, 100)

ANGLES = {"north": 0.0, "west": 90.0, "south": 180.0, "east": 270.0}
FOLDS = {"line": 2, "triangle": 3, "square": 4, "cross": 4, "star": 5, "grid": 2}
"""How often a turn of a full circle shows the same shape; a polygon of K corners K times."""

SIDES = {"west": "left", "east": "right", "north": "front", "south": "back"}
OTHER_SIDE = {"left": "right", "right": "left", "front": "back", "back": "front"}


def mission_differs(wanted: Mapping[str, Any], found: Mapping[str, Any], base: Mapping[str, Any]) -> str | None:
    """The first part of a mission that would fly otherwise, as a sentence; None if all flies alike.

    What is not said stays as it is in `base`, the fields of the mission that is flown or set up.
    """
    left, right = _mission(wanted, base), _mission(found, base)
    zones = [shapely.union_all(list(map(_zone, one.get("keep_out", ())))).intersection(ARENA) for one in (wanted, found)]
    if zones[0].symmetric_difference(zones[1]).area > 0.01 * max(zone.area for zone in zones):
        return f"keep_out is {found.get('keep_out')!r}, and the words say {wanted.get('keep_out')!r}."
    for name, value in left.items():
        if not _same(value, right[name]):
            return f"{name} is {right[name]!r}, and the words say {value!r}."
    return None


def _mission(answer: Mapping[str, Any], base: Mapping[str, Any]) -> dict[str, Any]:
    """A mission with all that is not said as it stays."""
    team, stages, keeps = int(base["n_robots"]), [], dict(base)
    for number, stage in enumerate(answer.get("stages", ())):
        parts = [_part(part, keeps) for part in stage["parts"]]
        _complete([part["who"] for part in parts], team)
        when = stage.get("when") or "formed"
        stages.append({"parts": _Bag(parts), "hold": stage.get("hold", 0), "when": when if number or when != "formed" else 0})
        if len(parts) == 1:
            keeps |= {name: parts[0][name] for name in ("center", "spacing") if parts[0][name] is not None}
    robots = answer.get("robots")
    return {
        "robots": None if robots == team else robots,  # how many there are is known
        "gaps": answer.get("gaps"),
        "prefer": _Bag([{"robot": wish["robot"], "way": wish["way"]} for wish in answer.get("prefer", ())]),
        "stages": stages,
    }


class _Bag(list[Any]):
    """A list whose order does not matter."""


def _part(part: Mapping[str, Any], keeps: Mapping[str, Any]) -> dict[str, Any]:
    name, _, argument = str(part["shape"]).strip().partition(":")
    name = name.lower()
    if name == "polygon" and argument in ("3", "4"):
        name, argument = {"3": "triangle", "4": "square"}[argument], ""
    if name == "text":
        argument = argument.strip().lower().removeprefix("the ").removeprefix("an ").removeprefix("a ").strip()
    folds = int(argument) if name == "polygon" else FOLDS.get(name, 1)
    turn = part.get("turn") if part.get("point") is None else ANGLES[part["point"]]
    if turn is not None:
        turn = 0.0 if name in ("circle", "sphere", "dome") else round(turn % (360 / folds), 2) % (360 / folds)
    who = dict(part.get("who") or {})
    who = {"count": who.get("count"), "side": SIDES.get(who.get("side", ""), who.get("side")), "ids": sorted(who.get("ids") or ())}
    if who["side"] == "nearest":
        who["side"] = None  # a count alone is of the nearest
    role = (part.get("role") or "").lower().split()
    velocity = part.get("velocity")
    return {
        "who": who,
        "role": role[-1].removesuffix("s") if role else None,
        "shape": f"{name}:{argument.upper()}" if argument else name,
        "fill": bool(part.get("fill")) and name != "grid",
        "center": part.get("center") or keeps["center"],
        "spacing": part.get("spacing") or (None if part.get("size") else keeps["spacing"]),
        "size": part.get("size"),
        "turn": turn if name not in ("circle", "sphere", "dome") else None,
        "velocity": velocity if velocity and any(velocity) else None,
    }


def _complete(who: Sequence[dict[str, Any]], team: int) -> None:
    """Say of every sub-team what follows from the others: how many robots, which ids, which side."""
    rest = [one for one in who if one["count"] is None and not one["ids"] and one["side"] is None]
    for one in who:
        one["count"] = len(one["ids"]) or one["count"]
    others = [one for one in who if one not in rest]
    if len(rest) == 1 and all(one["count"] for one in others):
        rest[0]["count"] = team - sum(one["count"] for one in others)
        if all(one["ids"] for one in others):
            taken = {k for one in others for k in one["ids"]}
            rest[0]["ids"] = [k for k in range(team) if k not in taken]
    if len(who) == 2 and sum(one["count"] or 0 for one in who) == team:
        for one, other in (who, who[::-1]):
            one["side"] = one["side"] or OTHER_SIDE.get(other["side"])


def _zone(zone: Mapping[str, Any]) -> shapely.Geometry:
    if zone.get("polygon"):
        return shapely.Polygon(zone["polygon"]).buffer(0)
    return shapely.Point(zone["center"]).buffer(zone["radius"])


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, _Bag):
        left = list(cast("list[Any]", other))
        for value in one:
            match = next((k for k, candidate in enumerate(left) if _same(value, candidate)), None)
            if match is None:
                return False
            del left[match]
        return not left
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[name], other[name]) for name in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, int | float) and isinstance(other, int | float):
        return abs(one - other) <= NEAR
    return one == other
