r"""Read a model's answer: tolerant of its form, strict about its content.

The forms are the paper's `Plan: [[x, y], ...]` with `my plan: a` or `my_plan: a` (lines 118 and 391) and
`Position: [x, y]` (line 110), and our own `Path: [[x, y], ...]`, among prose, markdown, code fences and LaTeX
(`\boxed{\text{Position: } [x,\ y]}`, line 739). The last complete candidate counts. A list holds plain numbers: an
expression such as `3 + 4` is no answer. The same values may come as a JSON object, see `answer_forms`.

All patterns are possessive where they repeat, and start at a label or a bracket, so the time is linear in the length of
any answer.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

from llm_flock.arrays import MAX_COORDINATE, Point
from llm_flock.errors import AnswerError
from llm_flock.llm._answer_forms import REASONING
from llm_flock.llm._port import AnswerForm
from llm_flock.llm._thoughts import spoken
from llm_flock.plan import Plan

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
"""A backslash and an n that stand for a line break, not for the beginning of a LaTeX command."""

# Possessive throughout: a repetition never gives back what it has taken.
_NUMBER = r"[-+]?+(?:(?:[0-9]++(?:\.[0-9]*+)?+|\.[0-9]++)(?:e[-+]?+[0-9]++)?+|nan|inf(?:inity)?+)"
_ITEM = rf"(?:[xyz]\s*+[=:]\s*+)?+{_NUMBER}"
_LIST = rf"[\[(]\s*+{_ITEM}(?:(?:\s*+[,;]\s*+|\s++){_ITEM})*+\s*+[,;]?+\s*+[\])]"
_LISTS = rf"[\[(]\s*+{_LIST}(?:\s*+[,;]?+\s*+{_LIST})*+\s*+[,;]?+\s*+[\])]"
_MARKUP = r"\s*_`\"'$&{}|~>#"
_GAP = rf"[{_MARKUP}:=≈→-]*+"
_WRAP = r"(?:[\[(]\s*+){0,2}?"
_LANGUAGE = rf"(?:(?:json|python|text|latex|math)(?![A-Za-z]){_GAP})?+"
"""A language after the backticks of a code fence."""

# The look-ahead to the first letter only saves time.
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
"""Allowed before a bare `Position:`; "Your position:" and "Goal position:" only repeat the question."""

_PLAN = re.compile(rf"(?:plan(?![A-Za-z])|\\boxed){_GAP}{_LANGUAGE}{_WRAP}(?P<list>{_LISTS})", re.IGNORECASE)
_PATH = re.compile(
    rf"(?:(?<![A-Za-z])path(?![A-Za-z])|\\boxed){_GAP}{_LANGUAGE}{_WRAP}(?P<list>{_LISTS})", re.IGNORECASE
)
_BARE_PLAN = re.compile(rf"(?P<list>{_LISTS})", re.IGNORECASE)
_BARE_POSITION = re.compile(rf"[{_MARKUP}]*+{_LANGUAGE}(?P<list>{_LIST})[{_MARKUP}.]*+", re.IGNORECASE)
_INDEX = re.compile(
    rf"(?<![A-Za-z])my[\s_\\-]*+plan[{_MARKUP}:=]*+"
    rf"(?:(?:is|index|number|place|location|position|point|slot)(?![A-Za-z])[{_MARKUP}:=]*+){{0,3}}+"
    rf"(?:[\[(]\s*+(?P<wrapped>{_NUMBER})\s*+[\])]|(?P<bare>{_NUMBER})(?![A-Za-z0-9_%/^]))",
    re.IGNORECASE,
)
_BRACE_OR_STRING = re.compile(r'[{}]|"(?:[^"\\]++|\\.)*+"?+', re.DOTALL)
"""Braces structure a JSON object; strings are matched whole, as they may hold braces."""

_OBJECT = re.compile(r"""\{\s*+["']""")
_EACH_LIST = re.compile(_LIST, re.IGNORECASE)
_EACH_NUMBER = re.compile(_NUMBER, re.IGNORECASE)


def read_plan(text: str, form: AnswerForm) -> tuple[Plan, int]:
    """The plan and the index of the model's own place in it; AnswerError with a reason for the model."""
    n, dim = form.n, form.dim
    names = [f"point {i} of the plan" for i in range(n)]
    text = _without_thoughts(text)
    answer = _json_object(text, "plan") if form.json else None
    if answer is not None:
        rows = _list_field(answer, "plan", f"a list of {n} points")
        _check_count(len(rows), n)
        points = [_point(what, _row(what, row), dim) for what, row in zip(names, rows, strict=True)]
        index = _number("my_plan", _field(answer, "my_plan", f"a whole number from 0 to {n - 1}"))
        return Plan(tuple(points)), _index(index, n)
    text = _plain(text)
    match = _last(_PLAN, text) or _last(_BARE_PLAN, text)
    if match is None:
        required = f"a line `Plan: [[...], ...]` with {n} points of {dim} numbers is required."
        raise AnswerError(f"it holds no complete plan; {required}")
    lists = _EACH_LIST.findall(match["list"])
    _check_count(len(lists), n)
    points = [_point(what, _numbers(what, row), dim) for what, row in zip(names, lists, strict=True)]
    index = _last(_INDEX, text)
    if index is None:
        required = f"a line `my plan: a` with a from 0 to {n - 1} is required."
        raise AnswerError(f"it does not say which place is yours; {required}")
    return Plan(tuple(points)), _index(_numbers("my plan", index["wrapped"] or index["bare"])[0], n)


def read_waypoints(text: str, form: AnswerForm) -> tuple[Point, ...]:
    """The 1 to `form.horizon` next positions [units]; AnswerError as in `read_plan`.

    If the question is for a path, a single position is a path of length one.
    """
    dim, horizon = form.dim, form.horizon
    text = _without_thoughts(text)
    answer = _json_object(text, "path", "position") if form.json else None
    if answer is not None:
        if horizon == 1 or ("path" not in answer and "position" in answer):
            position = _field(answer, "position", f"a list of {dim} numbers")
            return (_point("the position", _row("the position", position), dim),)
        rows = _list_field(answer, "path", f"a list of 1 to {horizon} positions")
        return _path([_row("the path", row) for row in rows], horizon, dim)
    text = _plain(text)
    match = _last(_PATH, text) if horizon > 1 else None
    if match is None and (row := _position_row(text)) is not None:
        return (_point("the position", _numbers("the position", row), dim),)
    if horizon == 1:
        raise AnswerError(f"it holds no complete position; a line `Position: [...]` with {dim} numbers is required.")
    match = match or _last(_BARE_PLAN, text)
    if match is None:
        required = f"a line `Path: [[...], ...]` with 1 to {horizon} positions of {dim} numbers is required."
        raise AnswerError(f"it holds no complete path; {required}")
    rows = [_numbers("the path", row) for row in _EACH_LIST.findall(match["list"])]
    return _path(rows, horizon, dim)


def _position_row(plain: str) -> str | None:
    """The last labelled position, or else a list that is the whole answer."""
    row: str | None = None
    for match in _POSITION.finditer(plain):
        if match["certain"] is not None or _stands_alone(plain, match):
            row = match["list"]
    if row is None:
        bare = _BARE_POSITION.fullmatch(plain)
        row = None if bare is None else bare["list"]
    return row


def _path(rows: Sequence[Sequence[float]], horizon: int, dim: int) -> tuple[Point, ...]:
    if not 1 <= len(rows) <= horizon:
        raise AnswerError(f"the path holds {len(rows)} positions, 1 to {horizon} are required.")
    return tuple(_point(f"position {k} of the path", row, dim) for k, row in enumerate(rows, start=1))


def _plain(text: str) -> str:
    """The answer without typographic variants and without LaTeX's formatting."""
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


def _without_thoughts(text: str) -> str:
    """The text without thoughts, because a position in a thought is a draft."""
    if len(text) > MAX_CHARS:
        raise AnswerError(f"it is {len(text)} characters long, {MAX_CHARS} are the limit.")
    answer = spoken(text)
    if answer.unfinished or (answer.thought and not answer.text.strip()):
        raise AnswerError("it holds nothing but thoughts; think less, and give the answer itself.")
    return answer.text


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


def _json_object(text: str, *fields: str) -> Mapping[str, Any] | None:
    """The last JSON object with one of these fields, or else the last object, or None.

    AnswerError if an object is cut off, or if it holds a reasoning but is not JSON: its draft must not be read as text.
    """
    last, wanted, end, broken = None, None, 0, False
    while (begin := text.find("{", end)) >= 0:
        end = _end_of_object(text, begin)
        if end < 0:
            broken = _OBJECT.search(text, begin) is not None
            break
        try:
            value = cast(Mapping[str, Any], json.loads(text[begin:end]))
        except (ValueError, RecursionError):
            broken = broken or REASONING in text[begin:end]
            continue
        last = value
        if any(field in value for field in fields):
            wanted, broken = value, False
    if broken:
        raise AnswerError("its JSON object is not complete, or is no JSON; one whole JSON object is required.")
    return wanted or last


def _end_of_object(text: str, begin: int) -> int:
    """The index after the brace that closes the one at `begin`; -1 if none does."""
    depth = 0
    for token in _BRACE_OR_STRING.finditer(text, begin):
        if token[0] == "{":
            depth += 1
        elif token[0] == "}":
            depth -= 1
            if depth == 0:
                return token.end()
    return -1


def _field(answer: Mapping[str, Any], name: str, required: str) -> object:
    if name not in answer:
        raise AnswerError(f'the JSON object has no "{name}"; {required} is required.')
    return answer[name]


def _list_field(answer: Mapping[str, Any], name: str, required: str) -> list[object]:
    value = _field(answer, name, required)
    if not isinstance(value, list):
        raise AnswerError(f'"{name}" is not a list; {required} is required.')
    return cast(list[object], value)


def _numbers(what: str, row: str) -> list[float]:
    """The numbers of a list in the form of `_LIST`."""
    spelled = _EACH_NUMBER.findall(row)
    for number in spelled:
        if len(number) > MAX_DIGITS:
            raise AnswerError(f"{what} holds a number of {len(number)} characters, {MAX_DIGITS} are the limit.")
    return list(map(float, spelled))


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
