"""Grammars that hold a model on board to the form of an answer, in llama.cpp's GBNF.

A grammar says how an answer is written, never what is right: whatever it lets through is read and verified like any
other answer. It is made from the number of places, of coordinates and of positions that a question asks for.
"""

from __future__ import annotations

import re
from functools import lru_cache

from llm_flock.llm.port import AnswerForm, Kind

WHOLE_DIGITS = 6
"""Most digits before the decimal point: no number is larger than `arrays.MAX_COORDINATE`."""

DECIMALS = 4
"""Most digits after it: a model that has lost its way must not write a number without end."""

REASON_LINES = 3
REASON_CHARS = 200
"""A reason has so many lines of so many characters at most."""

CHARS_PER_TOKEN = 3
"""Of prose; a digit or a bracket is a token of its own."""

_PROSE = re.compile(r"[A-Za-z\s]")


@lru_cache(maxsize=256)
def answer_grammar(kind: Kind, form: AnswerForm) -> str:
    """The grammar of an answer to one question; `root` is where it begins.

    Args:
        kind: what is asked.
        form: what the answer may look like.
    """
    number = f'"-"? [0-9]{{1,{WHOLE_DIGITS}}} ("." [0-9]{{1,{DECIMALS}}})?'
    rules = {
        "answer": _json_answer(kind, form) if form.json else _text_answer(kind, form),
        "point": f'"[" number (", " number){{{form.dim - 1}}} "]"',
        "number": number,
    }
    if kind == "plan":
        rules["index"] = " | ".join(f'"{place}"' for place in range(form.n))
    if form.reasons and not form.json:
        rules["reason"] = f'[^\\n]{{1,{REASON_CHARS}}} "\\n"'
        root = f"reason{{0,{REASON_LINES}}} answer"
    else:
        root = "answer"
    return "\n".join(f"{name} ::= {rule}" for name, rule in {"root": root, **rules}.items()) + "\n"


def longest_answer(kind: Kind, form: AnswerForm) -> int:
    """Tokens that the longest answer of a grammar takes at most."""
    points = form.n if kind == "plan" else form.horizon
    number = 1 + WHOLE_DIGITS + 1 + DECIMALS + len(", ")
    reason = REASON_LINES * REASON_CHARS // CHARS_PER_TOKEN if form.reasons and not form.json else 0
    return points * (form.dim * number + len("[], ")) + reason + 40


def tokens_of(text: str) -> int:
    """Tokens that a text takes, about, and rather too many."""
    prose = len(_PROSE.findall(text))
    return len(text) - prose + prose // CHARS_PER_TOKEN


def _text_answer(kind: Kind, form: AnswerForm) -> str:
    """The paper's lines (118, 391 and 110), and our own for a path."""
    if kind == "plan":
        return f'"Plan: [" point (", " point){{{form.n - 1}}} "]\\nmy plan: " index'
    if form.horizon == 1:
        return '"Position: " point'
    return f'"Path: [" point (", " point){{0,{form.horizon - 1}}} "]"'


def _json_answer(kind: Kind, form: AnswerForm) -> str:
    if kind == "plan":
        return f'"{{\\"plan\\": [" point (", " point){{{form.n - 1}}} "], \\"my_plan\\": " index "}}"'
    if form.horizon == 1:
        return '"{\\"position\\": " point "}"'
    return f'"{{\\"path\\": [" point (", " point){{0,{form.horizon - 1}}} "]}}"'
