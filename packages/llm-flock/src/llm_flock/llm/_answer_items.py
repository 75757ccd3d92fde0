r"""Turns the text of an answer into items: words, signs, line ends, numbers, points and lists of points.

One pattern finds the tokens, and a stack of open brackets joins them, so the time is linear in the length of the text.
Brackets that hold words are prose: their content stays in the text. Everything else (markdown, quotes, LaTeX's dollars)
is no token.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from llm_flock.errors import AnswerError

SAID = {
    name: frozenset(text.split())
    for name, text in tomllib.loads(Path(__file__).with_name("answer_words.toml").read_text(encoding="utf-8")).items()
}
"""The words that decide, by their meaning."""

_TYPOGRAPHY = str.maketrans(
    dict.fromkeys("\u2010\u2011\u2012\u2013\u2212\ufe63\uff0d", "-")
    | dict.fromkeys("\u00a0\u2002\u2003\u2007\u2008\u2009\u200a\u202f\u205f\u3000", " ")
    | dict.fromkeys("\u200b\u2060\ufeff", "")
    | {"\uff1a": ":", "\uff0c": ",", "\uff1b": ";", "\uff3b": "[", "\uff3d": "]", "\uff08": "(", "\uff09": ")"}
    | {chr(0xFF10 + digit): str(digit) for digit in range(10)}
    | {"\uff0e": ".", "\u2260": " not ", "\u274c": " wrong ", "\u2717": " wrong ", "\u2718": " wrong "}
    | {
        "\u221e": "inf",
        "\u2018": "'",
        "\u2019": "'",
        "\u201c": '"',
        "\u201d": '"',
        "\u27e8": "<",
        "\u27e9": ">",
        "\u2014": ". ",
    }
)
_LATEX = re.compile(
    r"\\(?:left|right|[bB]igg?[lr]?|text(?:bf|it|rm|tt|sf)?|math(?:bf|it|rm|tt|sf)|displaystyle|q?quad|newline)"
    r"(?![A-Za-z])|\\n(?![a-ln-z])(?!m(?!y))|\\[ ,;:!\\]|\\(?=[_\[\]()])"
    r"|\\(?:rightarrow|to|times|cdot)(?![A-Za-z])"
)
"""Formatting, which becomes a space; `\n` that stands for a line break; escaped brackets; and signs."""

_SIGNS = {"\\n": "\n", "\\": "", "\\to": "→", "\\rightarrow": "→", "\\times": "\u00d7", "\\cdot": "\u00b7"}
_MATRIX = re.compile(r"\\begin\{([pbvBV]?matrix\*?)\}(.{0,500}?)\\end\{\1\}", re.DOTALL)
_STRUCK = re.compile(
    r"~~.{1,1000}?~~|<(s|del|strike)>.{0,300}?</\1>|<!--.{0,1000}?-->|(?<![:/])//[^\n]*+|/\*.{0,200}?\*/"
    r"|^Thinking\.{3}\n.{0,5000}?\n\.{3}done thinking\.",
    re.DOTALL | re.IGNORECASE,
)
"""What does not belong to the answer: struck-out text, comments, and a thought of Ollama's command line."""

_DECIMAL_COMMAS = re.compile(r"(?<![\d,.])(\d+),(\d+) ?; (-?\d+),(\d+)(?![,.])")
_TAG = re.compile(r"<(?P<end>/?)\|?(?P<name>[a-z][a-z_]{0,30}+)(?P<more>[^<>]{0,80}+)>", re.IGNORECASE)
_STRING = re.compile(
    r"""(?<!\w)(?P<key>\w{1,40}+(?:[\ -]\w{1,40}+)?)["']?\s{0,9}:\s{0,9}(?P<quote>["'])(?!\s{0,9}\{)
        (?:(?!(?P=quote))[^\\]|\\.|(?P=quote)(?!\s*+(?:[,;}\]"]|//|$)))*+(?P=quote)?+""",
    re.DOTALL | re.VERBOSE,
)
"""A field of a JSON object with a text, which may hold line ends and quotes of its own, and may be cut off."""

_QUOTED = re.compile(r'"(\w{1,60}+)"\s{0,9}:\s{0,9}"\s{0,9}\{(?:[^"\\]|\\.)*+"', re.DOTALL)
_NESTED = re.compile(r"""(?:["'](?P<key>\w{1,60}+)["']\s{0,9}:\s{0,9})?(?:(?P<open>[\[{])|[\]}])""")
"""A field whose text is an object; where an object or a list begins, with its key, or ends."""

