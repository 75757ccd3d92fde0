"""Reads a model's answer: tolerant of its form, strict about its content.

The forms are the paper's `Plan: [[x, y], ...]` with `my plan: a` (lines 118 and 391) and `Position: [x, y]` (line 110),
and our own `Path: [[x, y], ...]`, among prose, markdown, code fences and LaTeX. A JSON object is read as labels with
values, too. `_answer_items` finds the values, `_answer_claims` the ones that count. The page "Forms of answers" of the
documentation lists what is read and what is refused.

A value that is taken back is no answer. Where two values stand in answer position and no word decides, none is read.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from llm_flock.arrays import MAX_COORDINATE, Point
from llm_flock.errors import AnswerError
from llm_flock.llm._answer_claims import (
    PATH,
    PLAN,
    POSITION,
    AnswerClaim,
    Items,
    chosen,
    claims,
    counts_from_one,
    index_claims,
    says,
    value_at,
)
from llm_flock.llm._answer_items import CUT, PLACEHOLDERS, SAID, items_of, plain
from llm_flock.llm._port import AnswerForm
from llm_flock.llm._thoughts import answer_text
from llm_flock.plan import Plan

MAX_DIGITS = 40  # longest spelling of a number
HERE = 0.01  # a position this near to the robot's own is its own [units]: prompts and models round it


def read_plan(text: str, form: AnswerForm) -> tuple[Plan, int]:
    """The plan and the index of the model's own place in it; AnswerError with a reason for the model."""
    n = form.n
    items = _items(text)
    found = claims(items, PLAN, many=True) or [one for one in _bare(items, many=True) if len(one.rows) == n]
    for one in found:
        one.misfit = len(one.rows) != n
    own = index_claims(items)
    required = f"a line `Plan: [[...], ...]` with {n} points of {form.dim} numbers is required."
    claim = _complete(items, chosen(found, items, "plan", own), "plan", required)
    if len(claim.rows) != n:
        count = f"{len(claim.rows)} {'point' if len(claim.rows) == 1 else 'points'}"
        raise AnswerError(f"the plan holds {count}, {n} are required.")
    places = [(f"point {i} of the plan", row) for i, row in enumerate(claim.rows)]
    plan = Plan(tuple(_point(name, _numbers(name, row), form.dim) for name, row in places))
    if any(other.value != claim.value for other in found):
        behind = min((other.begin for other in found if other.begin > claim.end), default=len(items.all))
        own = [one for one in own if claim.end <= one.begin < behind]
    return plan, _own_place(chosen(own, items, "place"), items, plan)


def _own_place(claim: AnswerClaim | None, items: Items, plan: Plan) -> int:
    n = len(plan)
    rows = [] if claim is None else [_numbers("my plan", row) for row in claim.rows]
    if claim is not None and claim.wrong not in ("", PLACEHOLDERS):
        raise AnswerError(f"{claim.wrong}; a whole number from 0 to {n - 1} is required (places count from 0).")
    if not rows or len(rows[0]) > 1:
        raise AnswerError(
            f"it does not say which place is yours; a line `my plan: a` with a from 0 to {n - 1} is required."
        )
    if counts_from_one(items.said):
        raise AnswerError(f"it counts places from 1; places count from 0: my plan is a number from 0 to {n - 1}.")
    (value,), *place = rows
    if not (math.isfinite(value) and value == int(value) and 0 <= value < n):
        raise AnswerError(f"my plan is {value:g}; a whole number from 0 to {n - 1} is required (places count from 0).")
    if place and plan.points[int(value)] != tuple(place[0]):
        raise AnswerError(f"place {value:g} of the plan is not {place[0]}; places count from 0.")
    return int(value)


def read_waypoints(text: str, form: AnswerForm, here: Point | None = None) -> tuple[Point, ...]:
    """The 1 to `form.horizon` next positions [units]; AnswerError as in `read_plan`.

    If the question is for a path, a single position is a path of length one. `here` is where the robot is: a position
    that is given as `[here, there]` is there.
    """
    dim, horizon = form.dim, form.horizon
    items = _items(text)
    claim = chosen(claims(items, PATH, many=True), items, "path") if horizon > 1 else None
    path = claim is not None
    if claim is None:
        found = claims(items, POSITION if horizon > 1 else POSITION | PATH, many=False)
        for one in found:
            one.misfit = any(len(row) != dim or (one.bare and _near(row, here)) for row in one.rows)
        claim = chosen(found, items, "position")
    if claim is None:
        path = horizon > 1
        claim = chosen(_bare(items, many=path, first=1), items, "position")
    path = path or (horizon > 1 and bool(claim is None or claim.wrong))
    what, required = "position", f"a line `Position: [...]` with {dim} numbers is required."
    if path:
        what = "path"
        required = f"a line `Path: [[...], ...]` with 1 to {horizon} positions of {dim} numbers is required."
    claim = _complete(items, claim, what, required)
    rows = [_numbers(f"the {what}", row) for row in claim.rows]
    if not path:
        return (_point("the position", _one_of(rows, dim, here), dim),)
    if len(rows) > horizon:
        raise AnswerError(f"the path holds {len(rows)} positions, 1 to {horizon} are required.")
    return tuple(_point(f"position {k} of the path", row, dim) for k, row in enumerate(rows, start=1))


