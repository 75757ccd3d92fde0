"""Reading answers in any wrapping, and the reasons for which they are rejected."""

from __future__ import annotations

import json
import re
import time

import pytest
from answer_readers import parse_path, parse_path_json, parse_plan, parse_plan_json, parse_step, parse_step_json

from llm_flock.arrays import Point
from llm_flock.errors import AnswerError
from llm_flock.llm._answer_forms import answer_schema
from llm_flock.llm._port import AnswerForm
from llm_flock.llm._thoughts import MAX_CHARS
from llm_flock.plan import Plan

POINTS = [[55.77, 50.0], [47.11, 55.0], [47.11, 45.0]]
PLAN = "[[55.77, 50], [47.11, 55], [47.11, 45]]"


@pytest.mark.parametrize(
    "text",
    [
        "Position: [18.05, 67.91]",
        "position : [18.05 67.91]",
        "**Position:** `[18.05, 67.91]`",
        "**Position**: $[18.05, 67.91]$",
        "**Position: [18.05, 67.91]**",
        "_Position_: [18.05, 67.91]",
        "### Position: [18.05, 67.91] ###",
        "> Position: [18.05, 67.91]",
        "1. Position: [18.05, 67.91]",
        "- Position: [ 1.805e1 , +67.91, ]",
        "Position: (18.05, 67.91)",
        "Position: [[18.05, 67.91]]",
        "Position: [x = 18.05, y = 67.91]",
        "Position → [18.05; 67.91].",
        "Position：［18.05，67.91］",
        "So my next position is [18.05, 67.91].",
        "Therefore, **Position: [18.05, 67.91]**",
        r"\[ \boxed{\text{Position: } [18.05,\ 67.91]} \]",
        r"$$\boxed{\text{Position: } \left[18.05,\; 67.91\right]}$$",
        r"\boxed{\left[18.05, 67.91\right]}",
        r"\textbf{Position:} \texttt{[18.05,\, 67.91]}",
        "Position:\n\\[18.05, 67.91\\]",
        r"Straight on.\nPosition: [18.05, 67.91]",
        '{"position": [18.05, 67.91]}',
        "```json\n[18.05, 67.91]\n```",
        "[18.05, 67.91]",
        "Position: [1, 2]\nNo, better:\nPosition: [18.05, 67.91]",
        "Position: [18.05, 67.91]\nPosition: [x, y]",
        "Your position: [1, 2]. Goal position: [3, 4].\nNew Position = [12 + 6, 70 - 2]\nPosition: [18.05, 67.91]",
        "Position: [18.05, 67.91]\n(Current position: [1, 2])",
    ],
)
def test_position_is_found_in_any_wrapping(text: str) -> None:
    assert parse_step(text, 2) == (18.05, 67.91)


def test_signs_and_dimensions() -> None:
    assert parse_step("Position: [\u221218.05, \u201367.91, -.5]", 3) == (-18.05, -67.91, -0.5)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "no complete position"),
        ("I wait.", "no complete position"),
        ("Position: [x, y]", "no complete position"),
        ("Position: [18.05, 67.91", "no complete position"),
        ("Position: [18.05, 67.91]\nPosition: [18.0", "two different positions"),
        ("Position: [12.63 + 5.42, 67.91]", "no complete position"),
        (r"Position: [\sqrt{3}, 67.91]", "no complete position"),
        ("Position: [5*3]", "no complete position"),
        ("Position: [1.2.3, 4]", "no complete position"),
        ("Your position: [1, 2]", "no complete position"),
        ("The **goal** position: [1, 2]", "no complete position"),
        ("I start from position [1, 2]", "no complete position"),
        ("Position: [1, 2, 3]", "the position has 3 numbers, 2 are required"),
        ("Position: [1]", "the position has 1 number, 2 are required"),
        ("Position: [NaN, 2]", "the position holds nan"),
        ("Position: [1, -inf]", "the position holds -inf"),
        ("Position: [1, 1e400]", "the position holds inf"),
        ("Position: [1, 1000001]", "the position holds 1e+06; coordinates are 1e+06 at most"),
        ("Position: [1, 2]\nPosition: [1, 2, 3]", "the position has 3 numbers"),
        (f"Position: [{'1' * 41}, 2]", "a number of 41 characters, 40 are the limit"),
        ("x" * (MAX_CHARS + 1), f"{MAX_CHARS + 1} characters long"),
    ],
)
def test_a_position_that_will_not_do(text: str, reason: str) -> None:
    with pytest.raises(AnswerError) as caught:
        parse_step(text, 2)
    assert reason in str(caught.value)
    with pytest.raises(AnswerError, match=re.escape(reason)):
        parse_step_json(text, 2)


