"""The typed answer of a reader of missions, and what of it a team flies: a mission, with its stages in `then`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from llm_flock import shapes as formations
from llm_flock.errors import InputError
from llm_flock.formation import parse_program, program_points
from llm_flock.formation._program import Flat
from llm_flock.llm._mission_phrases import mission_words
from llm_flock.mission import Mission, build_mission
from llm_flock.obstacles import Obstacle

Finite = Annotated[float, Field(allow_inf_nan=False)]
Pair: TypeAlias = tuple[Finite, Finite]
Compass: TypeAlias = Literal["north", "east", "south", "west"]

SIDES = {"left": "west", "right": "east", "front": "north", "back": "south"}
ANGLES = {"north": 0.0, "west": 90.0, "south": 180.0, "east": -90.0}  # degrees from the north, anticlockwise
MIDDLE = 50.0  # height of the centre of a formation in space that is given no height [units]


class _Form(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Who(_Form):
    count: int | None = Field(default=None, ge=1)
    side: Literal["left", "right", "front", "back", "west", "east", "north", "south", "nearest"] | None = None
    ids: tuple[int, ...] | None = Field(default=None, min_length=1)


class Part(_Form):
    who: Who | None = Field(default=None, description="count and/or side, or ids; left out: everybody else")
    role: str | None = Field(default=None, description="only if the words name one", max_length=40)
    shape: str = Field(description="name of a shape, letters:TEXT, or text:WORDS for any other drawing", max_length=1000)
    fill: bool = Field(default=False, description="only if the words want the inside filled")
    center: Pair | None = Field(default=None, description="only if said, as numbers that follow from the words")
    spacing: Finite | None = Field(default=None, description="between neighbours, only if said")
    size: Finite | None = Field(default=None, gt=0, description="largest width, only if said; of a circle, the diameter")
    point: Compass | None = Field(default=None, description="where it points, only if said")
    turn: Finite | None = Field(default=None, ge=-360, le=360, description="or: degrees anticlockwise, only if said")
    velocity: Pair | None = Field(default=None, description="units a round, only if it travels")


class InRound(_Form):
    round: int = Field(ge=1)


class StageDraft(_Form):
    parts: tuple[Part, ...] = Field(min_length=1, max_length=20, description="sub-teams; one part if all do the same")
    hold: int = Field(default=0, ge=0, description="stay formed for so many rounds before the next stage, only if said")
    when: Literal["formed", "order"] | InRound | None = Field(
        default=None, description="how it is entered: the stage before is formed (the default), a round, or on an order"
    )


class Preferred(_Form):
    robot: int = Field(ge=0)
    way: Literal["shortest", "center", "edge"]


class MissionAnswer(_Form):
    answer: Literal["mission", "ask", "refuse"]
    robots: int | None = Field(default=None, ge=1, description="only if the words say how many robots the team has")
    keep_out: tuple[Obstacle, ...] = Field(default=(), description="zones that no robot may enter")
    gaps: Literal["replan", "report"] | None = Field(
        default=None, description="if robots die: close the gap with a new plan, or leave it; only if said"
    )
    stages: tuple[StageDraft, ...] = Field(default=(), max_length=20, description="formations one after the other")
    prefer: tuple[Preferred, ...] = Field(default=(), description="wishes for one robot: shortest way, centre, edge")
    about: Literal["shape", "place", "robots", "size", "direction", "order", "which"] | None = None
    because: str | None = Field(default=None, description="one sentence, for ask and refuse", max_length=1000)


class MissionDraft(NamedTuple):
    """A mission as the model understood it, not yet confirmed."""

    fields: Mapping[str, Any]  #: Fields of a mission that are set, in flight those that an order changes.
    in_words: str  #: Everything that would be flown, for people.
    mission: Mission  #: The whole mission.
    gaps: Literal["replan", "report"] | None = None  #: What to do about gaps, where the words say it.


def compiled(answer: MissionAnswer, base: Mission, *, flying: bool = False) -> MissionDraft:
    """An answer as what a team flies that has flown `base`, or is set up for it; `flying` if it is in the air.

    Raises:
        InputError: the reader asks back or refuses, or a field cannot be flown.
    """
    if answer.answer != "mission":
        about = f" about {answer.about}" if answer.about else ""
        why = answer.because or "it gives no reason"
        raise InputError("words", None, says=f"the reader {'asks' + about if answer.answer == 'ask' else 'refuses'}: {why}")
    if not answer.stages:
        raise InputError("stages", [], "at least one stage in a mission")
    n, zones = answer.robots or base.n_robots, tuple(zone for zone in answer.keep_out if zone not in base.obstacles)
    fixed = {"robots": n != base.n_robots and n, "keep_out": [zone.model_dump(exclude_none=True) for zone in zones]}
    for name, value in (fixed | {"gaps": answer.gaps}).items() if flying else ():
        if value:
            raise InputError(name, value, says="belongs to the robots, and is set before they start: no order changes it")
    walls = [zone.model_dump(exclude_none=True) for zone in (*base.obstacles, *zones)]
    start: dict[str, Any] = {} if flying else {"n_robots": n, "obstacles": walls}
    keeps = base if flying or n == base.n_robots else base.model_copy(update={"n_robots": n, "places": None})
    stages: list[dict[str, Any]] = []
    for stage in answer.stages:
        fields = _stage_fields(stage, answer.prefer, keeps)
        if not stages and not flying and formations.in_space(fields["shape"]) and base.dim == 2:
            start["arena"] = tuple((*corner, height) for corner, height in zip(base.arena, (0.0, 2 * MIDDLE), strict=True))
            fields["center"] = (*fields.get("center", base.center), MIDDLE)
        known = {name: fields[name] for name in ("center", "spacing") if name in fields}
        keeps = keeps.model_copy(update=known)  # what later stages do not say stays as it is
        stages.append(fields)
    whens = [stage.when.round if isinstance(stage.when, InRound) else stage.when for stage in answer.stages]
    later = [{"set": fields, "when": when or "formed"} for fields, when in zip(stages, whens, strict=True)]
    if whens[0] is not None and not flying:
        raise InputError("when", whens[0], says="nothing comes before the first stage, which begins at once")
    given = {"then": later} if whens[0] is not None else {**start, **stages[0], "then": later[1:]}
    if flying:
        mission = base.change(**given)
    else:
        mission = build_mission(**{**base.model_dump(), "points": None, "turn": None, "hold": 0, **given})
    return MissionDraft(given, mission_words(mission, answer.gaps), mission, answer.gaps)


def _stage_fields(stage: StageDraft, prefer: Sequence[Preferred], base: Mission) -> dict[str, Any]:
    parts, n = stage.parts, base.n_robots
    wishes: list[dict[str, Any]] = [wish.model_dump() for wish in prefer]
    for k, part in enumerate(parts):
        if part.who is not None and part.who.ids is not None:
            wishes += [{"robot": robot, "group": k} for robot in part.who.ids]
        elif part.who is not None and part.who.side not in (None, "nearest"):
            wishes.append({"side": SIDES.get(part.who.side or "", part.who.side), "group": k})
    counts = [_count(part, n) for part in parts]
    fixed = sum(count or 0 for count in counts)
    others = counts.count(None)
    if fixed + others > n:
        raise InputError("who", fixed + others, f"at most the {n} robots of the team, one for each part at least")
    velocities = {part.velocity for part in parts}
    if len(velocities) > 1:
        raise InputError("velocity", [part.velocity for part in parts], "one for all parts: a formation travels as a whole")
    fields: dict[str, Any] = {"places": None if others or fixed == n else fixed, "hold": stage.hold, "prefer": wishes}
    if len(parts) == 1 and counts[0] is None and parts[0].who is not None:
        raise InputError("who", parts[0].who.model_dump(exclude_none=True), "a count of robots, or their ids")
    fields |= {"velocity": parts[0].velocity} if parts[0].velocity is not None else {}
    if len(parts) > 1:
        return fields | _sub_teams(parts, counts, base)
    if parts[0].center is not None:
        fields["center"] = (*parts[0].center, *base.center[2:])
    return fields | _alone(parts[0], counts[0] or n, base)


def _count(part: Part, n: int) -> int | None:
    who = part.who
    if who is None or (who.count is None and who.ids is None):
        return None
    if who.ids is not None and (len(set(who.ids)) < len(who.ids) or not max(who.ids) < n or min(who.ids) < 0):
        raise InputError("ids", list(who.ids), f"different ids from 0 to {n - 1}")
    return who.count or len(who.ids or ())


def _alone(part: Part, n: int, base: Mission) -> dict[str, Any]:
    """Shape, spacing and orientation of a formation of one part."""
    name, turn = part.shape.partition(":")[0], _turn(part)
    if name == "text":
        if part.size is not None:
            raise InputError("size", part.size, says="cannot be kept for a drawing in words: the robots draw it by their spacing")
        words = [part.shape, *["filled"] * part.fill, *([f"pointing {part.point}"] if part.point else [])]
        words += [f"turned by {part.turn:g} degrees anticlockwise"] if part.turn else []
        return {"shape": ", ".join(words), "turn": None} | ({} if part.spacing is None else {"spacing": part.spacing})
    if name in ("points", "program", "outline"):
        raise InputError("shape", part.shape, "a shape with a name, letters:TEXT or text:WORDS")
    shape, spacing = part.shape, part.spacing or base.spacing
    if part.fill or (part.size is not None and part.spacing is not None):
        shape = parse_program({"name": name, "draw": [_element(part, n)], "size": part.spacing and part.size}).spec
        turn = None if turn is None else 0.0
    elif turn is not None and name in ("triangle", "polygon"):
        turn += 90.0  # as a shape of a mission, its first corner is in the east
    if part.size is not None and part.spacing is None:
        spacing = part.size / _width(shape, n)
    return {"shape": shape, "spacing": spacing, "turn": turn if turn is None or turn <= 180.0 else turn - 360.0}


def _width(shape: str, n: int) -> float:
    """Largest width of a shape at a spacing of 1; of a circle, its diameter."""
    dim = 3 if formations.in_space(shape) else 2
    points = formations.ideal_points(shape, n, (0.0,) * dim, 1.0)
    assert points is not None, "a shape with a name has points"
    width = 2 * formations.circumradius(points, (0.0,) * dim) if shape == "circle" else float(np.ptp(points, axis=0).max())
    if not width:
        raise InputError("size", None, says="a single robot has no width")
    return width


def _turn(part: Part) -> float | None:
    """Degrees from the upright drawing, a line from west to east; None if any orientation will do."""
    if part.point is None:
        return part.turn
    if part.turn is not None:
        raise InputError("turn", part.turn, says="point or turn, not both")
    return ANGLES[part.point] + 90.0 * (part.shape == "line")


def _element(part: Part, n: int) -> dict[str, Any]:
    """A shape with a name as an element of a program."""
    name, _, argument = part.shape.partition(":")
    turn = {"turn": _turn(part) or 0.0}
    if name == "letters":
        return {"text": argument, "fill": part.fill, **turn}
    if name == "grid":
        rows = max(k for k in range(1, n + 1) if n % k == 0 and k * k <= n)
        row = {"points": [[0, 0]], "repeat": {"times": n // rows, "move": [1, 0]}} if n > rows else {"points": [[0, 0]]}
        return {"union": [row], "repeat": {"times": rows, "move": [0, 1]}, **turn} if rows > 1 else {**row, **turn}
    if name not in get_args(Flat):
        formations.shape_name(part.shape)
        raise InputError("shape", part.shape, f"one of {', '.join((*get_args(Flat), 'grid', 'letters:TEXT'))} here")
    sides = {"sides": int(argument)} if argument.isdecimal() else {}
    return {"shape": name, "fill": part.fill, **sides, **turn}


def _sub_teams(parts: Sequence[Part], counts: Sequence[int | None], base: Mission) -> dict[str, Any]:
    """One program with a group for each part, at the places that the parts say."""
    left, others = base.n_robots - sum(count or 0 for count in counts), counts.count(None)
    turns = iter(range(others))  # the first of them get one more, as in `group_sizes`
    sizes = [count or left // others + (next(turns) < left % others) for count in counts]
    groups: list[dict[str, Any]] = []
    spacings: list[float] = []
    for part, count, size in zip(parts, counts, sizes, strict=True):
        role = "".join(letter for letter in part.role or "" if letter.isalnum() or letter in " _.-")
        groups.append({"role": role, "count": count, "draw": [_element(part, size)]})
        spacing = part.spacing or base.spacing
        if part.size is not None:
            width = part.size / _drawn_width(groups[-1], size)
            spacing = part.spacing or width
            groups[-1]["size"] = part.size
        spacings.append(spacing)
    centers = np.array([part.center or base.center[:2] for part in parts])
    for group, part, size, spacing, at in zip(groups, parts, sizes, spacings, centers - centers[0], strict=True):
        group["at"] = at.tolist()
        if spacing > min(spacings) * (1 + 1e-9) and part.size is None and size > 1:
            group["size"] = spacing * _drawn_width(group, size)
    name = " and ".join(dict.fromkeys(part.shape.partition(":")[0] for part in parts))[:40]
    shape = parse_program({"name": name, "groups": groups}).spec
    middle = (np.array(sizes) @ centers / sum(sizes)).round(6).tolist()
    return {"shape": shape, "center": tuple(middle), "spacing": min(spacings), "turn": 0.0}


def _drawn_width(group: Mapping[str, Any], n: int) -> float:
    program = parse_program({"draw": group["draw"]})
    return float(np.ptp(program_points(program, n, 2, 1.0), axis=0).max()) or 1.0
