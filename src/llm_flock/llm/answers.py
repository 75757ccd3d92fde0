r"""From a model's answer to values: tolerant of how it is written, strict about what it says.

Read are the paper's forms `Plan: [[x, y], ...]` with `my plan: a` or `my_plan: a` (lines 118 and 391) and
`Position: [x, y]` (line 110), and our own `Path: [[x, y], ...]`, among prose, markdown, code fences and LaTeX
(`\boxed{\text{Position: } [x,\ y]}`, line 739). The last complete candidate counts. A list holds plain numbers: what
would have to be worked out is no answer.

All patterns are possessive where they repeat, and start at a label or a bracket: the time is linear in the length of
the answer, whatever it holds.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

from llm_flock.arrays import MAX_COORDINATE, Point
from llm_flock.errors import AnswerError
from llm_flock.protocol.plan import Plan

MAX_CHARS = 1_000_000
"""Longer answers are not read."""

MAX_DIGITS = 40
"""Longest spelling of a number."""

_TYPOGRAPHY = str.maketrans(
    dict.fromkeys("\u2010\u2011\u2012\u2013\u2212\ufe63\uff0d", "-")
    | dict.fromkeys("\u00a0\u2002\u2003\u2007\u2008\u2009\u200a\u202f\u205f\u3000", " ")
    | dict.fromkeys("\u200b\u2060\ufeff", "")
    | {"\uff1a": ":", "\uff0c": ",", "\uff1b": ";", "\uff3b": "[", "\uff3d": "]", "\uff08": "(", "\uff09": ")"}
)
_LATEX_SPACES = ("\\ ", "\\,", "\\;", "\\:", "\\!", "\\\\")
_LATEX_FORMATS = re.compile(
    r"\\(?:left|right|[bB]igg?[lr]?|text(?:bf|it|rm|tt|sf)?|math(?:bf|it|rm|tt|sf)|displaystyle|q?quad|newline)"
    r"(?![A-Za-z])"
)
_ESCAPED_NEWLINE = re.compile(r"\\n(?![a-ln-z])(?!m(?!y))")
"""A backslash and an n that stand for a line break, not the beginning of a LaTeX command."""

# Possessive throughout: a repetition never gives back what it has taken.
_NUMBER = r"[-+]?+(?:(?:[0-9]++(?:\.[0-9]*+)?+|\.[0-9]++)(?:e[-+]?+[0-9]++)?+|nan|inf(?:inity)?+)"
_ITEM = rf"(?:[xyz]\s*+[=:]\s*+)?+{_NUMBER}"
_LIST = rf"[\[(]\s*+{_ITEM}(?:(?:\s*+[,;]\s*+|\s++){_ITEM})*+\s*+[,;]?+\s*+[\])]"
_LISTS = rf"[\[(]\s*+{_LIST}(?:\s*+[,;]?+\s*+{_LIST})*+\s*+[,;]?+\s*+[\])]"
_MARKUP = r"\s*_`\"'$&{}|~>#"
_GAP = rf"[{_MARKUP}:=≈→-]*+"
_WRAP = r"(?:[\[(]\s*+){0,2}?"
_LANGUAGE = rf"(?:(?:json|python|text|latex|math)(?![A-Za-z]){_GAP})?+"
"""What a code fence may say after its backticks."""

# The look at the first letter changes nothing but the time: where it does not fit, nothing else is tried.
_POSITION = re.compile(
    r"(?=[nfp\\])"
    rf"(?:(?P<certain>(?:next|new|final)[{_MARKUP}]++position|\\boxed)|(?P<plain>(?<![A-Za-z])position))(?![A-Za-z])"
    rf"(?P<gap>{_GAP}(?:(?:is|at|will\sbe)(?![A-Za-z]){_GAP})?+){_WRAP}(?P<list>{_LIST})",
    re.IGNORECASE,
)
_STATES = frozenset(":=≈→")
"""One of these stands between a bare `Position` and the answer."""

_BEFORE_POSITION = re.compile(
    r"(?:[^A-Za-z0-9\s*_`\"']|\n|(?<![A-Za-z])(?:the|answer|so|thus|hence|therefore|chosen|proposed|updated))"
    r"[\s*_`\"']*$",
    re.IGNORECASE,
)
"""What may stand before a bare `Position:`; "Your position:" and "Goal position:" only repeat the question."""

_PLAN = re.compile(
    rf"(?:plan(?![A-Za-z])|\\boxed){_GAP}{_LANGUAGE}{_WRAP}(?P<list>{_LISTS})",
    re.IGNORECASE,
)
_PATH = re.compile(
    rf"(?:(?<![A-Za-z])path(?![A-Za-z])|\\boxed){_GAP}{_LANGUAGE}{_WRAP}(?P<list>{_LISTS})",
    re.IGNORECASE,
)
_BARE_PLAN = re.compile(rf"(?P<list>{_LISTS})", re.IGNORECASE)
_BARE_POSITION = re.compile(rf"[{_MARKUP}]*+{_LANGUAGE}(?P<list>{_LIST})[{_MARKUP}.]*+", re.IGNORECASE)
_INDEX = re.compile(
    rf"(?<![A-Za-z])my[\s_\\-]*+plan[{_MARKUP}:=]*+"
    rf"(?:(?:is|index|number|place|location|position|point|slot)(?![A-Za-z])[{_MARKUP}:=]*+){{0,3}}+"
    rf"(?:[\[(]\s*+(?P<wrapped>{_NUMBER})\s*+[\])]|(?P<bare>{_NUMBER})(?![A-Za-z0-9_%/^]))",
    re.IGNORECASE,
)
_EACH_LIST = re.compile(_LIST, re.IGNORECASE)
_EACH_NUMBER = re.compile(_NUMBER, re.IGNORECASE)


def parse_plan(text: str, n: int, dim: int) -> tuple[Plan, int]:
    """The plan and the index of the model's own place in it, from an answer in words.

    Args:
        text: the answer.
        n: number of places that the plan must have.
        dim: number of coordinates of each.

    Raises:
        AnswerError: with a reason that the model can act on; never anything else.
    """
    text = _plain(text)
    found = _last(_PLAN, text) or _last(_BARE_PLAN, text)
    if found is None:
        raise AnswerError(
            f"it holds no complete plan; a line `Plan: [[...], ...]` with {n} points of {dim} numbers is required."
        )
    lists = _EACH_LIST.findall(found["list"])
    _check_count(len(lists), n)
    points = [_place(number, row, dim) for number, row in enumerate(lists)]
    index = _last(_INDEX, text)
    if index is None:
        raise AnswerError(
            f"it does not say which place is yours; a line `my plan: a` with a from 0 to {n - 1} is required."
        )
    return Plan(tuple(points)), _index(_spelled("my plan", index["wrapped"] or index["bare"]), n)


def parse_step(text: str, dim: int) -> Point:
    """The waypoint from an answer in words, `dim` coordinates [units].

    Raises:
        AnswerError: with a reason that the model can act on; never anything else.
    """
    row = _position_row(_plain(text))
    if row is None:
        raise AnswerError(f"it holds no complete position; a line `Position: [...]` with {dim} numbers is required.")
    return _point("the position", _numbers("the position", row), dim)


def _position_row(plain: str) -> str | None:
    """The last labelled position, or the only thing that is said."""
    row: str | None = None
    for match in _POSITION.finditer(plain):
        if match["certain"] is not None or _stands_alone(plain, match):
            row = match["list"]
    if row is None:
        bare = _BARE_POSITION.fullmatch(plain)
        row = None if bare is None else bare["list"]
    return row


def parse_path(text: str, horizon: int, dim: int) -> tuple[Point, ...]:
    """The waypoints from an answer in words, 1 to `horizon` of them; a single position is a path of one.

    Raises:
        AnswerError: with a reason that the model can act on; never anything else.
    """
    plain = _plain(text)
    found = _last(_PATH, plain)
    if found is None and (row := _position_row(plain)) is not None:
        return (_point("the position", _numbers("the position", row), dim),)
    found = found or _last(_BARE_PLAN, plain)
    if found is None:
        required = f"a line `Path: [[...], ...]` with 1 to {horizon} positions of {dim} numbers is required."
        raise AnswerError(f"it holds no complete path; {required}")
    rows = [_numbers("the path", row) for row in _EACH_LIST.findall(found["list"])]
    return _path(rows, horizon, dim)


def parse_plan_json(text: str, n: int, dim: int) -> tuple[Plan, int]:
    """As `parse_plan`, from the JSON object `{"plan": [[x, y], ...], "my_plan": a}`, also inside prose or a code fence.

    What is no JSON is read as words: models that know no schema often answer so.

    Raises:
        AnswerError: with a reason that the model can act on; never anything else.
    """
    answer = _json_object(text)
    if answer is None:
        return parse_plan(text, n, dim)
    rows = _field(answer, "plan", f"a list of {n} points")
    if not isinstance(rows, list):
        raise AnswerError(f'"plan" is not a list; a list of {n} points is required.')
    rows = cast(list[Any], rows)
    _check_count(len(rows), n)
    points = [_point(what, _row(what, row), dim) for what, row in zip(_names(n), rows, strict=True)]
    index = _number("my_plan", _field(answer, "my_plan", f"a whole number from 0 to {n - 1}"))
    return Plan(tuple(points)), _index(index, n)


def parse_step_json(text: str, dim: int) -> Point:
    """As `parse_step`, from the JSON object `{"position": [x, y]}`, also inside prose or a code fence.

    Raises:
        AnswerError: with a reason that the model can act on; never anything else.
    """
    answer = _json_object(text)
    if answer is None:
        return parse_step(text, dim)
    position = _field(answer, "position", f"a list of {dim} numbers")
    return _point("the position", _row("the position", position), dim)


def parse_path_json(text: str, horizon: int, dim: int) -> tuple[Point, ...]:
    """As `parse_path`, from the JSON object `{"path": [[x, y], ...]}`, also inside prose or a code fence.

    Raises:
        AnswerError: with a reason that the model can act on; never anything else.
    """
    answer = _json_object(text)
    if answer is None:
        return parse_path(text, horizon, dim)
    if "path" not in answer and "position" in answer:
        return (parse_step_json(text, dim),)
    rows = _field(answer, "path", f"a list of 1 to {horizon} positions")
    if not isinstance(rows, list):
        raise AnswerError(f'"path" is not a list; a list of 1 to {horizon} positions is required.')
    return _path([_row("the path", row) for row in cast(list[Any], rows)], horizon, dim)


def _path(rows: Sequence[Sequence[float]], horizon: int, dim: int) -> tuple[Point, ...]:
    if not 1 <= len(rows) <= horizon:
        raise AnswerError(f"the path holds {len(rows)} positions, 1 to {horizon} are required.")
    return tuple(_point(f"position {k} of the path", row, dim) for k, row in enumerate(rows, start=1))


def _plain(text: str) -> str:
    """The answer without typographic variants and without LaTeX's formatting."""
    _check_length(text)
    if not text.isascii():
        text = text.translate(_TYPOGRAPHY)
    if "\\" not in text:
        return text
    text = _ESCAPED_NEWLINE.sub("\n", text)
    for space in _LATEX_SPACES:
        text = text.replace(space, " ")
    for escaped in "_[]()":
        text = text.replace("\\" + escaped, escaped)
    return _LATEX_FORMATS.sub(" ", text)


