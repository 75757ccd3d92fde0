"""A mission in words: everything that a team would fly, stage by stage."""

from __future__ import annotations

import difflib
import json
import math
import re
from typing import Any

import numpy as np

from llm_flock import shapes as formations
from llm_flock.formation import group_sizes, program_of
from llm_flock.mission import Mission

FIRST_CORNER_EAST = ("triangle", "polygon")  # as shapes of a mission; programs draw them upright
MEANS = {"formed": "as soon as a robot sees all at their places", "order": "on your order"}
WAYS = {"shortest": "gets the shortest way", "center": "stays near the centre", "edge": "stays at the edge"}
GAPS = {
    "replan": "if robots die, the others close the gap",
    "report": "if robots die, their places stay empty",
    None: "",
}


def mission_words(mission: Mission, gaps: str | None = None) -> str:
    """All that is flown, for people: the stages with numbers if there are several."""
    zones = [_plain(zone.model_dump(exclude_none=True)) for zone in mission.obstacles]
    said = [f"{mission.n_robots} robots", *(f"none enters {zone}" for zone in zones), *([GAPS[gaps]] if gaps else [])]
    stages, stage = [_stage_words(mission)], mission
    while stage.then:
        when, stage = stage.then[0].when, stage.following()
        stages.append(f"{MEANS.get(str(when), f'in round {when}')}: {_stage_words(stage)}")
    numbered = stages if len(stages) == 1 else [f"({k}) {words}" for k, words in enumerate(stages, 1)]
    return " · ".join([*said, *numbered])


def _stage_words(mission: Mission) -> str:
    program, spare = program_of(mission.shape), mission.n_robots - mission.n_places
    said, chosen = list[str](), _chosen(mission, 0)
    if program is None or program.draw is not None:
        what = formations.describe(mission.shape)
        what = what if mission.ideal is None else what.partition(" (")[0]
        if program is not None:
            size = f", size {program.size:.4g}" if program.size else ""
            what = f"{program.name or 'a drawing'}: {', '.join(map(_element_words, program.draw or ()))}{size}"
        said += [f"{what} around {_at(mission.center)}", *([f"flown by {chosen}"] if chosen else [])]
    for k, group in enumerate(groups := () if program is None else program.groups or ()):
        sizes, ats = group_sizes(groups, mission.n_places), np.array([group.at[:2] for group in groups])
        at = np.array(mission.center[:2]) - np.array(sizes) @ ats / sum(sizes) + ats[k]
        who = _chosen(mission, k) or ("the nearest" if group.count else "the others")
        size, role = f", size {group.size:.4g}" if group.size else "", f" as {group.role}" if group.role else ""
        drawn = ", ".join(map(_element_words, group.draw))
        said.append(f"{sizes[k]} robots ({who}){role}: {drawn} around {_at(at.tolist())}{size}")
    said.append(f"neighbours {mission.spacing:g} apart")
    if mission.ideal is not None and not groups:
        said.append(f"width {float(np.ptp(np.array(mission.ideal), axis=0).max()):.4g}")
    if mission.ideal is not None:
        said.append(_orientation(mission))
    said += [f"travelling by {_at(mission.velocity)} a round"] if mission.velocity is not None else []
    said += [f"{abs(spare)} {'robots wait aside' if spare > 0 else 'places stay empty'}"] if spare else []
    said += [f"robot {one.robot} {WAYS[one.way]}" for one in mission.prefer if one.way is not None]
    said += [f"held for {mission.hold} rounds"] if mission.hold else []
    return ", ".join(said)


def _orientation(mission: Mission) -> str:
    if mission.turn is None:
        return "in any orientation"
    first = 90.0 if formations.shape_name(mission.shape) in FIRST_CORNER_EAST else 0.0
    turn = math.remainder(mission.turn - first, 360.0)
    return f"turned by {turn:g} degrees" if turn else "upright as drawn"


def _chosen(mission: Mission, group: int) -> str:
    """Who is to fly a group, in words; empty if nobody is preferred."""
    ids = [str(one.robot) for one in mission.prefer if one.group == group and one.robot is not None]
    sides = [f"those farthest {one.side}" for one in mission.prefer if one.group == group and one.side is not None]
    return " and ".join([*([f"robots {', '.join(ids)}"] if ids else []), *sides])


def _element_words(element: Any) -> str:
    """An element of a program: what it draws, and every other field as it is given."""
    given = element.model_dump(exclude_defaults=True)
    kind = next(name for name in ("shape", "text", "path", "points", "union") if name in given)
    what = {"path": "lines", "points": f"{len(element.points or ())} points"}.get(kind, str(given[kind]))
    if kind == "union":
        what = f"({' with '.join(map(_element_words, element.union))})"
    rest = (name if value is True else f"{name} {_plain(value)}" for name, value in given.items() if name != kind)
    return " ".join([f"letters {what}" if kind == "text" else what, *rest])


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value).translate(str.maketrans("", "", '"{}'))


def _at(point: Any) -> str:
    return ", ".join(f"{part:.4g}" for part in point)


def difference(before: Mission, after: Mission) -> str:
    """What differs between two missions, in words: what is no longer so, and what is instead."""
    old, new = (re.split(r" · |, (?![-\d])", mission_words(mission)) for mission in (before, after))
    changes = difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes()
    said = [(", ".join(old[a:b]), ", ".join(new[c:d])) for tag, a, b, c, d in changes if tag != "equal"]
    return "; ".join(f"{now or 'nothing'} instead of {was or 'nothing'}" for was, now in said)
