"""Finds the JSON objects of an answer, also those that are not quite JSON.

What is left unclosed is not read. Objects with line ends in strings, single quotes, comments, bare words, and commas
too many or missing are spelled out as JSON first, token by token.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, cast

from llm_flock.errors import AnswerError
from llm_flock.llm._answer_forms import REASONING

_BRACE_OR_STRING = re.compile(r'[{}]|"(?:[^"\\]++|\\.)*+"?+', re.DOTALL)
"""Braces structure a JSON object; strings are matched whole, as they may hold braces."""

_OBJECT = re.compile(r"""\{\s*+["']""")
_LOOSE = re.compile(
    r"""(?P<string>"(?:[^"\\]|\\.|"(?!\s*+(?:[,:;}\])]|"[^"\n]{0,40}"\s*+:|$)))*"|'(?:[^'\\]|\\.|'(?!\s*+[,:;}\])]))*')
      |(?P<comment>//[^\n]*+|/\*.{0,200}?\*/)
      |(?P<mark>[{}\[\]():,;])
      |(?P<bare>[^\s{}\[\]():,;"']++)""",
    re.DOTALL | re.VERBOSE,
)
_MARKS = {"(": "[", ")": "]", ";": ","}
_PLAIN = re.compile(r"-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?|true|false|null")
MAX_DEPTH = 6
"""Deepest object around an answer."""


class Several(list[object]):
    """The values of a key that an object has more than once."""


@dataclass(frozen=True, slots=True)
class Found:
    """An object with one of the wanted fields, and where it stands in the text."""

    fields: Mapping[str, Any]
    start: int
    end: int


def objects(text: str, *wanted: str) -> list[Found]:
    """The objects that hold an answer, or else the last object of the text.

    AnswerError if the last one is cut off, or has a reasoning but cannot be read: its draft must not be read as text.
    """
    found: list[Found] = []
    last: Found | None = None
    end, broken = 0, False
    while (begin := text.find("{", end)) >= 0:
        end = _end_of_object(text, begin)
        if end < 0:
            broken = _OBJECT.search(text, begin) is not None
            break
        value = _decoded(text[begin:end])
        if not isinstance(value, Mapping):
            broken = broken or REASONING in text[begin:end]
            continue
        last = Found(cast(Mapping[str, Any], value), begin, end)
        inner = list(_holding(last.fields, wanted, MAX_DEPTH))
        found += [Found(fields, begin, end) for fields in inner]
        broken = broken and not inner
    if broken:
        raise AnswerError("its JSON object is not complete, or is no JSON; one whole JSON object is required.")
    return found or ([] if last is None else [last])


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


def _pairs(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """An object whose keys are in small letters; a key that comes twice has `Several` values if they differ."""
    out: dict[str, object] = {}
    for key, value in pairs:
        name = key.strip().lower().replace(" ", "_").replace("-", "_")
        if name in out and out[name] != value:
            out[name] = Several([out[name], value])
        else:
            out[name] = value
    return out


def _decoded(text: str) -> object:
    """The value of a text that is JSON, or nearly; None for anything else."""
    for spelled in (lambda: text, lambda: _spelled_out(text)):
        try:
            return json.loads(spelled(), strict=False, object_pairs_hook=_pairs)
        except (ValueError, RecursionError):
            continue
    return None


def _spelled_out(text: str) -> str:
    """A text that is nearly JSON as JSON."""
    out: list[str] = []
    last = ""
    for token in _LOOSE.finditer(text):
        if token["comment"]:
            continue
        if token["mark"]:
            mark = _MARKS.get(token[0], token[0])
            if mark in "}]" and last == ",":
                out.pop()
            piece = mark
        elif token["string"]:
            piece = json.dumps(re.sub(r"\\(.)", r"\1", token[0][1:-1], flags=re.DOTALL))
        else:
            piece = token[0] if _PLAIN.fullmatch(token[0]) else json.dumps(token[0])
        if last and last not in ",:[{" and piece not in ",:]}":
            out.append(",")
        out.append(piece)
        last = piece
    return "".join(out)


def _holding(value: object, wanted: tuple[str, ...], depth: int) -> Iterator[Mapping[str, Any]]:
    """The objects in a value that have a wanted field, outermost first; also in a text that is an object itself."""
    if depth == 0:
        return
    if isinstance(value, Mapping):
        fields = cast(Mapping[str, Any], value)
        if any(name in fields and not isinstance(fields[name], Mapping | str) for name in wanted) or (
            any(name in fields for name in wanted) and not any(_deeper(fields, wanted, depth))
        ):
            yield fields
            return
        yield from _deeper(fields, wanted, depth)
    elif isinstance(value, list):
        for item in cast(list[object], value):
            yield from _holding(item, wanted, depth - 1)
    elif isinstance(value, str) and value.lstrip().startswith("{"):
        yield from _holding(_decoded(value), wanted, depth - 1)


def _deeper(fields: Mapping[str, Any], wanted: tuple[str, ...], depth: int) -> Iterator[Mapping[str, Any]]:
    for item in fields.values():
        yield from _holding(item, wanted, depth - 1)
