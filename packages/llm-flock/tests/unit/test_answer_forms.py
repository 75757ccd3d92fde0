"""Grammars of answers, translated to regular expressions; a union in a union ends the recursion."""

import json
import re
from dataclasses import replace
from typing import get_args

import pytest
from answer_readers import parse_path_json, parse_plan, parse_plan_json, parse_step_json

from llm_flock.arrays import MAX_COORDINATE
from llm_flock.formation import parse_program
from llm_flock.formation._program import SPACE, Element, Flat, Group, Program, Repeat
from llm_flock.llm._answer_forms import (
    REASON_CHARS,
    REASON_LINES,
    answer_grammar,
    answer_lead,
    answer_schema,
    longest_answer,
    tokens_of,
)
from llm_flock.llm._port import AnswerForm

_TOKEN = re.compile(r'"(?P<literal>(?:[^"\\]|\\.)*)"|(?P<set>\[(?:[^\]\\]|\\.)*\])|(?P<name>[a-z]+)|(?P<rest>\S|\s)')


def regex(grammar: str) -> str:
    """The language of a grammar as one regular expression."""
    rules = dict(line.split(" ::= ", 1) for line in grammar.splitlines())

    def expand(rule: str, unions: int = 0) -> str:
        out = "" if unions < 4 else "(?!)"
        for token in _TOKEN.finditer(rule):
            if token["literal"] is not None:
                text = token["literal"].replace("\\n", "\n").replace('\\"', '"')
                out += f"(?:{re.escape(text)})"
            elif token["set"] is not None:
                out += token["set"]
            elif token["name"] is not None:
                deeper = unions + (token["name"] in ("union", "value"))
                out += f"(?:{expand(rules[token['name']], deeper)})" if unions < 4 else ""
            else:
                out += token["rest"].strip()
        return out

    return expand(rules["root"])


def accepts(kind, form: AnswerForm, text: str) -> bool:
    return re.fullmatch(regex(answer_grammar(kind, form)), text) is not None


PROGRAMS = (
    {"draw": [{"shape": "square", "turn": 45}]},
    {"draw": [{"points": [[0, 0], [2, 3.25], [-1, 4]], "closed": True}, {"text": "HI", "scale": [2, 1]}], "size": 40},
    {"draw": [{"union": [{"shape": "grid"}, {"path": "M0,0 L4,4"}], "mirror": "x", "tilt": 90, "move": [1, 2, 3]}]},
    {"draw": [{"shape": "circle", "arc": [0, 90], "repeat": {"times": 4, "move": [3, 0], "turn": 90, "scale": 0.5}}]},
    {"name": "two", "groups": [{"role": "a", "count": 3, "at": [5, 5], "draw": [{"shape": "polygon", "sides": 7}]}]},
    {"draw": [{"shape": "square", "fill": True}, {"shape": "helix", "turns": 3}, {"shape": "wedge", "point": "east"}]},
)


@pytest.mark.parametrize("program", PROGRAMS)
def test_programs_are_held_to_their_form(program) -> None:
    form = AnswerForm(n=12, dim=2, program=True, reasons=False)
    said = parse_program(program).spoken
    whole = f'{{"program": {said}, "my_plan": 11}}'
    assert json.loads(said) == program
    assert accepts("plan", form, whole)
    for wrong in (whole.replace("11", "12"), said, whole[:-1] + "}}", whole.replace('"draw"', '"paint"')):
        assert not accepts("plan", form, wrong)


def test_edits_are_changes_by_path_or_a_refusal() -> None:
    form = AnswerForm(n=12, dim=2, program=True, edit=True)
    changed = '{"/draw/0/scale": [1.5, 2], "/draw/-": {"shape": "star", "move": [0, 3]}, "/size": null}'
    assert accepts("plan", form, changed) and accepts("plan", form, '{"refuse": "It cannot be drawn."}')
    endless = "{" + ", ".join(['"/size": 1'] * 9) + "}"
    for wrong in (
        endless,
        '{"draw": [{"shape": "line"}]}',
        "{}",
        '{"/size": }',
        changed + "}",
        '{"/size": 1, "refuse": "No."}',
    ):
        assert not accepts("plan", form, wrong)


