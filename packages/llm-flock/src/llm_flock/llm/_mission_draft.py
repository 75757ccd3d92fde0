"""The typed answer of a reader of missions, and what of it a team flies: a mission, with its stages in `then`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from llm_flock import shapes as formations
from llm_flock.bounds import MAX_ROUNDS
from llm_flock.errors import InputError
from llm_flock.formation import parse_program
from llm_flock.formation._program import Flat
from llm_flock.llm._mission_phrases import FIRST_CORNER_EAST, mission_words
from llm_flock.mission import OPTIONAL, Mission, build_mission
from llm_flock.obstacles import Obstacle
from llm_flock.printable import counted

Finite = Annotated[float, Field(allow_inf_nan=False)]
Pair: TypeAlias = tuple[Finite, Finite]

SIDES = {"left": "west", "right": "east", "front": "north", "back": "south"}
ANGLES = {"north": 0.0, "west": 90.0, "south": 180.0, "east": -90.0}  # degrees from the north, anticlockwise
MIDDLE = 50.0  # height of the centre of a formation in space, in an arena of twice that height [units]


class _Form(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Who(_Form):
    count: int | None = Field(default=None, ge=1)
    side: Literal["left", "right", "front", "back", "west", "east", "north", "south", "nearest"] | None = None
    ids: tuple[Annotated[int, Field(ge=0)], ...] | None = Field(default=None, min_length=1)


class Part(_Form):
    who: Who | None = Field(default=None, description="count and/or side, or ids; left out: everybody else")
    role: str = Field(default="", description="only if the words name one", max_length=40)
    shape: str = Field(description="name of a shape, letters:TEXT, or text:WORDS for any other drawing", max_length=999)
    fill: bool = Field(default=False, description="only if the words want the inside filled")
    center: Pair | None = Field(default=None, description="only if said, as numbers that follow from the words")
    spacing: Finite | None = Field(default=None, gt=0, description="between neighbours, only if said")
    size: Finite | None = Field(
        default=None, gt=0, description="largest width, only if said; of a circle, the diameter"
    )
    point: Literal["west", "east", "north", "south"] | None = Field(default=None, description="only if said")
    turn: Finite | None = Field(default=None, description="or: degrees anticlockwise, only if said", ge=-360, le=360)
    velocity: Pair | None = Field(default=None, description="units a round, only if it travels")


class InRound(_Form):
    round: int = Field(ge=1, le=MAX_ROUNDS)


class StageDraft(_Form):
    parts: tuple[Part, ...] = Field(min_length=1, max_length=20, description="sub-teams; one part if all do the same")
    hold: int = Field(
        default=0, ge=0, le=MAX_ROUNDS, description="stay formed for so many rounds before the next stage, only if said"
    )
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
    because: str = Field(default="it gives no reason", description="one sentence, for ask and refuse", max_length=999)


class MissionDraft(NamedTuple):
    """A mission as the model understood it, not yet confirmed."""

    fields: Mapping[str, Any]  #: The order that flies it, also if another order came meanwhile.
    in_words: str  #: Everything that would be flown, for people.
    mission: Mission  #: The whole mission.
    gaps: Literal["replan", "report"] | None = None  #: What to do about gaps, where the words say it.


def compiled(answer: MissionAnswer, base: Mission, *, flying: bool = False) -> MissionDraft:
    """An answer as what a team flies that flies `base`, or is set up for it, if it is not `flying` yet.

    Raises:
        InputError: the reader asks back or refuses (field `words`), or a field cannot be flown.
    """
    if answer.answer != "mission":
        does = f"asks about {answer.about or 'the mission'}" if answer.answer == "ask" else "refuses"
        raise InputError("words", None, says=f"the reader {does}: {answer.because}")
    n, zones = answer.robots or base.n_robots, [zone for zone in answer.keep_out if zone not in base.obstacles]
    own = {"robots": n != base.n_robots and n, "keep_out": zones and counted(len(zones), "zone"), "gaps": answer.gaps}
    if wrong := next((name for name, value in own.items() if value and flying), None):
        says = "belongs to the robots, and is set before they start: no order in flight changes it"
        raise InputError(wrong, own[wrong], says=says)
    near, far = ({wish.robot for wish in answer.prefer if wish.way == way} for way in ("center", "edge"))
    if both := sorted(near & far):
        raise InputError("prefer", both, says="a robot stays near the centre or at the edge, not both")
    if not answer.stages or (answer.stages[0].when is not None and not flying):
        allowed = "at least one stage, of which the first begins at once: it has no `when`"
        raise InputError("stages", len(answer.stages), allowed)
    start: dict[str, Any] = {} if flying else {"n_robots": n, "places": None, "points": None, **OPTIONAL}
    start |= {"obstacles": [*base.obstacles, *zones]} if zones else {}
    space = not flying and base.dim == 2 and formations.in_space(answer.stages[0].parts[0].shape)
    now = base.model_copy(update={"n_robots": n, "center": (*base.center, MIDDLE) if space else base.center})
    if space:
        start["arena"] = [(*low, height) for low, height in zip(base.arena, (0.0, 2 * MIDDLE), strict=True)]
        start["center"] = now.center
    stages: list[dict[str, Any]] = []
    for stage in answer.stages:
        fields = _stage(stage, answer.prefer, now)
        now = now.model_copy(update={"center": fields.get("center", now.center), "spacing": fields["spacing"]})
        when = stage.when.round if isinstance(stage.when, InRound) else stage.when
        stages.append({"set": fields, "when": when or "formed"})
    at_once = answer.stages[0].when is None
    given: dict[str, Any] = {
        **start,
        **(stages[0]["set"] if at_once else {}),
        "then": stages[1:] if at_once else stages,
    }
    mission = base.change(**given) if flying else build_mission(**{**base.model_dump(), **given})
    return MissionDraft(mission.order(base, given), mission_words(mission, answer.gaps), mission, answer.gaps)


def _stage(stage: StageDraft, prefer: Sequence[Preferred], base: Mission) -> dict[str, Any]:
    """A stage as the fields of a mission that it sets. What it does not say stays as in `base`."""
    parts, n = stage.parts, base.n_robots
    preferences: list[dict[str, Any]] = [one.model_dump() for one in prefer]
    for k, who in enumerate(part.who or Who() for part in parts):
        preferences += [{"robot": robot, "group": k} for robot in who.ids or ()]
        if who.side not in (None, "nearest"):
            preferences.append({"side": SIDES.get(who.side, who.side), "group": k})
    named = [robot for part in parts for robot in (part.who and part.who.ids) or ()]
    if twice := sorted({robot for robot in named if named.count(robot) > 1}):
        raise InputError("ids", twice, "each robot in one part, once")
    counts = [part.who and (part.who.count or len(part.who.ids or ()) or None) for part in parts]
    fixed, others = sum(count or 0 for count in counts), counts.count(None)
    if fixed + others > n:
        raise InputError("count", fixed + others, f"at most the {n} robots of the team, in all parts together")
    if len(parts) == 1 and others and parts[0].who is not None:
        raise InputError("count", None, "a number of robots beside `side`, as no other part takes the rest")
    turns = iter(range(n))  # the first of several parts for the others get one more, as the groups of a program do
    sizes = [count or (n - fixed) // others + (next(turns) < (n - fixed) % others) for count in counts]
    if len({part.velocity for part in parts}) > 1:
        raise InputError("velocity", None, "the same for all parts: a formation travels as a whole")
    fields = {"places": None if others or fixed == n else fixed, "hold": stage.hold, "prefer": preferences}
    fields |= {"velocity": parts[0].velocity} if parts[0].velocity is not None else {}
    if len(parts) == 1:
        return fields | _alone(parts[0], sizes[0], base)
    draws = [[_element(part, size)] for part, size in zip(parts, sizes, strict=True)]
    widths = [_width(parse_program({"draw": draw}).spec, size) for draw, size in zip(draws, sizes, strict=True)]
    said = [part.spacing or (part.size or 0.0) / width for part, width in zip(parts, widths, strict=True)]
    spacings = [spacing or base.spacing for spacing in said]
    wide = [part.size or spacing * width for part, spacing, width in zip(parts, spacings, widths, strict=True)]
    centers = np.array([part.center or base.center[:2] for part in parts])
    groups = [
        {
            "role": "".join(letter for letter in part.role if letter.isalnum() or letter in " _.-"),
            "count": counts[k],
            "at": (centers[k] - centers[0]).tolist(),
            "size": wide[k] if part.size or spacings[k] > min(spacings) else None,
            "draw": draws[k],
        }
        for k, part in enumerate(parts)
    ]
    name = " and ".join(dict.fromkeys(part.shape.partition(":")[0] for part in parts))[:40]
    center = (np.array(sizes) @ centers / sum(sizes)).round(6).tolist()
    shape = parse_program({"name": name, "groups": groups}).spec
    return fields | {"shape": shape, "center": center, "spacing": min(spacings), "turn": 0.0}


def _alone(part: Part, n: int, base: Mission) -> dict[str, Any]:
    """Shape, place, spacing and orientation of a formation of one part."""
    name, turn, shape = part.shape.partition(":")[0], _turn(part), part.shape
    fields: dict[str, Any] = {"center": (*part.center, *base.center[2:])} if part.center else {}
    if name in ("points", "program", "outline") or (name == "text" and part.size is not None):
        raise InputError(
            "shape", shape, "a shape with a name, letters:TEXT, or text:WORDS, which has no size of its own"
        )
    if name == "text":
        if not shape.partition(":")[2].strip():
            raise InputError("shape", shape, "words after text:")
        said = ["filled"] * part.fill + ([] if turn is None else [f"turned by {turn:g} degrees anticlockwise"])
        shape = ", ".join([shape, *([f"pointing {part.point}"] if part.point else said)])
        return fields | {"shape": shape, "spacing": part.spacing or base.spacing, "turn": None}
    if part.fill or (part.size and part.spacing):
        size = part.size if part.spacing else None
        shape, turn = parse_program({"name": name, "draw": [_element(part, n)], "size": size}).spec, turn and 0.0
    elif turn is not None and name in FIRST_CORNER_EAST:
        turn = math.remainder(turn + 90.0, 360.0)
    spacing = part.spacing or (part.size / _width(shape, n) if part.size else base.spacing)
    return fields | {"shape": shape, "spacing": spacing, "turn": turn}


def _turn(part: Part) -> float | None:
    """Degrees from the upright drawing, a line from west to east; None if any orientation will do."""
    if part.point is not None and part.turn is not None:
        raise InputError("turn", part.turn, says="point or turn, not both")
    return part.turn if part.point is None else ANGLES[part.point] + 90.0 * (part.shape == "line")


def _width(shape: str, n: int) -> float:
    """Largest width of a shape at a spacing of 1, at least a tiny one; of a circle, its diameter."""
    middle = (0.0,) * (3 if formations.in_space(shape) else 2)
    points = formations.ideal_points(shape, n, middle, 1.0)
    assert points is not None, "a shape with a name has points"
    width = 2 * formations.circumradius(points, middle) if shape == "circle" else float(np.ptp(points, axis=0).max())
    return max(width, 1e-9)


def _element(part: Part, n: int) -> dict[str, Any]:
    """A shape with a name as an element of a program."""
    name, _, argument = part.shape.partition(":")
    more = {"turn": _turn(part) or 0.0, "fill": part.fill}
    if name == "letters":
        return {"text": argument, **more}
    if name not in get_args(Flat):
        raise InputError("shape", part.shape, f"one of {', '.join(get_args(Flat))} and letters:TEXT for a sub-team")
    return {"shape": name, **({"sides": int(argument)} if argument.isdecimal() else {}), **more}