def _near(row: Sequence[str | float], here: Point | None) -> bool:
    return here is not None and len(row) == len(here) and math.dist([float(x) for x in row], here) < HERE


def _one_of(rows: Sequence[Sequence[float]], dim: int, here: Point | None) -> Sequence[float]:
    """The position of a claim: its only row, a column, or where it leads from `here`."""
    if len(rows) == dim and all(len(row) == 1 for row in rows):
        return [row[0] for row in rows]
    if len(rows) == 2 and _near(rows[0], here):
        return rows[1]
    if len(rows) > 1:
        raise AnswerError(f"it gives {len(rows)} positions, one is required.")
    return rows[0]


def _bare(items: Items, *, many: bool, first: int = 0) -> list[AnswerClaim]:
    """Values without a label: lists of points, or a position that is the whole answer."""
    found: list[AnswerClaim] = []
    done = 0
    for at, item in enumerate(items.all):
        if many and item.kind in ("point", "points") and done <= at:
            numbered = items.kind(at - 1) == "sign" and items.kind(at - 2) == "number"
            begin = at - 2 if numbered else at
            value = value_at(items, begin, many=True, first=first)
            scaled = items.kind(begin - 1) == "operator" and items.all[begin - 1].text != "-"
            words = items.words(items.start(begin, "comma", "point", "points"), begin)
            done = at if value is None else value[2]
            if value and not scaled and not says(words, "foreign"):
                found.append(AnswerClaim(value[0], value[1], at, value[2]))
        elif item.kind not in ("line", "stop", "sign") and item.text.lower() not in SAID["languages"] and not many:
            value = value_at(items, at, many=False)
            rest = items.all[len(items.all) if value is None else value[2] :]
            whole = value is not None and all(other.kind in ("line", "stop", "sign") for other in rest)
            return [AnswerClaim(value[0], value[1], at, value[2])] if value and whole else []
    return found


def _complete(items: Items, claim: AnswerClaim | None, what: str, required: str) -> AnswerClaim:
    """The claim; AnswerError if there is none, if it is wrong, or if a list after it is cut off."""
    cut = bool(items.all) and items.all[-1].text == CUT
    if claim is not None and not claim.wrong and not cut:
        return claim
    why = " (its last list is not complete)" if cut else ""
    if claim is not None and claim.wrong:
        why = f": it {claim.wrong}"
        if claim.wrong == PLACEHOLDERS:
            why = " (its form was copied: it holds placeholders, not numbers)"
    raise AnswerError(f"it holds no complete {what}{why}; {required}")


def _items(text: str) -> Items:
    """What an answer says without its thoughts, because a position in a thought is a draft."""
    answer = answer_text(text)
    text = plain(answer)
    items = Items(items_of(text), text, answer)
    for at in range(len(items.all)):
        if items.word(at) in ("unit", "units", "coordinates", "values", "numbers", "axes"):
            near = {*items.words(items.start(at, reach=6), items.sentence(at, 8))} - {"in"}
            for unit in near & (SAID["foreign_units"] | SAID["frames"]):
                raise AnswerError(f"it has units ({unit}), which are not allowed.")
    return items


def _numbers(what: str, row: Sequence[str]) -> list[float]:
    """The numbers of a row as they are spelled."""
    for number in row:
        if len(number) > MAX_DIGITS:
            raise AnswerError(f"{what} holds a number of {len(number)} characters, {MAX_DIGITS} are the limit.")
    return [float(number) for number in row]


def _point(what: str, values: Sequence[float], dim: int) -> Point:
    if len(values) != dim:
        count = "1 number" if len(values) == 1 else f"{len(values)} numbers"
        raise AnswerError(f"{what} has {count}, {dim} are required.")
    for value in values:
        if not math.isfinite(value):
            raise AnswerError(f"{what} holds {value}; every coordinate must be a finite number.")
        if abs(value) > MAX_COORDINATE:
            raise AnswerError(f"{what} holds {value:g}; coordinates are {MAX_COORDINATE:g} at most.")
    return tuple(values)