AS_TEXT = AnswerForm(n=2, dim=2, reasons=False)


@pytest.mark.parametrize(("kind", "form", "text"), [
    ("step", AS_TEXT, "Position: [-0.5, 1]"),
    ("step", AnswerForm(n=3, dim=2, reasons=False, horizon=4), "Path: [[0, 1], [2, 3.5]]"),
    ("plan", AnswerForm(n=2, dim=2, reasons=False), "Plan: [[1, 2.5], [-3.25, 4]]\nmy plan: 1"),
    ("judgement", AnswerForm(n=3, dim=2, reasons=False, choices=("leave", "close")), "Choice: close"),
    ("plan", replace(AS_TEXT, program=True), '{"program": {"draw": [{"shape": "line"}]}, "my_plan": 1}'),
    ("step", AnswerForm(n=3, dim=2, reasons=False, letters="SL"), "L"),
    ("step", AnswerForm(n=3, dim=2, reasons=False, json=True), '{"position": [1, 2]}'),
    ("plan", AnswerForm(n=2, dim=2, program=True, edit=True), '{"refuse": "No."}'),
])  # fmt: skip
def test_what_every_answer_begins_with_need_not_be_written(kind, form: AnswerForm, text: str) -> None:
    lead = answer_lead(kind, form)
    assert accepts(kind, form, text) and text.startswith(lead)
    after = regex(answer_grammar(kind, form, lead))
    assert re.fullmatch(after, text.removeprefix(lead)) and not (lead and re.fullmatch(after, text))


def test_an_element_draws_one_thing_and_every_field_can_be_said() -> None:
    form = AnswerForm(n=4, dim=2, program=True, reasons=False)
    for wrong in (
        '{"turn": 45}',
        '{"shape": "blob"}',
        '{"points": []}',
        '{"shape": "line", "text": "A"}',
        '{"points": [1]}',
    ):
        assert not accepts("plan", form, f'{{"program": {{"draw": [{wrong}]}}, "my_plan": 0}}')
    grammar = answer_grammar("plan", form)
    for table in (Element, Repeat, Group, Program):
        assert not [name for name in table.model_fields if f'\\"{name}\\"' not in grammar]
    assert not [name for name in (*get_args(Flat), *SPACE) if f'"{name}"' not in grammar]


PLAN = "Plan: [[1, 2.5], [-3.25, 4], [0.1234, 999999]]\nmy plan: 2"


def test_a_plan_has_as_many_places_as_are_asked_for():
    three = AnswerForm(n=3, dim=2)
    assert accepts("plan", three, PLAN)
    assert parse_plan(PLAN, 3, 2)[1] == 2
    assert not accepts("plan", AnswerForm(n=4, dim=2), PLAN)
    assert not accepts("plan", AnswerForm(n=3, dim=3), PLAN)
    assert not accepts("plan", three, PLAN.replace("plan: 2", "plan: 3"))
    assert not accepts("plan", three, PLAN + "\n")


def test_a_reason_goes_before_the_answer_and_is_bounded():
    form = AnswerForm(n=3, dim=2)
    assert accepts("plan", form, "A triangle.\nWith equal sides.\n" + PLAN)
    assert not accepts("plan", form, "again\n" * (REASON_LINES + 1) + PLAN)
    assert not accepts("plan", form, "x" * 5000 + "\n" + PLAN)
    assert not accepts("plan", form, "A triangle. " + PLAN.replace("\n", " "))
    without = AnswerForm(n=3, dim=2, reasons=False)
    assert accepts("plan", without, PLAN)
    assert not accepts("plan", without, "A triangle.\n" + PLAN)


