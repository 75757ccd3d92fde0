"""The time of reading is linear in the length of an answer: counted in looks at an item, not in seconds."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

import pytest
from answer_readers import parse_path, parse_plan, parse_step
from hypothesis import example, given, settings
from hypothesis import strategies as st

from llm_flock.errors import AnswerError
from llm_flock.llm._answer_claims import Items

COUNT = 25
TIMES = 8
PIECES = [
    "robot ", "Robots: ", "goal ", "[1, 2]", "[[1, 2], [3, 4]]", "[", "]", "{", "}", ", ", "\n", "\n- ", "1. ", "0: ",
    "| ", "|\n", "x = ", "y = ", "1", "7 ", "+ ", "- ", "→ ", "to ", "I move to ", "Position: ", "Plan: ", "Path: ",
    "my plan: ", "my ", "place ", "Wait. ", "not ", "option A ", "I choose A. ", "(counting from 1) ", "Answer:\n",
    '{"position": ', '"robot_3": {', '"neighbors": [', "(x, y) ", "...", "next ", "should be ", "or ", "cm ", "word ",
]  # fmt: skip


def looks(read: Callable[[str], object], text: str) -> int:
    """How often an item of the text is looked at."""
    count = 0
    kind = Items.kind

    def counted(self: Items, at: int) -> str:
        nonlocal count
        count += 1
        return kind(self, at)

    with pytest.MonkeyPatch.context() as patch, contextlib.suppress(AnswerError):
        patch.setattr(Items, "kind", counted)
        read(text)
    return count


pieces = st.sampled_from(PIECES)


@settings(max_examples=60)
@given(st.lists(pieces, max_size=4), st.lists(pieces, min_size=1, max_size=5), st.lists(pieces, max_size=4))
@example([], ["robot ", "[1, 2]", "\n"], [])
@example([], ["[1, 2]"], ["cm ", "goal "])
@example(["goal "], ["| ", "[1, 2]", "|\n"], [])
@example(["x = ", "1"], ["\n"], ["y = ", "2"])
@example(["Position: ", "[1, 2]"], ["[1, 2]", "\n- "], [])
@example(["Answer:\n"], ["1", "+ "], [])
@example([], ['"robot_3": {', '{"position": ', "[1, 2]", "}", "}", "\n"], [])
def test_the_looks_grow_no_faster_than_the_answer(head: list[str], unit: list[str], tail: list[str]) -> None:
    readers: list[Callable[[str], object]] = [
        lambda text: parse_plan(text, 3, 2),
        lambda text: parse_step(text, 2),
        lambda text: parse_path(text, 4, 2),
    ]
    for read in readers:
        few, many = (looks(read, "".join(head + unit * count + tail)) for count in (COUNT, COUNT * TIMES))
        assert many <= 1.25 * TIMES * few + 1000


@pytest.mark.parametrize(
    "unit", ["[[1,2],[3,4],", "1-based ", "[[1,2]]", '"a": {', '"a": "', "i.e. ", "~~", "\\begin{matrix}"], ids=ascii
)
def test_what_no_look_counts_takes_no_time(unit: str) -> None:
    text = unit * (200_000 // len(unit))
    began = time.process_time()
    for closed in (text, text[:100_000] + "]" * 20_000, "[" * 9_000 + "[1,2]" * 4000 + "]" * 9_000):
        looks(lambda answer: parse_plan(answer, 3, 2), closed)
    assert time.process_time() - began < 3.0
