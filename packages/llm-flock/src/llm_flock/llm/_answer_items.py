r"""Turns the text of an answer into items: words, signs, line ends, numbers, points and lists of points.

One pattern finds the tokens, and a stack of open brackets joins them, so the time is linear in the length of the text.
Brackets that hold words are prose: their content stays in the text. Everything else (markdown, quotes, LaTeX's dollars)
is no token.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from llm_flock.errors import AnswerError

_TYPOGRAPHY = str.maketrans(
    dict.fromkeys("\u2010\u2011\u2012\u2013\u2212\ufe63\uff0d", "-")
    | dict.fromkeys("\u00a0\u2002\u2003\u2007\u2008\u2009\u200a\u202f\u205f\u3000", " ")
    | dict.fromkeys("\u200b\u2060\ufeff", "")
    | {"\uff1a": ":", "\uff0c": ",", "\uff1b": ";", "\uff3b": "[", "\uff3d": "]", "\uff08": "(", "\uff09": ")"}
    | {"\u2018": "'", "\u2019": "'", "\u201c": '"', "\u201d": '"', "\u27e8": "<", "\u27e9": ">", "\u2014": ". "}
)
_LATEX = re.compile(
    r"\\(?:left|right|[bB]igg?[lr]?|text(?:bf|it|rm|tt|sf)?|math(?:bf|it|rm|tt|sf)|displaystyle|q?quad|newline)"
    r"(?![A-Za-z])|\\n(?![a-ln-z])(?!m(?!y))|\\[ ,;:!\\]|\\(?=[_\[\]()])"
)
"""Formatting, which becomes a space; `\n` that stands for a line break; and escaped brackets."""

_MATRIX = re.compile(r"\\(?P<what>begin|end)\{[pbvBV]?matrix\*?\}|\\\\|&")
_STRUCK = re.compile(r"~~|</?\s*+(?:s|del|strike)\s*+>", re.IGNORECASE)
_ANSWER_TAG = re.compile(
    r"<(?P<end>/?)(?:answer|final|solution|response|output)>|<\|(?:begin_of_solution|START_RESPONSE)\|>", re.IGNORECASE
)

_TOKEN = re.compile(
    r"""(?P<number>[-+]?+(?:(?:[0-9]++(?:\.[0-9]++|\.(?![.\s]|$))?+|\.[0-9]++)(?:e[-+]?+[0-9]++)?+
           |(?:nan|inf(?:inity)?+)(?![A-Za-z_])|∞))
      |(?P<word>[^\W_]++(?:_++[^\W_]++)*+(?:'[a-z]++)?+)
      |(?P<open>[\[(]|\{(?=\s{0,9}["']?[xyz]["']?\s{0,9}[:=])|<(?=[-+\d.,;\s]{1,200}>))
      |(?P<dots>\.{3}|…)
      |(?P<stop>[.!?](?=\s|[)\]*_"'`~]|$))
      |(?P<to>(?:-{1,4}|={1,4})>|[→⇒➜➔⟶⟹])
      |(?P<from><-{1,4}|[←⇐])
      |(?P<close>[\])}>])
      |(?P<comma>[,;|])
      |(?P<equals>[=≈])
      |(?P<sign>:)
      |(?P<operator>[+/\u00d7\u00b7±^%°-]|(?<=[\d\])])\ ?\*(?=\ ?[\d\[(-]))
      |(?P<line>\n)""",
    re.IGNORECASE | re.VERBOSE,
)
MAX_ITEMS = 30_000
"""Most items of an answer: longer ones are runaway answers."""

_AXES = "xyz"
_PAIRS = {"]": "[(", ")": "[(", "}": "{", ">": "<"}
UNITS = frozenset({"unit", "units", "u", "m", "meter", "meters", "metre", "metres"})
"""Words after a number that leave it as it is: no prompt says of what size a unit is."""

FOREIGN_UNITS = frozenset(
    {"cm", "mm", "km", "dm", "ft", "feet", "foot", "in", "inch", "inches", "yd", "deg", "degrees", "rad"}
)


@dataclass(slots=True)
class Item:
    """A token, or what was made of tokens.

    `kind` is a group of `_TOKEN`, or `axes`, `point`, `points` or `bad`.
    `rows` are the numbers of a point (one row) or of points, as they are spelled. For `bad`, `text` says what is wrong.
    """

    kind: str
    text: str
    start: int
    end: int
    rows: tuple[tuple[str, ...], ...] = ()


@dataclass(slots=True)
class _Open:
    """An open bracket: where its content begins among the items."""

    bracket: str
    at: int
    start: int
    prose: bool = False


def items_of(text: str) -> list[Item]:
    """The items of an answer without thoughts; a bracket that never closes becomes a `bad` item at the end."""
    out: list[Item] = []
    opened: list[_Open] = []
    for token in _TOKEN.finditer(text):
        kind = token.lastgroup or ""
        if len(out) + len(opened) >= MAX_ITEMS:
            raise AnswerError(f"it is too long: more than {MAX_ITEMS} words and numbers; answer more briefly.")
        if kind == "open":
            opened.append(_Open(token[0], len(out), token.start()))
        elif kind == "close":
            while opened and opened[-1].bracket not in _PAIRS[token[0]] and opened[-1].bracket in "<{":
                opened.pop()
            if opened and opened[-1].bracket in _PAIRS[token[0]]:
                last = opened.pop()
                made = None if last.prose else _joined(last, out[last.at :], token.end())
                if made is not None:
                    out[last.at :] = [made]
                elif opened:
                    opened[-1].prose = True
            elif opened and token[0] == ">":
                out.append(Item("operator", ">", token.start(), token.end()))
        else:
            out.append(Item(kind, token[0], token.start(), token.end()))
    return _with_unclosed(out, opened, len(text))


def _with_unclosed(items: list[Item], opened: Sequence[_Open], end: int) -> list[Item]:
    """The items with a `bad` one where a bracket of numbers begins that never closes, in place of an open end."""
    out: list[Item] = []
    done = 0
    row = {"number", "comma", "line", "point", "points"}
    others = max((at for at, item in enumerate(items) if item.kind not in row), default=-1)
    for one in opened:
        out += items[done : one.at]
        done = one.at
        if items[done : done + 1] and items[done].kind in ("number", "point", "points"):
            out.append(Item("bad", CUT, one.start, one.start + 1))
            if others < done:
                return out
    return out + items[done:]


def _joined(opened: _Open, content: Sequence[Item], end: int) -> Item | None:
    """The item that a bracket makes; None for prose."""
    groups = [item for item in content if item.rows or item.kind in ("bad", "axes")]
    kinds = {item.kind for item in content}

    def item(kind: str, text: str = "", rows: tuple[tuple[str, ...], ...] = ()) -> Item:
        return Item(kind, text, opened.start, end, rows)

    if groups:
        if not kinds <= {"point", "points", "comma", "line", "bad", "axes", "dots", "to"}:
            return None
        wrong = [group for group in groups if not group.rows]
        if wrong or "dots" in kinds:
            return item("bad", wrong[0].text if wrong and wrong[0].kind == "bad" else PLACEHOLDERS)
        if len(groups) == 1 and groups[0].kind == "points":
            return item("points", rows=groups[0].rows)
        return item("points", rows=tuple(row for group in groups for row in group.rows))
    if "number" in kinds:
        row = row_of(content)
        if isinstance(row, tuple):
            return item("point", rows=(row,))
        prose = any(
            one.kind == "word" and len(one.text) > 2 and one.text.lower() not in UNITS | FOREIGN_UNITS
            for one in content
        )
        return None if opened.bracket == "(" and prose else item("bad", row)
    words = [one.text.lower() for one in content if one.kind in ("word", "dots")]
    if not words and kinds <= {"comma", "line"}:
        return item("bad", "is empty")
    if words and all(word in _AXES for word in words):
        return item("axes", "".join(words))
    return item("bad", PLACEHOLDERS) if opened.bracket == "[" and len(words) <= 6 and words else None


CUT = "is not complete"
PLACEHOLDERS = "holds placeholders, not numbers"
WORDS = "holds words"
EXPRESSION = "holds an expression: a plain number is required in each place"


def row_of(content: Sequence[Item]) -> tuple[str, ...] | str:
    """The numbers of a bracket in the order of the axes, or what is wrong with them."""
    axes: list[str] = []
    numbers: list[str] = []
    last: Item | None = None
    said: str | None = None  # the label of the next number
    for item in content:
        touches = last is not None and last.kind == "number" and last.end == item.start
        match item.kind:
            case "number":
                if touches:
                    return EXPRESSION
                numbers.append(item.text)
                axes.append(said or "")
                said = None
            case "word":
                word = item.text.lower()
                after_number = last is not None and last.kind == "number"
                if word in _AXES and not touches:
                    said = word
                elif after_number and word in FOREIGN_UNITS:
                    return f"has units ({item.text}), which are not allowed"
                elif not (after_number and word in UNITS):
                    return WORDS
            case "operator":
                if item.text in "%°":
                    return f"has units ({item.text}), which are not allowed"
                return EXPRESSION
            case "stop" if touches:
                pass  # "45." of numpy
            case "comma" | "line" | "sign" | "equals":
                if item.kind == "equals" and said is None:
                    return EXPRESSION
            case _:
                return WORDS
        last = item
    if any(axes):
        if "" in axes or sorted(axes) != sorted(_AXES[: len(axes)]) or said:
            return f"has labels that do not fit ({', '.join(axis or 'none' for axis in axes)})"
        return tuple(number for _, number in sorted(zip(axes, numbers, strict=True)))
    return tuple(numbers) if said is None else WORDS


def plain(text: str) -> str:
    """The answer without typographic variants, LaTeX's formatting and struck-out text; tables and matrices as lists."""
    if not text.isascii():
        text = text.translate(_TYPOGRAPHY)
    if "~~" in text or "</" in text:
        text = "".join(_unstruck(text))
    if "<" in text:
        text = _ANSWER_TAG.sub(lambda tag: "\n" if tag["end"] else "\nFinal answer:\n", text)
    if "\\" in text:
        if "matrix}" in text:
            text = _without_matrices(text)
        text = _LATEX.sub(lambda found: {"\\n": "\n", "\\": ""}.get(found[0], " "), text)
    return "\n".join(_without_tables(text.split("\n"))) if "|" in text else text


def _unstruck(text: str) -> Iterator[str]:
    """The pieces between struck-out text."""
    begin, mark = 0, ""
    for found in _STRUCK.finditer(text):
        if mark and found[0].startswith(("</", "~~")):
            begin, mark = found.end(), ""
        elif not mark and not found[0].startswith("</"):
            yield text[begin : found.start()]
            begin, mark = found.end(), found[0]
    yield text[begin:]


def _without_matrices(text: str) -> str:
    """LaTeX's matrices as lists of lists."""
    inside = False

    def written(found: re.Match[str]) -> str:
        nonlocal inside
        if found["what"]:
            inside = found["what"] == "begin"
            return "[[" if inside else "]]"
        return found[0] if not inside else ("," if found[0] == "&" else "],[")

    return _MATRIX.sub(written, text)


def _without_tables(lines: list[str]) -> Iterator[str]:
    """The lines; a row of a table whose heads are axes becomes `cell ...: [x=..., y=...]`."""
    heads: list[str] = []
    for line in lines:
        row = line.strip()
        if not row.startswith("|"):
            heads = []
            yield line
            continue
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        names = [cell.strip("*_`$ ").lower() for cell in cells]
        if set(_AXES[:2]) <= set(names) and not heads:
            heads = names
            yield ""
        elif heads and not set(row) <= set("|-: "):
            named = list(zip(heads, [*cells, *[""] * len(heads)], strict=False))
            point = ", ".join(f"{axis}={cell}" for axis, cell in named if axis in tuple(_AXES))
            rest = " ".join(cell for axis, cell in named if axis not in tuple(_AXES))
            yield f"{rest}: [{point}]"
        elif not heads:
            yield line