def test_step_is_one_position_and_path_at_most_the_horizon():
    assert accepts("step", AnswerForm(n=3, dim=2), "Position: [1.5, -2]")
    assert accepts("step", AnswerForm(n=3, dim=3), "Position: [1.5, -2, 0]")
    assert not accepts("step", AnswerForm(n=3, dim=2), "Position: [1.5, -2, 0]")
    path = AnswerForm(n=3, dim=2, horizon=3)
    assert accepts("step", path, "Path: [[1, 2]]")
    assert accepts("step", path, "Path: [[1, 2], [3, 4], [5, 6]]")
    assert not accepts("step", path, "Path: [[1, 2], [3, 4], [5, 6], [7, 8]]")
    assert not accepts("step", path, "Path: []")


@pytest.mark.parametrize(
    ("kind", "form", "text", "reader"),
    [
        (
            "plan",
            AnswerForm(n=2, dim=2, json=True, reasons=False),
            '{"plan": [[1, 2], [3, 4]], "my_plan": 1}',
            lambda text: parse_plan_json(text, 2, 2),
        ),
        (
            "step",
            AnswerForm(n=2, dim=2, json=True, reasons=False),
            '{"position": [1, 2]}',
            lambda t: parse_step_json(t, 2),
        ),
        (
            "step",
            AnswerForm(n=2, dim=3, horizon=2, json=True, reasons=False),
            '{"path": [[1, 2, 3], [4, 5, 6]]}',
            lambda text: parse_path_json(text, 2, 3),
        ),
    ],
)
def test_json_answers_are_json_and_nothing_else(kind, form, text, reader):
    assert accepts(kind, form, text)
    assert reader(text)
    assert not accepts(kind, form, "Because of this:\n" + text)
    assert list(answer_schema(kind, form)["properties"]) == list(json.loads(text))
    reasoned = '{"reasoning": "A straight [way], of Position: [9, 9].", ' + text[1:]
    assert not accepts(kind, form, reasoned)
    with_reasons = replace(form, reasons=True)
    assert accepts(kind, with_reasons, reasoned) and not accepts(kind, with_reasons, text)
    assert reader(reasoned) == reader(text)
    schema = answer_schema(kind, with_reasons)
    assert list(schema["properties"]) == schema["required"] == list(json.loads(reasoned))
    for bad in ('a " quote', "a \\ stroke", "two\nlines", "x" * (REASON_CHARS + 1)):
        assert not accepts(kind, with_reasons, '{"reasoning": "' + bad + '", ' + text[1:])


def test_numbers_end_and_none_is_too_large():
    form = AnswerForm(n=1, dim=2)
    assert accepts("step", form, f"Position: [{MAX_COORDINATE - 1:.0f}, -{MAX_COORDINATE - 1:.0f}]")
    assert not accepts("step", form, f"Position: [{10 * MAX_COORDINATE:.0f}, 2]")
    assert not accepts("step", form, "Position: [1.00000000000, 2]")
    assert not accepts("step", form, "Position: [1e3, 2]")
    assert not accepts("step", form, "Position: [nan, 2]")


@pytest.mark.parametrize("reasons", [True, False])
@pytest.mark.parametrize("as_json", [True, False])
def test_the_longest_answer_is_long_enough(as_json, reasons):
    form = AnswerForm(n=7, dim=3, horizon=4, json=as_json, reasons=reasons)
    begin = '{"reasoning": "' + "1" * REASON_CHARS + '", ' if reasons else "{"
    point = "[" + ", ".join(["-123456.1234"] * 3) + "]"
    points = f"[{', '.join([point] * 7)}]"
    plan = f'{begin}"plan": {points}, "my_plan": 6}}' if as_json else f"Plan: {points}\nmy plan: 6"
    assert accepts("plan", form, plan)
    assert longest_answer("plan", form) >= tokens_of(plan)
    path = f"[{', '.join([point] * 4)}]"
    assert longest_answer("step", form) >= tokens_of(f'{begin}"path": {path}}}' if as_json else f"Path: {path}")


def test_digits_are_tokens_and_letters_are_parts_of_them():
    assert tokens_of("abc def") == 2
    assert tokens_of("[1.25]") == 6