def _check_length(text: str) -> None:
    if len(text) > MAX_CHARS:
        raise AnswerError(f"it is {len(text)} characters long, {MAX_CHARS} are the limit.")


def _last(pattern: re.Pattern[str], text: str) -> re.Match[str] | None:
    last = None
    for last in pattern.finditer(text):  # noqa: B007 - the loop's last value is what is wanted
        pass
    return last


def _stands_alone(text: str, match: re.Match[str]) -> bool:
    """Whether a bare `Position` is an answer: a colon or the like follows, and no other word qualifies it."""
    if _STATES.isdisjoint(match["gap"]):
        return False
    start = match.start()
    before = text[start - 16 : start] if start >= 16 else "\n" + text[:start]
    return _BEFORE_POSITION.search(before) is not None


def _json_object(text: str) -> Mapping[str, Any] | None:
    """The JSON object that the answer is or holds, None where there is none."""
    _check_length(text)
    begin, end = text.find("{"), text.rfind("}")
    if not 0 <= begin < end:
        return None
    try:
        value = json.loads(text[begin : end + 1])
    except (ValueError, RecursionError):
        return None
    return cast(Mapping[str, Any], value)


def _field(answer: Mapping[str, Any], name: str, required: str) -> object:
    if name not in answer:
        raise AnswerError(f'the JSON object has no "{name}"; {required} is required.')
    return answer[name]


