"""The documented table of forms, and answers with what they mean: each is read as it says, or refused for its reason.

In the table, ` ⏎ ` is a line break; x, y and u, v are two positions that differ, a and b two places.
"""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from llm_flock.errors import AnswerError
from llm_flock.llm._answers import read_plan, read_waypoints
from llm_flock.llm._port import AnswerForm

CASES = Path(__file__).parents[1] / "cases"
DOCS = Path(__file__).parents[4] / "docs/reference"
ANSWERS: dict[str, Any] = tomllib.loads((CASES / "answers.toml").read_text(encoding="utf-8"))
with (DOCS / "answer-forms.csv").open(encoding="utf-8", newline="") as table:
    FORMS = list(csv.DictReader(table))

coordinate = st.decimals(-999, 999, places=2, allow_nan=False).map(float)
two_places = st.sampled_from([(a, b) for b in range(4) for a in range(b)])
points = st.lists(st.tuples(coordinate, coordinate), min_size=4, max_size=4)


def read(text: str, ask: str) -> object:
    """What an answer to such a question says: points, and for a plan the place."""
    kind, _, json = ask.partition("-")
    dim, horizon = 3 if kind == "step3" else 2, 4 if kind == "path" else 1
    form = AnswerForm(n=4, dim=dim, horizon=horizon, json=bool(json))
    if kind == "plan":
        plan, slot = read_plan(text, form)
        return [list(point) for point in plan.points], slot
    return [list(point) for point in read_waypoints(text, form, (40.0, 50.0, 12.0)[:dim])]


@pytest.mark.parametrize("row", FORMS, ids=lambda row: row["Form"][:40])
@settings(max_examples=5)
@given(points, points, two_places)
def test_a_rendered_form_is_read_as_the_table_says(
    row: dict[str, str], some: list[tuple[float, float]], other: list[tuple[float, float]], places: tuple[int, int]
) -> None:
    assume(some[0] != other[0])
    (x, y), (u, v), (a, b) = some[0], other[0], places
    listed = [list(point) for point in some]
    text = (
        row["Form"]
        .replace(" ⏎ ", "\n")
        .format(
            x=x,
            y=y,
            u=u,
            v=v,
            a=a,
            b=b,
            c=b - a,
            plan=listed,
            path=listed,
            other=[list(point) for point in other],
            lines="\n".join(f"{k}: {point}" for k, point in enumerate(listed)),
            numbered="\n".join(f"{k}. {point}" for k, point in enumerate(listed, start=1)),
            arrows=" -> ".join(map(str, listed)),
        )
    )
    _, refused, why = row["Read as"].partition("refused: ")
    if refused:
        with pytest.raises(AnswerError, match=why):
            read(text, row["Asked for"])
    else:
        expected = {"step": [[x, y]], "path": listed, "plan": (listed, a)}[row["Asked for"]]
        assert read(text, row["Asked for"]) == expected


LABELS = [
    "Position: {}", "**Position:** {}.", "Next position: {}", "I move to {}.", "So my next position is {}.",
    "Answer: {}", "```\nPosition: {}\n```", "- Position: {}", "Position = {}.", "> Position: {}", "The answer is {}.",
    '{{"position": {}}}',
]  # fmt: skip


@pytest.mark.parametrize("between", ["\n", "\n\n", " ", "\n---\n"], ids=ascii)
def test_two_positions_in_answer_position_are_refused(between: str) -> None:
    for first in LABELS:
        for second in LABELS:
            same, other = first.format("[1, 2]"), second.format("[3, 4]")
            with pytest.raises(AnswerError, match="two different"):
                read(same + between + other, "step")
            assert read(same + between + second.format("[1.0, 2]"), "step") == [[1, 2]]


@pytest.mark.parametrize("case", ANSWERS["case"], ids=lambda case: f"{case['kind']} {case['ask']}")
def test_no_answer_is_read_as_another(case: dict[str, str]) -> None:
    expected = ANSWERS["answers"][case["ask"].partition("-")[0]]
    if case["ask"].startswith("plan"):
        expected = expected, ANSWERS["answers"]["my_plan"]
    got: object = None
    refusal = ""
    try:
        got = read(case["text"], case["ask"])
    except AnswerError as error:
        refusal = str(error).lower()
    if refusal:
        assert case["means"] != "read" or case.get("unread"), refusal
        assert case.get("reason", "").lower() in refusal
    else:
        assert case["means"] != "refuse" and got == expected