@pytest.mark.parametrize(
    "text",
    [
        f"Plan: {PLAN}\nmy plan: 1",
        f"\\texttt{{Plan: {PLAN}}} \\\\\n\\texttt{{my\\_plan: 1}}",
        f"**Plan:**\n```json\n{PLAN}\n```\n**my_plan:** 1.",
        f"My Plan: {PLAN}\nMy Plan: 1",
        f'{{"plan": {PLAN}, "my_plan": 1}}',
        "Plan: [(55.77, 50), (47.11, 55), (47.11, 45)]\nmy plan: [1]",
        "Plan: [\n  [55.77, 50],\n  [47.11, 55],\n  [47.11, 45],\n]\n\n`my plan: 1` (the north)",
        "Final Plan: [[55.77 50] [47.11 55] [47.11 45]]\nmy plan index is 1",
        f"Plan: [[1, 2]]\nPlan: {PLAN}\nmy plan: 0\nOn reflection, my plan: 1",
        f"\\[\\boxed{{\\text{{Plan: }} {PLAN}}}\\]\\nmy plan: 1",
        f"The places are {PLAN}.\nmy-plan = 1.0",
    ],
)
def test_plan_is_found_in_any_wrapping(text: str) -> None:
    assert parse_plan(text, 3, 2) == (Plan.of(POINTS), 1)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("my plan: 1", "no complete plan; a line `Plan: [[...], ...]` with 3 points of 2 numbers"),
        ("Plan: [[x, y], [x, y], ...]\nmy plan: a", "no complete plan"),
        ("Plan: [[1, 2], [3, 4], [5,", "no complete plan"),
        ("Plan: []\nmy plan: 1", "no complete plan"),
        (f"Plan: {PLAN}\nPlan: [[1, 2], [3,\nmy plan: 1", "no complete plan"),
        ("Plan: [[1, 2]]\nmy plan: 0", "the plan holds 1 point, 3 are required"),
        ("Plan: [[1, 2], [3, 4], [5, 6], [7, 8]]\nmy plan: 0", "the plan holds 4 points, 3 are required"),
        ("Plan: [[1, 2], [3, 4], [5]]\nmy plan: 0", "point 2 of the plan has 1 number, 2 are required"),
        ("Plan: [[1, 2], [3, NaN], [5, 6]]\nmy plan: 0", "point 1 of the plan holds nan"),
        ("Plan: [[1, 2], [3, 4], [-2e6, 6]]\nmy plan: 0", "point 2 of the plan holds -2e+06"),
        (f"Plan: {PLAN}", "it does not say which place is yours"),
        (f"The goals of the robots are {PLAN}.\nmy plan: 1", "no complete plan"),
        (f"Plan: {PLAN}\nmy plan: a", "it does not say which place is yours"),
        (f"Plan: {PLAN}\nmy plan: [47.11, 55]", "it does not say which place is yours"),
        (f"Plan: {PLAN}\nmy plan: 3", "my plan is 3; a whole number from 0 to 2 is required"),
        (f"Plan: {PLAN}\nmy plan: -1", "my plan is -1"),
        (f"Plan: {PLAN}\nmy plan: 1.5", "my plan is 1.5"),
        (f"Plan: {PLAN}\nmy plan: nan", "my plan is nan"),
    ],
)
def test_a_plan_that_will_not_do(text: str, reason: str) -> None:
    with pytest.raises(AnswerError) as caught:
        parse_plan(text, 3, 2)
    assert reason in str(caught.value)


def test_json_answers_bare_fenced_and_among_words() -> None:
    plan = json.dumps({"plan": POINTS, "my_plan": 2})
    for text in (plan, f"```json\n{plan}\n```", f"Here it is:\n{plan}\nGood luck!"):
        assert parse_plan_json(text, 3, 2) == (Plan.of(POINTS), 2)
    assert parse_step_json('{"position": [1, 2.5]}', 2) == (1.0, 2.5)