_TOKEN = re.compile(
    r"""(?P<point>\[-?[0-9]++(?:\.[0-9]++)?+(?:,\ ?-?[0-9]++(?:\.[0-9]++)?+){1,2}\])
      |(?P<number>[-+]?+(?:(?:[0-9]++(?:\.[0-9]++|\.(?![.\s]|$))?+|\.[0-9]++)(?:e[-+]?+[0-9]++)?+
           |(?:nan|inf(?:inity)?+)(?![A-Za-z_])))
      |(?P<word>[^\W_]++(?:_++\d[^\W_]*+)*+(?:'[a-z]++)?+)
      |(?P<open>[\[(]|\{(?=\s{0,9}["']?[xyz]["']?\s{0,9}[:=])|<(?=[-+\d.,;\s]{1,200}>))
      |(?P<dots>\.{3}|…)
      |(?P<stop>[.!?](?=\s|[)\]*_"'`~]|$))
      |(?P<to>(?:-{1,4}|={1,4})>|[→⇒➜➔⟶⟹])
      |(?P<close>[\])}>])
      |(?P<comma>[,;|])
      |(?P<equals>[=≈])
      |(?P<sign>:)
      |(?P<from><-{1,4}|[←⇐])
      |(?P<operator>[+/\u00d7\u00b7±^%°-]|(?<=[\d\])])\ ?\*(?=\ ?[\d\[(-]))
      |(?P<line>\n)""",
    re.IGNORECASE | re.VERBOSE,
)
MAX_ITEMS = 30_000
"""Most items of an answer: longer ones are runaway answers."""

_AXES = "xyz"
_PAIRS = {"]": "[(", ")": "[(", "}": "{", ">": "<"}


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
        if kind == "point":  # the common form, at once; `row_of` reads all others
            row = tuple(token[0][1:-1].replace(" ", "").split(","))
            out.append(Item(kind, "", token.start(), token.end(), (row,)))
        elif kind == "open":
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
    words = [item.text.lower() for item in content if item.kind in ("word", "dots")]
    long = {word for word in words if len(word) > 2} - SAID["units"] - SAID["foreign_units"]
    kind, text, rows = "bad", "", tuple[tuple[str, ...], ...]()
    if groups:
        if not kinds <= {"point", "points", "comma", "line", "bad", "axes", "dots", "to"}:
            return None
        text = next((group.text for group in groups if group.kind == "bad"), PLACEHOLDERS)
        if len(groups) == 1 and groups[0].rows and "dots" not in kinds:
            kind, text, rows = "points", "", groups[0].rows
        elif "points" in kinds:
            text = "gives two lists"
        elif "dots" not in kinds and all(group.rows for group in groups):
            kind, text, rows = "points", "", tuple(group.rows[0] for group in groups)
    elif "number" in kinds:
        row = row_of(content)
        if isinstance(row, tuple):
            kind, rows = "point", (row,)
        elif opened.bracket == "(" and long:
            return None
        else:
            text = row
    elif not words and kinds <= {"comma", "line"}:
        text = "is empty"
    elif words and all(word in _AXES for word in words):
        kind, text = "axes", "".join(words)
    elif words and opened.bracket == "[" and len(words) <= 6:
        text = PLACEHOLDERS
    else:
        return None
    return Item(kind, text, opened.start, end, rows)


CUT = "is not complete"
PLACEHOLDERS = "holds placeholders, not numbers"
WORDS = "holds words"
EXPRESSION = "holds an expression: a plain number is required in each place"


def row_of(content: Sequence[Item]) -> tuple[str, ...] | str:
    """The numbers of a bracket in the order of the axes, or what is wrong with them."""
    axes: list[str] = []
    numbers: list[str] = []
    said, last = "", Item("", "", -1, -1)  # the label of the next number, and the item before
    for item in content:
        word = item.text.lower()
        follows, touches = last.kind == "number", last.kind == "number" and last.end == item.start
        if item.kind == "number" and not touches:
            numbers.append(item.text)
            axes.append(said)
            said = ""
        elif follows and word in SAID["foreign_units"]:
            return f"has units ({item.text}), which are not allowed"
        elif item.kind == "word" and word in _AXES and not touches:
            said = word
        elif item.kind in ("number", "operator") or (item.kind == "equals" and not said):
            return EXPRESSION
        elif not (item.kind in ("comma", "line", "sign", "equals") or (follows and word in SAID["units"])) and not (
            item.kind == "stop" and touches  # "45." of numpy
        ):
            return WORDS
        last = item
    if said:
        return WORDS
    if any(axes) and sorted(axes) != sorted(_AXES[: len(axes)]):
        return f"has labels that do not fit ({', '.join(axis or 'none' for axis in axes)})"
    return tuple(number for _, number in sorted(zip(axes, numbers, strict=True), key=lambda pair: pair[0]))


