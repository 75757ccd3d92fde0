"""Reads a model's answer: tolerant of its form, strict about its content.

The forms are the paper's `Plan: [[x, y], ...]` with `my plan: a` (lines 118 and 391) and `Position: [x, y]` (line 110),
and our own `Path: [[x, y], ...]`, among prose, markdown, code fences and LaTeX; or the same values as a JSON object.
`_answer_items` finds the values, `_answer_claims` the ones that count, `_answer_objects` the JSON. The page
"Forms of answers" of the documentation lists what is read and what is refused.

A value that is taken back is no answer. Where two values stand in answer position and no word decides, none is read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

from llm_flock.arrays import MAX_COORDINATE, Point
from llm_flock.errors import AnswerError
from llm_flock.llm._answer_claims import (
    CERTAIN,
    PATH,
    PLAN,
    POSITION,
    POSITION_OR_PATH,
    AnswerClaim,
    Items,
    chosen,
    claims,
    counts_from_one,
    foreign,
    index_claims,
    points_from,
    start_of_clause,
)
from llm_flock.llm._answer_items import CUT, FOREIGN_UNITS, PLACEHOLDERS, items_of, plain
from llm_flock.llm._answer_objects import Several, objects
from llm_flock.llm._port import AnswerForm
from llm_flock.llm._thoughts import spoken
from llm_flock.plan import Plan

MAX_CHARS = 1_000_000
"""Longer answers are not read."""

MAX_DIGITS = 40
"""Longest spelling of a number."""

MAX_OBJECTS = 100
"""Most JSON objects with an answer that are compared."""

HERE = 0.01
"""A position this near to the robot's own is its own [units]: prompts and models round it."""

_LANGUAGES = frozenset({"json", "python", "text", "latex", "math", "plaintext"})
"""May stand after the backticks of a code fence, before an answer that has no label."""


def read_plan(text: str, form: AnswerForm) -> tuple[Plan, int]:
    """The plan and the index of the model's own place in it; AnswerError with a reason for the model."""
    n, dim = form.n, form.dim
    text = _without_thoughts(text)
    answer = _object(text, form, "plan")
    if answer is not None:
        rows = _list_field(answer, "plan", f"a list of {n} points")
        return _plan([_row(row, f"point {i} of the plan") for i, row in enumerate(rows)], form), _index(
            _number("my_plan", _field(answer, "my_plan", f"a whole number from 0 to {n - 1}")), n
        )
    text = plain(text)
    items = Items(items_of(text), text)
    found = claims(items, PLAN, many=True) or [one for one in _bare(items, many=True) if len(one.rows) == n]
    for one in found:
        one.misfit = len(one.rows) != n
    own = index_claims(items)
    claim = chosen(found, items, "plan", own)
    required = f"a line `Plan: [[...], ...]` with {n} points of {dim} numbers is required."
    claim = _complete(items, claim, "plan", required)
    points = [_numbers(f"point {i} of the plan", row) for i, row in enumerate(claim.rows)]
    plan = _plan(points, form)
    if any(other.value != claim.value for other in found):
        behind = min((other.begin for other in found if other.begin > claim.end), default=len(items.all))
        own = [one for one in own if claim.end <= one.begin < behind]
    return plan, _own_place(chosen(own, items, "place"), items, plan)


def _own_place(claim: AnswerClaim | None, items: Items, plan: Plan) -> int:
    n = len(plan)
    if claim is None or claim.wrong == PLACEHOLDERS:
        raise AnswerError(
            f"it does not say which place is yours; a line `my plan: a` with a from 0 to {n - 1} is required."
        )
    if claim.wrong:
        raise AnswerError(f"{claim.wrong}; a whole number from 0 to {n - 1} is required (places count from 0).")
    (first, *place) = claim.rows
    values = _numbers("my plan", first)
    if len(values) > 1:
        raise AnswerError(
            f"it does not say which place is yours; a line `my plan: a` with a from 0 to {n - 1} is required."
        )
    if counts_from_one(items.text):
        raise AnswerError(f"it counts places from 1; places count from 0: my plan is a number from 0 to {n - 1}.")
    index = _index(values[0], n)
    if place and plan.points[index] != tuple(_numbers("my plan", place[0])):
        raise AnswerError(f"place {index} of the plan is not [{', '.join(place[0])}]; places count from 0.")
    return index