def test_model_asked_for_json_may_answer_as_text() -> None:
    assert parse_plan_json(f"Plan: {PLAN}\nmy plan: 1", 3, 2) == (Plan.of(POINTS), 1)
    assert parse_step_json("Position: [1, 2]", 2) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ({"my_plan": 0}, "no complete plan; a line `Plan: [[...], ...]` with 3 points"),
        ({"plan": POINTS}, "it does not say which place is yours"),
        ({"plan": "here", "my_plan": 0}, "no complete plan"),
        ({"plan": POINTS[:2], "my_plan": 0}, "the plan holds 2 points, 3 are required"),
        ({"plan": [*POINTS[:2], "c"], "my_plan": 0}, "the plan holds 2 points, 3 are required"),
        ({"plan": [*POINTS[:2], ["1", "b2"]], "my_plan": 0}, "it holds words"),
        ({"plan": [*POINTS[:2], [True, 2]], "my_plan": 0}, "it holds words"),
        ({"plan": [*POINTS[:2], [float("inf"), 2]], "my_plan": 0}, "point 2 of the plan holds inf"),
        ({"plan": [*POINTS[:2], [10**400, 2]], "my_plan": 0}, "point 2 of the plan holds a number of 401 characters"),
        ({"plan": POINTS, "my_plan": 3}, "my plan is 3"),
        ({"plan": POINTS, "my_plan": 0.5}, "my plan is 0.5"),
        ({"plan": POINTS, "my_plan": "zero"}, "it does not say which place is yours"),
        ({"corners": POINTS, "my_plan": 0}, "no complete plan"),
    ],
)
def test_json_that_will_not_do(value: dict[str, object], reason: str) -> None:
    with pytest.raises(AnswerError) as caught:
        parse_plan_json(json.dumps(value), 3, 2)
    assert reason in str(caught.value)


def test_schemas_fix_every_length() -> None:
    plan = answer_schema("plan", AnswerForm(n=3, dim=2))["properties"]
    assert (plan["plan"]["minItems"], plan["plan"]["maxItems"]) == (3, 3)
    assert plan["my_plan"] == {"type": "integer", "minimum": 0, "maximum": 2}
    position = answer_schema("step", AnswerForm(n=3, dim=3))["properties"]["position"]
    assert (position["minItems"], position["maxItems"]) == (3, 3)
    path = answer_schema("step", AnswerForm(n=3, dim=2, horizon=4))
    assert path["properties"]["path"]["maxItems"] == 4
    for schema in (path, answer_schema("plan", AnswerForm(n=3, dim=2)), answer_schema("step", AnswerForm(n=3, dim=2))):
        assert schema["required"] == list(schema["properties"]) and schema["additionalProperties"] is False


HOSTILE = [
    "[",
    "[[",
    "[1,",
    "[1 ",
    "[[1,1],",
    "[1,1]",
    "[x=",
    "[1e",
    "[1" + " " * 1000,
    "plan",
    "plan: [[",
    "Plan: [[1,1],",
    "my plan: ",
    "my plan index ",
    "my_",
    "position ",
    "position: [",
    "position" + " " * 50 + "\n",
    "position is ",
    "new ",
    "final" + " " * 100,
    "*",
    "\\",
    "\\[",
    "\\n",
    "\\text",
    "\\boxed{",
    "\u2212",
    "{",
    '{"a":',
    '{"position":[',
    "1",
    "\U0001f600",
]


def all_readings_s(text: str) -> float:
    """Time for all six ways of reading a text that holds no answer [s]."""
    began = time.process_time()
    for read in (parse_plan, parse_plan_json):
        with pytest.raises(AnswerError) as caught:
            read(text, 3, 2)
        assert len(str(caught.value)) < 300
    for read in (parse_step, parse_step_json):
        with pytest.raises(AnswerError, match=r"no complete position|a number of|too long"):
            read(text, 2)
    for read in (parse_path, parse_path_json):
        with pytest.raises(AnswerError, match=r"no complete pa|a number of|too long|1 to 20"):
            read(text, 20, 2)
    return time.process_time() - began


@pytest.mark.slow
@pytest.mark.parametrize("unit", HOSTILE, ids=lambda unit: ascii(unit[:12]))
def test_hostile_answers_are_refused_in_linear_time(unit: str) -> None:
    count = MAX_CHARS // 100 // len(unit)
    # A hundredth of a megabyte takes up to 0.2 s; anything quadratic would take a second or more.
    assert all_readings_s(unit * count) < 0.8
    assert all_readings_s("Position: [1, Plan: [[1, my plan: " + unit * count) < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["position: [", "\U0001f600"], ids=ascii)
