"""Any text at all is either read or refused with an AnswerError; what is read obeys the limits."""

from __future__ import annotations

import json
import math

from answer_readers import parse_path, parse_path_json, parse_plan, parse_plan_json, parse_step, parse_step_json
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.errors import AnswerError
from llm_flock.llm._answers import MAX_COORDINATE
from llm_flock.plan import DECIMALS

PIECES = [
    "Path: ", "Plan: ", "plan", "my plan: ", "my_plan", "My Plan", "Position: ", "position", "New position", "is",
    "```", "json", "[", "]", "[[", "]]", "(", ")", "{", "}", ",", ", ", ";", ":", "=", "\n", " ", "**", "*", "_", "`",
    "$", '"', "'",
    "\\boxed{", "\\text{", "\\left[", "\\right]", "\\ ", "\\,", "\\[", "\\]", "\\_", "\\n", "\\frac", "\\",
    "1", "2.5", "-3", "+.5", "1e3", "1e999", "1e", "nan", "-inf", "Infinity", "x", "y=", "\u2212", "\u2013", "\uff1a",
    "<think>", "</think>", "</thinking>", "<reasoning>", "[THINK]", "<|channel|>", "final<|message|>", "assistantfinal",
    '{"reasoning": "', "\ud800", "\u0661", "\U0001f600", "null", "true", "0", "99999999999999999999",
]  # fmt: skip

answers = st.one_of(st.text(), st.lists(st.sampled_from(PIECES), max_size=40).map("".join))
coordinate = st.floats(-MAX_COORDINATE, MAX_COORDINATE).map(lambda x: round(x, DECIMALS) + 0.0)
plans = st.integers(2, 3).flatmap(
    lambda dim: st.lists(st.lists(coordinate, min_size=dim, max_size=dim), min_size=1, max_size=6)
)
noise = st.text(alphabet=st.characters(blacklist_characters="[]()\\"), max_size=40).filter(
    lambda text: "plan" not in text.lower()
)


@given(answers, st.integers(1, 4), st.integers(2, 3))
def test_a_plan_is_read_or_refused(text: str, n: int, dim: int) -> None:
    for parse in (parse_plan, parse_plan_json):
        try:
            plan, slot = parse(text, n, dim)
        except AnswerError:
            continue
        assert len(plan) == n and 0 <= slot < n
        assert all(len(p) == dim and all(abs(x) <= MAX_COORDINATE for x in p) for p in plan.points)


@given(answers, st.integers(1, 4), st.integers(2, 3))
def test_a_path_is_read_or_refused(text: str, horizon: int, dim: int) -> None:
    for parse in (parse_path, parse_path_json):
        try:
            path = parse(text, horizon, dim)
        except AnswerError:
            continue
        assert 1 <= len(path) <= horizon
        assert all(len(p) == dim and all(math.isfinite(x) for x in p) for p in path)


@given(answers, st.integers(2, 3))
def test_a_position_is_read_or_refused(text: str, dim: int) -> None:
    for parse in (parse_step, parse_step_json):
        try:
            position = parse(text, dim)
        except AnswerError:
            continue
        assert len(position) == dim and all(math.isfinite(x) for x in position)


@given(plans, st.data(), noise, noise)
def test_answer_in_the_requested_form_is_read_back(
    points: list[list[float]], data: st.DataObject, before: str, after: str
) -> None:
    n, dim = len(points), len(points[0])
    slot = data.draw(st.integers(0, n - 1))
    expected = tuple(map(tuple, points))
    plan, index = parse_plan(f"{before}\nPlan: {points}\nmy plan: {slot}\n{after}", n, dim)
    assert (plan.points, index) == (expected, slot)
    plan, index = parse_plan_json(json.dumps({"plan": points, "my_plan": slot}), n, dim)
    assert (plan.points, index) == (expected, slot)
    assert parse_step(f"{before}\nPosition: {points[0]}\n{after}", dim) == expected[0]
    assert parse_step_json(json.dumps({"position": points[0]}), dim) == expected[0]