def plain(text: str) -> str:
    """The answer in one way of writing: without LaTeX's formatting, struck-out text and the texts of JSON objects.

    Tables and matrices become lists. A JSON object needs nothing else to be read as labels with values.
    """
    if not text.isascii():
        text = text.translate(_TYPOGRAPHY)
    if '{\\"' in text:  # an object as the text of a string
        text = _QUOTED.sub(lambda field: field[0] if _role(field[1]) != "other" else "", text).replace('\\"', '"')
    if "{" in text:
        text = _STRING.sub(_without_prose, re.sub(r"(?<=[a-z])(?=(?:Plan|Position|Path)\b)", "_", text))
        text = re.sub(r"\}\s*+(?=\{)", "}\n", _without_others(text))
    text = _DECIMAL_COMMAS.sub(r"\1.\2; \3.\4", text)
    text = _STRUCK.sub("", text.replace("!=", " not ").replace("i.e.", "ie"))
    text = re.sub(r"(?<=[\])]) ?x(?= ?\d)", "\u00d7", text)
    if "<" in text:
        text = _TAG.sub(_without_tag, text)
    if "\\" in text:
        text = _MATRIX.sub(lambda found: "[[" + found[2].replace("&", ",").replace(r"\\", "],[") + "]]", text)
        text = _LATEX.sub(lambda found: _SIGNS.get(found[0], " "), text)
    return "\n".join(_without_tables(text.split("\n"))) if "|" in text else text


def _without_tag(tag: re.Match[str]) -> str:
    """A tag of an answer or of a value as its label; any other as a space."""
    name = tag["name"].lower()
    if tag["end"] or name in SAID["line_tags"]:
        return "\n"
    if name in SAID["answer_tags"]:
        return "\nFinal answer:\n"
    return f" {name}: {tag['more'].strip('/|')}" if name.split("_")[-1] in SAID["fields"] else " "


def _without_prose(field: re.Match[str]) -> str:
    return field[0] if _role(field["key"]) == "field" else field["key"] + ":"


def _role(key: str) -> str:
    """What the key of an object holds: an answer's `field`, something around it, or something `other`."""
    words = re.split(r"[\W_]", key.lower())
    return "field" if words[-1] in SAID["fields"] else "around" if SAID["around"].issuperset(words) else "other"


def _without_others(text: str) -> str:
    """The text without the objects and lists whose keys say that they are no answer: `robot_3`, `error`."""
    roles, out, begin = ["around"], list[str](), 0
    for found in _NESTED.finditer(text):
        if found["open"]:
            role = roles[-1] if roles[-1] != "around" or found["key"] is None else _role(found["key"])
            if role == "other" != roles[-1]:
                out.append(text[begin : found.start()])
            roles.append(role)
        elif len(roles) > 1 and roles.pop() == "other" != roles[-1]:
            begin = found.end()
    return "".join(out) if roles[-1] == "other" else "".join([*out, text[begin:]])


def _without_tables(lines: list[str]) -> Iterator[str]:
    """The lines; below heads that are axes, a row of a table becomes `cell ...: [x=..., y=...]`."""
    heads: list[str] = []
    for line in lines:
        cells = [cell.strip("*_`$ ") for cell in line.strip().strip("|").split("|")]
        if not line.lstrip().startswith("|"):
            heads = []
        elif set(line) <= set("|-: "):
            line = ""
        elif heads:
            named = list(zip(heads, cells, strict=False))
            point = ", ".join(f"{head}={cell}" for head, cell in named if head in tuple(_AXES))
            line = f"{' '.join(cell for head, cell in named if head not in tuple(_AXES))}: [{point}]"
        elif {"x", "y"} <= {cell.lower() for cell in cells}:
            heads, line = [cell.lower() for cell in cells], ""
        yield line