def read_waypoints(text: str, form: AnswerForm, here: Point | None = None) -> tuple[Point, ...]:
    """The 1 to `form.horizon` next positions [units]; AnswerError as in `read_plan`.

    If the question is for a path, a single position is a path of length one. `here` is where the robot is: a position
    that is given as `[here, there]` is there.
    """
    dim, horizon = form.dim, form.horizon
    text = _without_thoughts(text)
    answer = _object(text, form, *(("path", "position") if horizon > 1 else ("position", "path")))
    if answer is not None:
        if horizon == 1 or ("path" not in answer and "position" in answer):
            position = _field(answer, "position", f"a list of {dim} numbers")
            return (_point("the position", _row(position, "the position"), dim),)
        rows = _list_field(answer, "path", f"a list of 1 to {horizon} positions")
        return _path([_row(row, "the path") for row in rows], horizon, dim)
    text = plain(text)
    items = Items(items_of(text), text)
    one, several = f"a line `Position: [...]` with {dim} numbers", f"with 1 to {horizon} positions of {dim} numbers"
    claim = chosen(claims(items, PATH, many=True), items, "path") if horizon > 1 else None
    path = claim is not None
    if claim is None:
        found = claims(items, POSITION if horizon > 1 else POSITION_OR_PATH, many=False)
        for other in found:
            other.misfit = any(len(row) != dim for row in other.rows)
        claim = chosen(found, items, "position")
    if claim is None:
        path = horizon > 1
        claim = chosen(_bare(items, many=path, first=1), items, "position")
    path = path or (horizon > 1 and bool(claim is None or claim.wrong))
    required = f"a line `Path: [[...], ...]` {several}" if path else one
    claim = _complete(items, claim, "path" if path else "position", f"{required} is required.")
    if path:
        rows = [_numbers("the path", row) for row in claim.rows]
        return _path(rows, horizon, dim)
    return (_point("the position", _one_of(claim.rows, dim, here), dim),)


def _one_of(rows: Sequence[Sequence[str]], dim: int, here: Point | None) -> Sequence[float]:
    """The position of a claim: its only row, a column, or where it leads from `here`."""
    values = [_numbers("the position", row) for row in rows]
    if len(values) == dim and all(len(row) == 1 for row in values):
        return [row[0] for row in values]
    if len(values) == 2 and here is not None and len(values[0]) == dim and math.dist(values[0], here) < HERE:
        return values[1]
    if len(values) > 1:
        raise AnswerError(f"it gives {len(values)} positions, one is required.")
    return values[0]


def _bare(items: Items, *, many: bool, first: int = 0) -> list[AnswerClaim]:
    """Values without a label: lists of points, or a position that is the whole answer."""
    found: list[AnswerClaim] = []
    for at, item in enumerate(items.all if many else ()):
        if item.kind in ("point", "points") and (not found or found[-1].end <= at):
            numbered = items.kind(at - 1) == "sign" and items.kind(at - 2) == "number"
            begin = at - 2 if numbered else at
            row = points_from(items, begin, first)
            scaled = items.kind(begin - 1) == "operator" and items.all[begin - 1].text != "-"
            if row and not scaled and not foreign(list(items.words(start_of_clause(items, begin), begin))):
                found.append(AnswerClaim(row[0], row[1], at, row[2]))
    if found:
        return found
    rest = [
        (at, item)
        for at, item in enumerate(items.all)
        if item.kind not in ("line", "stop", "sign") and item.text.lower() not in _LANGUAGES
    ]
    if many and rest and all(item.kind in ("point", "comma", "operator") for _, item in rest):
        return [AnswerClaim(tuple(row for _, item in rest for row in item.rows), "", 0, len(items.all))]
    if len(rest) != 1 or rest[0][1].kind not in ("point", "points", "bad", "axes"):
        return []
    at, item = rest[0]
    wrong = item.text if item.kind == "bad" else PLACEHOLDERS if item.kind == "axes" else ""
    return [AnswerClaim(item.rows, wrong, at, at + 1)]


def _complete(items: Items, claim: AnswerClaim | None, what: str, required: str) -> AnswerClaim:
    """The claim; AnswerError if there is none, if it is wrong, or if a list after it is cut off."""
    last = items.all[-1].text if items.all else ""
    if claim is None:
        why = " (its last list is not complete)" if last == CUT else ""
    elif claim.wrong == PLACEHOLDERS:
        why = " (its form was copied: it holds placeholders, not numbers)"
    elif claim.wrong:
        why = f": it {claim.wrong}"
    elif last == CUT:
        why = " (its last list is not complete)"
    else:
        return claim
    raise AnswerError(f"it holds no complete {what}{why}; {required}")


def _path(rows: Sequence[Sequence[float]], horizon: int, dim: int) -> tuple[Point, ...]:
    if not 1 <= len(rows) <= horizon:
        raise AnswerError(f"the path holds {len(rows)} positions, 1 to {horizon} are required.")
    return tuple(_point(f"position {k} of the path", row, dim) for k, row in enumerate(rows, start=1))


def _plan(points: Sequence[Sequence[float]], form: AnswerForm) -> Plan:
    if len(points) != form.n:
        count = f"{len(points)} {'point' if len(points) == 1 else 'points'}"
        raise AnswerError(f"the plan holds {count}, {form.n} are required.")
    return Plan(tuple(_point(f"point {i} of the plan", row, form.dim) for i, row in enumerate(points)))


def _without_thoughts(text: str) -> str:
    """The text without thoughts, because a position in a thought is a draft."""
    if len(text) > MAX_CHARS:
        raise AnswerError(f"it is {len(text)} characters long, {MAX_CHARS} are the limit.")
    answer = spoken(text)
    if answer.unfinished or (answer.thought and not answer.text.strip()):
        raise AnswerError("it holds nothing but thoughts; think less, and give the answer itself.")
    return answer.text