def _names(n: int) -> list[str]:
    """What the points of a plan are called in a reason."""
    return [f"point {i} of the plan" for i in range(n)]


def _numbers(what: str, row: str) -> list[float]:
    """The numbers of a list that is known to hold nothing else."""
    return [_spelled(what, number) for number in _EACH_NUMBER.findall(row)]


def _spelled(what: str, number: str) -> float:
    if len(number) > MAX_DIGITS:
        raise AnswerError(f"{what} holds a number of {len(number)} characters, {MAX_DIGITS} are the limit.")
    return float(number)


def _row(what: str, value: object) -> list[float]:
    """The numbers of a list from JSON."""
    if not isinstance(value, list):
        raise AnswerError(f"{what} is not a list of numbers.")
    return [_number(what, number) for number in cast(list[object], value)]


def _number(what: str, value: object) -> float:
    """A number from JSON."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise AnswerError(f"{what} holds something that is not a number.")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _check_count(count: int, n: int) -> None:
    if count != n:
        raise AnswerError(f"the plan holds {count} {'point' if count == 1 else 'points'}, {n} are required.")


def _place(number: int, row: str, dim: int) -> Point:
    """A point of a plan; reasons are worded only where there is something to object to, for plans are long."""
    spelled = _EACH_NUMBER.findall(row)
    if len(spelled) == dim and max(map(len, spelled)) <= MAX_DIGITS:
        values = tuple(map(float, spelled))
        if all(abs(value) <= MAX_COORDINATE for value in values):
            return values
    what = f"point {number} of the plan"
    return _point(what, _numbers(what, row), dim)


def _point(what: str, values: Sequence[float], dim: int) -> Point:
    if len(values) != dim:
        raise AnswerError(
            f"{what} has {len(values)} {'number' if len(values) == 1 else 'numbers'}, {dim} are required."
        )
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