def test_a_hostile_megabyte_would_take_a_second_a_reading(unit: str) -> None:
    count = MAX_CHARS // 4 // len(unit)
    # Of a quarter, beside a fortieth: ten times as long if linear, on any machine; a hundred times if quadratic.
    assert all_readings_s(unit * count) < max(1.5, 20 * all_readings_s(unit * (count // 10)))


def test_the_last_of_a_thousand_candidates_wins() -> None:
    text = "Position: [1,1]. Wait. " * 2000 + "Position: [2,2]"
    assert parse_step(text, 2) == (2.0, 2.0)
    with pytest.raises(AnswerError, match="two different positions"):
        parse_step(text.replace("Wait.", ""), 2)


@pytest.mark.parametrize(("count", "reason"), [(2000, "two different positions"), (40_000, "too long")])
def test_objects_that_differ_are_refused_at_once(count: int, reason: str) -> None:
    text = "".join(f'{{"position": [1, {k}]}} ' for k in range(count))
    began = time.process_time()
    with pytest.raises(AnswerError, match=reason):
        parse_step_json(text, 2)
    assert time.process_time() - began < 3.0


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("Path: [[1, 2], [3, 4]]", ((1, 2), (3, 4))),
        ("I go round it.\n**Path:** [(1, 2), (3.5, 4)].", ((1, 2), (3.5, 4))),
        ("Path: [[9, 9], [8, 8]]\nNo, better: Path: [[1, 2]]", ((1, 2),)),
        ("The plan is [[7, 7], [8, 8]].\nPosition: [1, 2]", ((1, 2),)),
        ("[[1, 2], [3, 4]]", ((1, 2), (3, 4))),
        ("[1, 2]", ((1, 2),)),
        ('```json\n{"path": [[1, 2], [3, 4]]}\n```', ((1, 2), (3, 4))),
        ('{"position": [1, 2]}', ((1, 2),)),
    ],
)
def test_a_path_is_read_from_words_and_from_json(text: str, path: tuple[Point, ...]) -> None:
    assert parse_path_json(text, 4, 2) == path
    if "position" not in text:
        assert parse_path(text, 4, 2) == path


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("I stay.", "no complete path; a line `Path: [[...], ...]` with 1 to 2 positions of 2 numbers"),
        ("Path: [[1, 2], [3, 4], [5, 6]]", "the path holds 3 positions, 1 to 2 are required"),
        ("Path: [[1, 2], [3, 4, 5]]", "position 2 of the path has 3 numbers"),
        ("Path: [[1, nan]]", "position 1 of the path holds nan"),
        ('{"path": []}', "no complete path: it is empty"),
        ('{"path": 3}', "no complete path"),
        ('{"path": [3]}', "position 1 of the path has 1 number"),
        ('{"way": [[1, 2]]}', "no complete path"),
    ],
)
def test_a_path_that_cannot_be_used_says_why(text: str, reason: str) -> None:
    with pytest.raises(AnswerError, match=re.escape(reason)):
        parse_path_json(text, 2, 2)


@pytest.mark.parametrize(
    "text",
    [
        '{"neighbors": [{"id": 3, "position": [1, 2]}]}',
        '{"robot_3": {"position": [1, 2]',
        '{"error": {"position": [1, 2], "message": "not reachable"}}',
        r'{"reasoning": "{\"position\": [1, 2]} is too slow"}',
        "Position: [1, 2] x 10^1",
        "Position != [1, 2]",
        "Position: [[[1, 2]], [[3, 4]]]",
        "Position: [1, 2] is out of reach this round.",
    ],
)
def test_what_is_no_position_of_the_robot_is_refused(text: str) -> None:
    with pytest.raises(AnswerError, match="no complete position"):
        parse_step(text, 2)


def test_what_stands_around_an_answer_is_read_with_it() -> None:
    assert parse_step(r'{"result": "{\"position\": [1, 2]}", "goal": [3, 4]}', 2) == (1, 2)
    assert parse_step("Position: [1, 2]\nOn the way I keep my distance.", 2) == (1, 2)
    assert parse_step("Position: [1, 2]\nRobots:\n[3, 4]\n[5, 6]\nfar - [7, 8]", 2) == (1, 2)


@pytest.mark.parametrize("place", ["my plan: 1, i.e. [55.77, 50]", "I take [55.77, 50].\nmy plan: 1"])
def test_a_place_named_by_a_number_and_by_another_point(place: str) -> None:
    with pytest.raises(AnswerError, match=r"is not|two different places"):
        parse_plan(f"Plan: {PLAN}\n{place}", 3, 2)