def _object(text: str, form: AnswerForm, *wanted: str) -> Mapping[str, Any] | None:
    """The fields of the JSON object that counts, or None if the answer is to be read as text."""
    if not form.json and not any(f'"{name}"' in text for name in wanted):
        return None
    if text.lstrip().startswith('"{'):  # a JSON object as the text of a JSON string
        text = text.replace('\\"', '"')
    found = objects(text, *wanted)
    holding = [one for one in found if any(name in one.fields for name in wanted)]
    if not holding:
        return found[-1].fields if found and form.json else None
    if len(holding) > MAX_OBJECTS:
        raise AnswerError(f"it gives {len(holding)} JSON objects; give one only.")
    # Around objects the words decide, as around claims; each object stands for itself in that text.
    spoken_of, outside, last = "", "", 0
    values: list[list[object]] = []
    for one in holding:
        values.append([one.fields.get(name) for name in (*wanted, "my_plan")])
        spoken_of += f"{text[last : one.start]} answer: [{values.index(values[-1])}] "
        outside += text[last : one.start]
        last = max(last, one.end)
    spoken_of, outside = plain(spoken_of + text[last:]), plain(outside + text[last:])
    around = Items(items_of(outside), outside)
    if not form.json and (claims(around, POSITION, many=False) or claims(around, PLAN | PATH, many=True)):
        return None
    items = Items(items_of(spoken_of), spoken_of)
    claim = chosen(claims(items, frozenset({"answer"}), many=False), items, "object")
    if all(value == values[0] for value in values):
        return holding[-1].fields
    if claim is None or claim.wrong or len(claim.rows[0]) != 1:
        raise AnswerError("it gives two different JSON objects and does not say which one counts; give one only.")
    return holding[int(claim.rows[0][0])].fields


def _field(answer: Mapping[str, Any], name: str, required: str) -> object:
    if name not in answer:
        raise AnswerError(f'the JSON object has no "{name}"; {required} is required.')
    for key, value in answer.items():
        if key in ("unit", "units") and str(value).lower() in FOREIGN_UNITS:
            raise AnswerError(f'the JSON object has "{key}": "{value}"; units are not allowed.')
        qualifier, _, rest = key.rpartition(f"_{name}")
        if qualifier in CERTAIN and not rest and value != answer[name]:
            raise AnswerError(f'the JSON object has "{name}" and "{key}", which differ; give one only.')
    if isinstance(answer[name], Several):
        raise AnswerError(f'the JSON object has "{name}" twice, with two different values; give it once.')
    return answer[name]


def _list_field(answer: Mapping[str, Any], name: str, required: str) -> list[object]:
    value = _field(answer, name, required)
    if not isinstance(value, list):
        raise AnswerError(f'"{name}" is not a list; {required} is required.')
    return cast(list[object], value)


def _numbers(what: str, row: Sequence[str]) -> list[float]:
    """The numbers of a row as they are spelled."""
    for number in row:
        if len(number) > MAX_DIGITS:
            raise AnswerError(f"{what} holds a number of {len(number)} characters, {MAX_DIGITS} are the limit.")
    return [math.inf if number == "∞" else float(number) for number in row]


def _row(value: object, what: str) -> list[float]:
    """The numbers of a point from JSON: a list, an object with the axes, or either as a text."""
    if isinstance(value, str):
        items = items_of(plain(value))
        points = [item for item in items if item.kind == "point"]
        if len(points) != 1 or len(items) != 1:
            wrong = next((item.text for item in items if item.kind == "bad"), "is not a list of numbers")
            raise AnswerError(f"{what} {wrong}.")
        return _numbers(what, points[0].rows[0])
    axes = cast(dict[str, object], value) if isinstance(value, dict) else dict[str, object]()
    if set(axes) in ({"x", "y"}, {"x", "y", "z"}):
        return [_number(what, axes[axis]) for axis in sorted(axes)]
    if not isinstance(value, list):
        raise AnswerError(f"{what} is not a list of numbers.")
    content = cast(list[object], value)
    if len(content) == 1 and isinstance(content[0], list):
        return _row(cast(object, content[0]), what)
    if content and all(isinstance(one, str) and (one.strip(".<>_ ") or "x").isidentifier() for one in content):
        raise AnswerError(f"{what} {PLACEHOLDERS}.")
    return [_number(what, number) for number in content]


def _number(what: str, value: object) -> float:
    """A number from JSON, or its spelling."""
    if isinstance(value, list) and len(cast(list[object], value)) == 1:
        value = cast(list[object], value)[0]
    if isinstance(value, str):
        items = items_of(plain(value))
        if len(items) == 1 and items[0].kind == "number":
            return _numbers(what, [items[0].text])[0]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise AnswerError(f"{what} holds something that is not a number.")
    try:
        return float(value)
    except OverflowError:
        return math.inf


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


def _index(value: float, n: int) -> int:
    if not (math.isfinite(value) and value == int(value) and 0 <= value < n):
        raise AnswerError(f"my plan is {value:g}; a whole number from 0 to {n - 1} is required (places count from 0).")
    return int(value)
