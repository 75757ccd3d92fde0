"""Sitting the exam: a key gets everything right, a guesser nothing, and each fault costs its own sections."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from datetime import date
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from exam_models import Guesser, Key

from llm_flock.errors import InputError, RecordError
from llm_flock.exam.ask import Outcome
from llm_flock.exam.examinee import Examinee, Setup
from llm_flock.exam.figures import exam_figures
from llm_flock.exam.forecast import expected_use
from llm_flock.exam.questions import SECTIONS
from llm_flock.exam.results import read_results
from llm_flock.exam.score import word_marks
from llm_flock.exam.session import Finished, Paper, hold_exam
from llm_flock.exam.sit import asked_of
from llm_flock.exam.splits import public_split
from llm_flock.llm.own import OwnModel

DAY = date(2026, 1, 2)


def hold(folder: Path, model: str = "own", *, paper: Paper | None = None, own: Any = None, **fields: Any) -> Finished:
    handed = None if own is None else OwnModel(own)
    setup = Setup(model=model if own is None else "exam_models:Own", **fields)
    return asyncio.run(hold_exam(setup, paper or Paper(), folder, own=handed, today=DAY))


@cache
def shares(folder: Path, model: str, paper: Paper) -> dict[str, float]:
    outcomes = hold(folder / f"{paper.split}-{paper.limit}", model, paper=paper).outcomes
    return {name: found.first.value for name, found in exam_figures(outcomes).sections.items()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("exam")


def test_right_answers_are_right_in_every_section(tmp_path: Path) -> None:
    outcomes = hold(tmp_path, own=Key(public_split()), paper=Paper(limit=130)).outcomes
    assert [(o.question, o.reason) for o in outcomes if o.tries != 0] == []
    assert {outcome.section for outcome in outcomes} == set(SECTIONS)
    assert len(outcomes) == len(public_split()) - 370


def test_the_ideal_stand_in_is_right_wherever_a_straight_step_is(folder: Path) -> None:
    found = shares(folder, "simulated:ideal", Paper())
    others = found.pop("others")
    assert found == dict.fromkeys(set(SECTIONS) - {"others", "mission"}, 1.0)
    assert others < 0.5, "it walks straight, and turns shapes by chance: robots in the way are beyond it"


@pytest.mark.parametrize("paper", [Paper(), Paper(split="private", seed=7, limit=30)], ids=["public", "private"])
def test_the_careful_stand_in_is_right_in_every_section_that_it_is_asked(folder: Path, paper: Paper) -> None:
    assert shares(folder, "simulated:careful", paper) == dict.fromkeys(set(SECTIONS) - {"mission"}, 1.0)


def test_the_random_stand_in_is_wrong_in_every_section(folder: Path) -> None:
    found = shares(folder, "simulated:random", Paper())
    assert set(found) == set(SECTIONS) - {"mission"} and max(found.values()) <= 0.05
    outcomes = hold(folder / "random", "simulated:random", paper=Paper(limit=20)).outcomes
    assert all(outcome.readable for outcome in outcomes)


def test_answers_by_chance_are_wrong(tmp_path: Path) -> None:
    found = exam_figures(hold(tmp_path, own=Guesser(), paper=Paper(limit=40)).outcomes)
    assert found.total.value < 0.02
    assert all(section.first.value <= 0.05 for section in found.sections.values() if section.questions > 10)
    assert found.sections["plan"].readable == 1.0


@pytest.mark.parametrize(
    ("fault", "sections"),
    [
        ("distorted", {"plan", "others", "retry", "distraction"}),
        ("overshoot", {"step", "path", "retry", "agreement"}),
        ("overlong", {"step", "path", "retry", "agreement"}),
        ("collapse", {"step", "path", "retry", "agreement"}),
        ("malformed", set(SECTIONS) - {"mission"}),
    ],
)
def test_a_fault_lowers_exactly_its_sections(fault: str, sections: set[str], folder: Path) -> None:
    paper = Paper(limit=20)
    ideal, faulty = shares(folder, "simulated:ideal", paper), shares(folder, f"simulated:{fault}", paper)
    assert {name for name in ideal if faulty[name] < ideal[name]} == sections


@pytest.mark.parametrize(
    ("fault", "sections"),
    [
        ("distorted", {"plan", "others", "retry", "distraction"}),
        ("overshoot", {"step", "others", "path", "retry", "agreement"}),
        ("overlong", {"step", "others", "path", "retry", "agreement"}),
        ("collapse", {"step", "others", "path", "retry", "agreement"}),
        ("random", set(SECTIONS) - {"mission"}),
    ],
)
def test_a_fault_of_a_careful_model_lowers_exactly_its_sections(fault: str, sections: set[str], folder: Path) -> None:
    """Plans and steps among other robots count here too, which an ideal model, walking straight, gets wrong anyway."""
    faulty = shares(folder, f"simulated:careful,{fault}", Paper(limit=20))
    assert {name for name, share in faulty.items() if share < 1.0} == sections


def test_a_private_split_ranks_models_as_the_public_one(folder: Path) -> None:
    models = ("ideal", "distorted@0.3", "overshoot", "distorted,overshoot", "malformed@0.9")

    def order(paper: Paper) -> list[str]:
        totals = {model: sum(shares(folder, f"simulated:{model}", paper).values()) for model in models}
        return sorted(models, key=lambda model: -totals[model])

    public = order(Paper(limit=10))
    assert public == order(Paper(split="private", seed=7, limit=10))
    assert public[0] == "ideal" and public[-1] == "malformed@0.9"


def test_a_reason_helps_where_a_fault_is_not_always_there(folder: Path) -> None:
    outcomes = hold(folder / "again", "simulated:malformed@0.5", paper=Paper(sections="step,plan", limit=40)).outcomes
    found = exam_figures(outcomes).sections["step"]
    assert found.first.value < found.one.value < found.two.value
    assert all(o.calls == (3 if o.tries is None else 1 + o.tries) for o in outcomes)


def test_an_exam_that_broke_off_goes_on(tmp_path: Path) -> None:
    model, paper = "simulated:malformed@0.5", Paper(sections="step,retry,place", limit=10)
    whole = hold(tmp_path / "whole", model, paper=paper)
    cut = hold(tmp_path / "cut", model, paper=paper, max_calls=20)
    assert whole.complete and not cut.complete and cut.row is None
    assert 0 < len(cut.outcomes) < len(whole.outcomes)
    with (tmp_path / "cut" / "simulated-malformed-0.5.jsonl").open("a") as file:
        file.write('{"question": "step-00')
    rest = hold(tmp_path / "cut", model, paper=paper)

    def told(finished: Finished) -> list[Outcome]:
        return sorted((replace(o, seconds=0.0) for o in finished.outcomes), key=lambda o: o.question)

    assert rest.complete and told(rest) == told(whole)


def test_another_exam_does_not_go_into_the_same_file(tmp_path: Path) -> None:
    hold(tmp_path, "simulated:ideal", paper=Paper(sections="step", limit=2))
    with pytest.raises(InputError, match="its questions was"):
        hold(tmp_path, "simulated:ideal", paper=Paper(sections="step", limit=3))
    (tmp_path / "simulated-ideal.jsonl").write_text("{}\n")
    with pytest.raises(RecordError, match="not a result file"):
        read_results(tmp_path / "simulated-ideal.jsonl")


def test_a_recording_gives_the_same_results(tmp_path: Path) -> None:
    paper = Paper(limit=3)
    # Broken off once, so that there are two recordings to join.
    hold(tmp_path / "asked", own=Guesser(), paper=paper, max_calls=15)
    asked = hold(tmp_path / "asked", own=Guesser(), paper=paper)
    assert asked.complete and asked.recording is not None
    again = hold(tmp_path / "again", f"replay:{asked.recording}", paper=paper)
    plain = [sorted(finished.outcomes, key=lambda o: o.question) for finished in (asked, again)]
    assert plain[0] == plain[1]


def test_repeats_show_how_steady_a_model_is(tmp_path: Path) -> None:
    paper = Paper(sections="step", limit=20, repeats=3)
    steady = exam_figures(hold(tmp_path, "simulated:ideal", paper=paper).outcomes).sections["step"]
    shaky = exam_figures(hold(tmp_path, "simulated:malformed@0.5", paper=paper).outcomes).sections["step"]
    assert (steady.questions, steady.unsteady) == (20, 0.0)
    assert shaky.unsteady > 0.5


def test_figures_do_not_depend_on_the_order_of_answers(folder: Path) -> None:
    outcomes = list(hold(folder / "order", "simulated:malformed@0.5", paper=Paper(limit=3)).outcomes)
    assert exam_figures(outcomes) == exam_figures(outcomes[::-1])


def test_geometry_sits_without_prompts(tmp_path: Path) -> None:
    found = exam_figures(hold(tmp_path, "geometry", paper=Paper(limit=8)).outcomes)
    assert found.sections["plan"].first.value == found.sections["step"].first.value == 1.0
    assert found.sections["distraction"].first.value == 0.0 and found.use.calls == 0


def test_a_provider_that_fails_is_asked_again_later(tmp_path: Path) -> None:
    class Sometimes(Key):
        down = True

        async def ask(self, call: Any) -> str:
            if self.down and call.round % 2:
                raise PermissionError("no entry")
            return await super().ask(call)

    model, paper = Sometimes(public_split()), Paper(sections="step", limit=10)
    first = hold(tmp_path, own=model, paper=paper, max_tries=1)
    failed = [outcome for outcome in first.outcomes if outcome.cause is not None]
    assert 0 < len(failed) < 10 and {outcome.cause for outcome in failed} == {"connection"}
    assert not first.complete and first.row is None, "a row has no questions without an answer"
    model.down = False
    second = hold(tmp_path, own=model, paper=paper, max_tries=1)
    assert [outcome.tries for outcome in second.outcomes] == [0] * 10 and second.complete


@pytest.mark.parametrize(
    ("possible", "answer", "right", "read", "safe"),
    [
        (True, '{"shape": "square", "n_robots": 8}', True, True, True),
        (True, 'Sure! {"shape": "square", "n_robots": 8, "spacing": 10}', True, True, True),
        (True, '{"shape": "square", "n_robots": 8, "spacing": 9}', False, True, False),
        (True, '{"shape": "circle", "n_robots": 8}', False, True, False),
        (True, "I cannot do that.", False, False, True),
        (False, '{"shape": "square", "n_robots": 7}', True, True, True),
        (False, '{"shape": "square", "n_robots": 8}', False, True, False),
        (False, '{"shape": "square", "n_robots": 9}', False, True, True),
    ],
)
def test_words_are_compared_field_by_field(possible: bool, answer: str, right: bool, read: bool, safe: bool) -> None:
    question = next(q for q in public_split() if q.section == "mission" and q.possible == possible)
    wanted = {"shape": "square", "n_robots": 8 if possible else 7}
    marks = word_marks(replace(question, wanted=wanted), answer)
    assert (marks.reason is None, marks.read, marks.safe) == (right, read, safe)


def test_what_an_exam_takes_is_known_before() -> None:
    questions = Paper(sections="place,step,mission", limit=4).questions()
    examinee = Examinee(Setup(model="openai:gpt-5"))
    found = expected_use(examinee, asked_of(examinee, questions), repeats=2)
    robots = sum(len(question.robots) for question in questions)
    assert found.calls == 2 * robots and found.at_most == 2 * (3 * (robots - 4) + 4)
    assert found.cost_usd is not None and found.cost_usd > 0
    assert expected_use(Examinee(Setup(model="geometry")), questions, 1).calls == 0


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"split": "secret"}, "public or private"),
        ({"split": "private"}, "seed of the private split"),
        ({"seed": 3}, "--split private"),
    ],
)
def test_wrong_papers_are_refused(fields: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        Paper(**fields).questions()


def test_a_row_says_what_was_taught(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def taught(*_: Any) -> dict[str, float]:
        asyncio.run(asyncio.sleep(0))  # as the making of examples does
        return {"step": 1 / 3}

    monkeypatch.setattr("llm_flock.exam.session.seen_in_training", taught)
    row = hold(tmp_path, "simulated:ideal", paper=Paper(sections="step", limit=2)).row
    assert row is not None and row["seen_in_training"] == {"step": 0.3333}


def test_a_row_says_who_sat_what(tmp_path: Path) -> None:
    row = hold(tmp_path, "simulated:ideal", paper=Paper(limit=2)).row
    assert row is not None
    assert row["simulated"] is True and row["date"] == "2026-01-02" and row["recording"] is None
    assert row["command"] == "llm-flock exam simulated:ideal --limit 2"
    assert json.loads(json.dumps(row)) == row
