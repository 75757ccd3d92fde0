"""The form of an answer for models that can be constrained to it: a JSON schema, or a grammar in llama.cpp's GBNF.

Both fix how an answer is written, not its content: every answer is read and verified. They depend on the number of
places, coordinates and positions that a question asks for.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any, get_args

from llm_flock.bounds import MAX_PROGRAM_BYTES
from llm_flock.formation._program import SPACE, Flat
from llm_flock.llm._port import AnswerForm, Kind

WHOLE_DIGITS = 6  # most digits before the decimal point: no number is larger than `arrays.MAX_COORDINATE`
DECIMALS = 4  # most digits after the decimal point: a confused model must not write a number without end

LETTER_TOKENS = 4
"""Longest answer of one letter [tokens]: some room, to notice a model that does not stop after the letter."""

REASONING = "reasoning"
"""First field of a JSON answer: a model that must begin with the object still needs room to think."""

REASON_LINES = 3
REASON_CHARS = 200
"""Longest reason: lines, and characters of each line. In JSON, a reason is one line."""

CHARS_PER_TOKEN = 3  # only of prose: each digit and bracket is one token

_PROGRAM = r"""drawing ::= "{" ("\"name\": " text ", ")? (draw size? | "\"groups\": [" group (", " group)* "]") "}"
draw ::= "\"draw\": [" element (", " element)* "]"
group ::= "{\"role\": " text (", \"count\": " count)? (", \"share\": " number)? at? size? ", " draw "}"
at ::= ", \"at\": " vector
size ::= ", \"size\": " number
element ::= "{" figure closed? fill? sides? arc? turns? scale? mirror? turn? north? tilt? move? repeat? "}"
figure ::= shape | "\"text\": " text | path | "\"points\": [" vector (", " vector)* "]" | union
shape ::= "\"shape\": \"" (SHAPES) "\""
path ::= "\"path\": " line
line ::= "\"" [MLHVCSQTAZmlhvcsqtaz0-9 .,eE+-]+ "\""
union ::= "\"union\": [" element (", " element)* "]"
closed ::= ", \"closed\": true"
fill ::= ", \"fill\": true"
sides ::= ", \"sides\": " count
arc ::= ", \"arc\": [" number ", " number "]"
turns ::= ", \"turns\": " number
scale ::= ", \"scale\": " (number | vector)
mirror ::= ", \"mirror\": \"" [xyz] "\""
turn ::= ", \"turn\": " number
north ::= ", \"point\": \"" ("north" | "east" | "south" | "west") "\""
tilt ::= ", \"tilt\": " number
move ::= ", \"move\": " vector
repeat ::= ", \"repeat\": {\"times\": " count move? turn? (", \"scale\": " number)? "}"
vector ::= "[" number (", " number){1,2} "]"
count ::= [1-9] [0-9]{0,2}
text ::= "\"" [^"\\\x00-\x1F]{0,40} "\""
edit ::= "{" (change (", " change){0,7} | "\"refuse\": " text) "}"
change ::= "\"/" [a-z0-9/-]{1,40} "\": " value
value ::= "null" | "true" | number | text | line | "[" value (", " value)* "]" | "{" member (", " member)* "}"
member ::= text ": " value
""".replace("SHAPES", " | ".join(f'"{name}"' for name in (*get_args(Flat), *SPACE)))
"""A formation program in JSON, its fields in the order of the schema; no more is fixed than what is written how."""

_PROSE = re.compile(r"[A-Za-z\s]")


def answer_schema(kind: Kind, form: AnswerForm) -> dict[str, Any]:
    """JSON schema of an answer in this form, for providers that accept one."""
    point = {"type": "array", "items": {"type": "number"}, "minItems": form.dim, "maxItems": form.dim}
    # Strict providers write the fields in this order, and want each one to be required.
    properties: dict[str, Any] = {}
    if form.reasons:
        properties[REASONING] = {"type": "string", "description": "Your reason, in a sentence or two"}
    if kind == "plan":
        properties["plan"] = {"type": "array", "items": point, "minItems": form.n, "maxItems": form.n}
        properties["my_plan"] = {"type": "integer", "minimum": 0, "maximum": form.n - 1}
    elif kind == "judgement":
        properties["choice"] = {"type": "string", "enum": list(form.choices)}
    elif form.horizon == 1:
        properties["position"] = point
    else:
        properties["path"] = {"type": "array", "items": point, "minItems": 1, "maxItems": form.horizon}
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}


def answer_lead(kind: Kind, form: AnswerForm) -> str:
    """How every answer in this form begins, whole tokens of it: a model on board need not write that."""
    if form.letters or form.reasons or form.edit:
        return ""
    if form.program:
        return '{"program":'
    lead = {"plan": "Plan:", "judgement": "Choice:"}.get(kind, "Position:" if form.horizon == 1 else "Path:")
    return "" if form.json else lead


@lru_cache(maxsize=256)
def answer_grammar(kind: Kind, form: AnswerForm, lead: str = "") -> str:
    """The grammar of an answer in this form, of what follows its `lead`; it begins at `root`."""
    if form.letters:
        return "root ::= " + " | ".join(f'"{letter}"' for letter in form.letters) + "\n"
    rules = {
        "root": "answer" if form.json or not form.reasons else f"reason{{0,{REASON_LINES}}} answer",
        "answer": _answer(kind, form),
        "point": f'"[" number (", " number){{{form.dim - 1}}} "]"',
        "number": f'"-"? [0-9]{{1,{WHOLE_DIGITS}}} ("." [0-9]{{1,{DECIMALS + 2 * form.edit}}})?',
    }
    if form.program:
        reason = '" reason? "' * form.reasons
        whole = f'"{{{reason}\\"program\\": " drawing ", \\"my_plan\\": " index "}}"'
        rules["root"] = "edit" if form.edit else whole
    if kind == "plan":
        rules["index"] = " | ".join(f'"{place}"' for place in range(form.n))
    if form.reasons and (form.json or form.program):
        rules["reason"] = f'"\\"{REASONING}\\": \\"" [^"\\\\\\x00-\\x1F]{{0,{REASON_CHARS}}} "\\", "'
    elif form.reasons:
        rules["reason"] = f'[^\\n]{{1,{REASON_CHARS}}} "\\n"'
    grammar = "\n".join(f"{name} ::= {rule}" for name, rule in rules.items()) + "\n" + _PROGRAM * form.program
    return grammar.replace('"' + lead.replace('"', '\\"'), '"', 1)


def longest_answer(kind: Kind, form: AnswerForm) -> int:
    """Upper bound of the length of an answer in this form [tokens]."""
    if form.letters:
        return LETTER_TOKENS
    if form.program:
        return MAX_PROGRAM_BYTES + REASON_LINES * REASON_CHARS // CHARS_PER_TOKEN + 40
    if form.choices:
        return REASON_LINES * REASON_CHARS // CHARS_PER_TOKEN + 40
    points = form.n if kind == "plan" else form.horizon
    number = 1 + WHOLE_DIGITS + 1 + DECIMALS + len(", ")
    reason = REASON_LINES * REASON_CHARS // CHARS_PER_TOKEN if form.reasons else 0
    return points * (form.dim * number + len("[], ")) + reason + 40


def tokens_of(text: str) -> int:
    """Length of a text, estimated from above [tokens]."""
    prose = len(_PROSE.findall(text))
    return len(text) - prose + prose // CHARS_PER_TOKEN


def _answer(kind: Kind, form: AnswerForm) -> str:
    """The paper's lines (118, 391 and 110) and our own for a path, or the fields of a JSON object."""
    if kind == "judgement":
        name = "(" + " | ".join(f'"{choice}"' for choice in form.choices) + ")"
        return f'"{{" reason "\\"choice\\": \\"" {name} "\\"}}"' if form.json else f'"Choice: " {name}'
    places = f'point (", " point){{{form.n - 1}}}'
    path = f'point (", " point){{0,{form.horizon - 1}}}'
    if not form.json:
        if kind == "plan":
            return f'"Plan: [" {places} "]\\nmy plan: " index'
        return '"Position: " point' if form.horizon == 1 else f'"Path: [" {path} "]"'
    begin = '"{" reason ' if form.reasons else '"{" '
    if kind == "plan":
        return begin + f'"\\"plan\\": [" {places} "], \\"my_plan\\": " index "}}"'
    return begin + ('"\\"position\\": " point "}"' if form.horizon == 1 else f'"\\"path\\": [" {path} "]}}"')
