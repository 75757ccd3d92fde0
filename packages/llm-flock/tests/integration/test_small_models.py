"""Small models: answers of real ones are refused or read as a person judged, and teams of their likes fly safely."""

from __future__ import annotations

import csv
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import llm_flock
from llm_flock.errors import AnswerError
from llm_flock.llm._answers import read_plan, read_waypoints
from llm_flock.llm._port import AnswerForm, Reply
from llm_flock.llm._simulated.seen import SMALL_MODELS
from llm_flock.llm._thoughts import whole_answer

ANSWERS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parents[1] / "cases" / "small-models.json").read_text(encoding="utf-8")
)
"""Answers to a team of three, each with the profile that stands for its fault, whether numbers were `read` from it and
`used`, and how that was `judged`: "" right; `reason` refused for another reason than its words say; `unread` where a
person reads numbers."""

TABLE = Path(__file__).parents[4] / "docs" / "data" / "small-models.csv"


@pytest.mark.parametrize("judged", ["", "reason"])
def test_answers_of_small_models_are_read_as_judged(judged: str) -> None:
    for case in (case for case in ANSWERS if case["judged"] == judged):
        form = AnswerForm(n=3, dim=2, json=case["json"])
        reply = Reply(text=case["text"], model=case["model"], finish_reason=case["finish_reason"])
        try:
            text = whole_answer(reply)
            read_plan(text, form) if case["kind"] == "plan" else read_waypoints(text, form, tuple(case["position"]))
        except AnswerError:
            assert not case["read"], case["text"]
        else:
            assert case["read"], case["text"]


def test_the_documentation_counts_what_was_judged() -> None:
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        of = [case for case in ANSWERS if row["Profile"] in (case["fault"], "all")]
        models = Counter(case["model"] for case in of)
        assert [int(row[model]) for model in SMALL_MODELS] == [models[model] for model in SMALL_MODELS], row
        judged = Counter(case["judged"] for case in of)
        read = sum(case["read"] for case in of)
        used = sum(case["used"] for case in of)
        told = [
            int(row[name]) for name in ("Not read", "Read and refused", "Used", "Reason misses", "A person reads it")
        ]
        assert told == [len(of) - read, read - used, used, judged["reason"], judged["unread"]], row
    assert {row["Profile"] for row in rows} == {"all", *(case["fault"] for case in ANSWERS)}


def fly(model: str, seed: int, **options: Any) -> llm_flock.Summary:
    figures = llm_flock.run(llm_flock.Mission(shape="circle", n_robots=6), model=model, seed=seed, **options).summary
    assert figures.simulated and figures.steps_over_limit == 0
    assert figures.min_separation is not None and figures.min_separation >= 3 - 1e-6
    return figures


@pytest.mark.parametrize("model", SMALL_MODELS)
def test_a_team_with_small_models_forms_safely(model: str) -> None:
    for seed in range(2):
        mixed = fly(f"0=simulated:ideal,1-5=simulated:{model}", seed)
        assert mixed.formed and mixed.calls_rejected > 0
        assert fly(f"simulated:{model}", seed, fallback="geometry").formed
        assert fly(f"simulated:{model}@0.5", seed).formed


@pytest.mark.parametrize("model", SMALL_MODELS)
def test_a_team_of_small_models_alone_ends_safely(model: str) -> None:
    figures = fly(f"simulated:{model}", 0)
    assert figures.formed or (figures.stopped == "no_plan" and figures.reason)
