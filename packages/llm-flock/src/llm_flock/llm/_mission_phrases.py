"""A mission in words: everything that a team would fly, stage by stage, and what an edit changes in a program."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np

from llm_flock import shapes as formations
from llm_flock.formation import Group, Program, group_sizes, program_of
from llm_flock.mission import Mission

MEANS = {
    "formed": "as soon as a robot sees that all stand at their places",
    "order": "on your order",
}
WAYS = {"shortest": "gets the shortest way", "center": "stays near the centre", "edge": "stays at the edge"}


def mission_words(mission: Mission, gaps: str | None = None) -> str:
    """All that is flown, for people: the stages with numbers if there are several."""
    said = [f"{mission.n_robots} robots"]
    for zone in mission.obstacles:
        where = f"{_at(zone.center)} within {zone.radius:g}" if zone.center else f"the polygon {_corners(zone.polygon or ())}"
        said.append(f"none enters {where}")
    if gaps is not None:
        said.append("if robots die, the others close the gap" if gaps == "replan" else "if robots die, their places stay empty")
    stages, stage = [_stage_words(mission)], mission
    while stage.then:
        when = stage.then[0].when
        stage = stage.following()
        stages.append(f"{MEANS.get(str(when), f'in round {when}')}: {_stage_words(stage)}")
    if len(stages) > 1:
        stages = [f"({k}) {words}" for k, words in enumerate(stages, 1)]
    return " · ".join([*said, *stages])


def _stage_words(mission: Mission) -> str:
    program = program_of(mission.shape)
    groups = None if program is None else program.groups
    said = [f"{_shape_words(mission, program)} around {_at(mission.center)}"]
    if groups is not None:
        sizes = group_sizes(groups, mission.n_places)
        ats = np.array([group.at for group in groups], dtype=np.float64)
        first = np.array(mission.center[:2]) - np.array(sizes) @ ats[:, :2] / sum(sizes)
        said = [
            _group_words(mission, k, group, sizes[k], tuple((first + ats[k, :2]).tolist())) for k, group in enumerate(groups)
        ]
    said.append(f"neighbours {mission.spacing:g} apart")
    if mission.ideal is not None and len(mission.ideal) > 1 and groups is None:
        said.append(f"{float(np.ptp(np.array(mission.ideal), axis=0).max()):.4g} wide")
    if mission.turn is not None:
        said.append(f"turned by {mission.turn:g} degrees" if mission.turn else "upright as drawn")
    elif mission.ideal is not None:
        said.append("turned in any direction")
    if mission.velocity is not None:
        said.append(f"travelling by {_at(mission.velocity)} a round")
    if mission.places is not None:
        said.append(f"{mission.places} places, so {abs(mission.n_robots - mission.places)} "
                    f"{'robots wait aside' if mission.places < mission.n_robots else 'places stay empty'}")
    if groups is None and (chosen := _chosen(mission, 0)):
        said.append(f"flown by {chosen}")
    said += [f"robot {wish.robot} {WAYS[wish.way]}" for wish in mission.prefer if wish.way is not None]
    if mission.hold:
        said.append(f"held for {mission.hold} rounds")
    return ", ".join(said)


def _shape_words(mission: Mission, program: Program | None) -> str:
    name = mission.shape.partition(":")[0]
    if program is None or name != "program":
        return formations.describe(mission.shape).partition(" (")[0] if name != "letters" else mission.shape.replace(":", " ")
    size = "" if program.size is None else f" at most {program.size:g} wide"
    title = f"{program.name}: " if program.name else ""
    return f"{title}{', '.join(map(element_words, program.draw or ()))}{size}"


def _group_words(mission: Mission, number: int, group: Group, size: int, at: tuple[float, ...]) -> str:
    who = _chosen(mission, number) or ("the others" if group.count is None else "the nearest")
    role = f" as {group.role}" if group.role else ""
    drawn = ", ".join(map(element_words, group.draw))
    wide = "" if group.size is None else f", {group.size:.4g} wide"
    return f"{size} robots ({who}){role}: {drawn} around {_at(at)}{wide}"


def _chosen(mission: Mission, group: int) -> str:
    """Who is to fly a group, in words; empty if nobody is preferred."""
    ids = [str(wish.robot) for wish in mission.prefer if wish.group == group and wish.robot is not None]
    sides = [f"those farthest {wish.side}" for wish in mission.prefer if wish.group == group and wish.side is not None]
    return " and ".join([*([f"robots {', '.join(ids)}"] if ids else []), *sides])


def element_words(element: Any) -> str:
    """An element of a program: what it draws, and every other field as it is given."""
    given = element.model_dump(exclude_defaults=True)
    what = given.pop("shape", None) or (f"letters {given.pop('text')}" if "text" in given else "")
    if element.union is not None:
        del given["union"]
        what = f"({' with '.join(map(element_words, element.union))})"
    for kind in ("path", "points"):
        if kind in given:
            del given[kind]
            count = len(element.points or ())
            what = "the lines of a drawing" if kind == "path" else f"a line through {count} points" if count > 1 else "a dot"
    if given.pop("fill", False):
        what += ", filled"
    if "turn" in given:
        given["turn"] = f"{given['turn']:g} degrees"
    return " ".join([what, *(f"{name} {_plain(value)}" for name, value in given.items())])


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value).replace('"', "")


def _at(point: tuple[float, ...]) -> str:
    return ", ".join(f"{round(part, 2):g}" for part in point)


def _corners(polygon: tuple[tuple[float, ...], ...]) -> str:
    return " to ".join(map(_at, polygon))


def difference(old: Program, new: Program) -> str:
    """What differs between two programs, in words: each change with its place, the old value and the new one."""
    found = [*_changes("", json.loads(old.text), json.loads(new.text))]
    return "; ".join(found) or "nothing changes"


def _changes(where: str, old: Any, new: Any) -> Iterator[str]:
    if old == new:
        return
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        before, after = cast("Mapping[str, Any]", old), cast("Mapping[str, Any]", new)
        for key in dict.fromkeys([*before, *after]):
            yield from _changes(f"{where} {key}".strip(), before.get(key), after.get(key))
    elif isinstance(old, list) and isinstance(new, list) and all(isinstance(one, dict) for one in [*old, *new]):
        left = [one for one in cast("list[Any]", old) if one not in new]
        came = [one for one in cast("list[Any]", new) if one not in old]
        for k in range(max(len(left), len(came))):
            number = cast("list[Any]", old).index(left[k]) + 1 if k < len(left) else len(cast("list[Any]", old)) + 1
            yield from _changes(f"{where} {number}", left[k] if k < len(left) else None, came[k] if k < len(came) else None)
    elif new is None:
        yield f"{where}: without {_short(old)}"
    elif old is None:
        yield f"{where}: {_short(new)} is new"
    else:
        yield f"{where}: {_short(new)} instead of {_short(old)}"


def _short(value: Any) -> str:
    text = _plain(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
