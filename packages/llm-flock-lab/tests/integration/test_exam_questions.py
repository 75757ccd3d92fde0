"""The questions of the exam: fixed, distinct, answerable, and those of a private split are others."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.twenty_lines import Short

from llm_flock.errors import InputError
from llm_flock.llm._own import OwnModel
from llm_flock.llm._prompting import PromptSet
from llm_flock.protocol._verification.steps import step_faults
from llm_flock_lab._exam.ask import Examiner, round_of
from llm_flock_lab._exam.generate_steps import sidestep
from llm_flock_lab._exam.questions import SECTIONS, WRITTEN, Question, digest, from_lines, to_lines
from llm_flock_lab._exam.score import word_marks
from llm_flock_lab._exam.splits import PUBLIC_SEED, generate, paper, private_split, public_split

COUNTS = {
    "plan": 52,
    "place": 6,
    "step": 128,
    "others": 24,
    "path": 24,
    "retry": 40,
    "agreement": 20,
    "mission": 310,
    "distraction": 24,
    "edit": 60,
    "judgement": 38,
}


def test_the_public_split_is_what_its_seed_generates() -> None:
    made = [question for question in public_split() if question.section not in WRITTEN]
    assert to_lines(made) == to_lines(generate(PUBLIC_SEED))
    assert Counter(question.section for question in public_split()) == COUNTS
    assert list(COUNTS) == list(SECTIONS)


def test_the_public_questions_and_their_prompts_stay() -> None:
    made = [question for question in public_split() if question.section not in WRITTEN]
    assert digest(public_split()) == "3d4d048265356805" and digest(made) == "6c798389880e909b"
    assert Examiner(PromptSet.load("full"), "world").prompts_digest(made) == "6f1490aa7382f83e"


def test_a_file_gives_back_the_questions() -> None:
    questions = public_split()
    assert tuple(from_lines(to_lines(questions), "file")) == questions
    with pytest.raises(InputError, match=r"file, line 2.*a question of the exam"):
        from_lines(to_lines(questions[:1]) + "{}\n", "file")


def content(question: Question) -> str:
    return to_lines([replace(question, id="")])


def test_no_private_question_is_public_and_none_is_there_twice() -> None:
    seed = 7
    public = set(map(content, public_split()))
    private = private_split(seed)
    assert len(public) == len(public_split()) and len(set(map(content, private))) == len(private)
    assert public.isdisjoint(map(content, private))
    assert Counter(question.section for question in private) == {k: n for k, n in COUNTS.items() if k not in WRITTEN}
    assert private_split(seed) == private and digest(private) != digest(public_split())


def test_no_prompt_of_the_public_split_is_in_the_private_one() -> None:
    examiner = Examiner(PromptSet.load("full"), "world")

    def rendered(questions: tuple[Question, ...]) -> list[str]:
        return [str(messages) for question in questions for messages in examiner.first_messages(question)]

    public, private = rendered(public_split()), rendered(private_split(7))
    assert len(set(public)) == len(public)
    assert set(public).isdisjoint(private)


def test_a_private_split_has_a_seed_of_its_own() -> None:
    with pytest.raises(InputError, match="another seed"):
        private_split(PUBLIC_SEED)


def test_sizes_and_dimensions_reach_from_small_to_large() -> None:
    plans = [question for question in public_split() if question.section == "plan"]
    assert {question.n for question in plans} >= {3, 30}
    assert {len(question.build_mission().center) for question in plans} == {2, 3}
    named = {question.build_mission().shape.partition(":")[0] for question in plans}
    assert named == {"line", "triangle", "square", "circle", "polygon", "cross", "wedge", "grid", "star", "points"}
    steps = [question.distance for question in public_split() if question.section == "step"]
    assert min(filter(None, steps)) < 0.15 and max(filter(None, steps)) > 6


def test_robot_ahead_spoils_the_straight_step_leaving_another() -> None:
    ahead = [question for question in public_split() if question.tags[0] == "ahead"]
    assert Counter(question.section for question in ahead) == {"others": 16, "agreement": 20}
    for question in ahead:
        mission = question.build_mission()
        asked = question.step_question(mission, 0)
        here, goal = np.array(asked.position), np.array(asked.goal)
        share = min(1.0, mission.max_step / float(np.linalg.norm(goal - here)))
        assert step_faults(asked, tuple(here + share * (goal - here)))
        assert sidestep(question, mission) is not None


def test_right_answers_to_words_are_right_and_others_not() -> None:
    asked = [question for question in public_split() if question.words is not None]
    kinds = Counter(one.wanted[0]["answer"] for one in asked if one.section == "mission")
    assert kinds == {"mission": 190, "refuse": 60, "ask": 60}
    for question in asked[::9]:
        for right in question.wanted:
            said = json.dumps({**right, "about": right["about"][-1]} if "about" in right else right)
            assert word_marks(question, said).reason is None, question.words
        refusal = '{"refuse": "no"}' if question.section == "edit" else '{"answer": "refuse"}'
        refuses = "refuse" in (*question.wanted[0], question.wanted[0].get("answer"))
        assert (word_marks(question, refusal).reason is None) == refuses, question.words


MISSION: dict[str, Any] = {
    "answer": "mission",
    "keep_out": [{"polygon": [[0, 0], [100, 0], [100, 15], [0, 15]]}],
    "stages": [{"parts": [
        {"who": {"count": 3, "side": "left"}, "role": "scouts", "shape": "square", "turn": 45},
        {"shape": "text:a heart", "velocity": [-0.71, -0.71]},
    ]}],
}  # fmt: skip
ALIKE: tuple[tuple[str, str], ...] = (
    ("[[0, 0], [100, 0], [100, 15], [0, 15]]", "[[100, 15], [0, 15], [0, -9], [100, -9]]"),
    ('"side": "left"', '"side": "west"'), ('"turn": 45', '"turn": -45'), ("a heart", "Heart"), ("-0.71", "-0.707"),
    ('"answer": "mission"', '"answer": "mission", "robots": 12'),
    ('"shape": "square"', '"shape": "square", "spacing": 10'),
    ('{"shape": "text', '{"who": {"count": 9, "side": "right"}, "shape": "text'),
)  # fmt: skip
OTHER: tuple[tuple[str, str], ...] = (
    ("[100, 15], [0, 15]", "[100, 25], [0, 15]"), ('"left"', '"right"'), ('"turn": 45', '"turn": 40'), ("heart", "ox"),
    ("-0.71", "0.71"), ('"answer": "mission"', '"answer": "mission", "robots": 11'), ("scouts", "guards"),
    ('"shape": "square"', '"shape": "square", "spacing": 9'), ('"count": 3', '"count": 4'), ("square", "circle"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "right"), [*((*pair, True) for pair in ALIKE), *((*pair, False) for pair in OTHER)]
)
def test_a_mission_is_right_if_it_flies_alike(old: str, new: str, right: bool) -> None:
    fields = {"shape": "grid", "n_robots": 12, "comm_range": 150}
    question = Question(id="", section="mission", n=12, mission=fields, words="...", wanted=(MISSION,))
    text = json.dumps(MISSION)
    assert old in text
    assert (word_marks(question, text.replace(old, new)).reason is None) == right


@pytest.mark.parametrize(
    ("answer", "right"),
    [
        ('{"draw": [{"shape": "circle", "scale": [2, 1]}]}', True),
        ('{"draw": [{"shape": "circle", "scale": [1, 0.5]}]}', True),
        ('{"draw": [{"shape": "circle", "scale": [1, 2]}]}', False),
        ('{"draw": [{"shape": "circle"}]}', False),
        ('{"draw": [{"shape": "circle", "scale": [2, 1]}], "size": 20}', False),
        ('{"refuse": "it is round"}', False),
        ("Twice as wide.", False),
    ],
)
def test_an_edit_is_right_by_what_it_draws(answer: str, right: bool) -> None:
    question = next(one for one in public_split() if one.section == "edit")
    assert question.words == "Twice as wide, same height."
    marks = word_marks(question, answer)
    assert ((marks.reason is None), marks.read) == (right, "{" in answer)


def test_the_own_number_and_the_straight_way_are_no_answers() -> None:
    """What needs no thought is not enough: a right place belongs to a right plan, and another stands in the way."""
    examiner, asked = Examiner(PromptSet.load("full"), "world"), paper(sections="place,agreement")
    found = [asyncio.run(examiner.ask(question, OwnModel(Short()))) for question in asked]
    assert Counter(one.section for one in found if one.tries == 0) == {"place": 1}, "a circle is its only shape"


def test_sections_and_a_limit_choose_evenly() -> None:
    found = paper(sections="step, plan", limit=4)
    assert Counter(question.section for question in found) == {"plan": 4, "step": 4}
    assert len({question.tags[0] for question in found if question.section == "step"}) == 4
    with pytest.raises(InputError, match="unknown section"):
        paper(sections="stepp")


def test_every_question_is_recorded_under_a_number_of_its_own() -> None:
    numbers = [round_of(question, repeat) for question in public_split() for repeat in range(3)]
    assert len(set(numbers)) == len(numbers)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"split": "secret"}, "public or private"),
        ({"split": "private"}, "seed of the private split"),
        ({"seed": 3}, "--split private"),
        ({"limit": 0}, "at least 1"),
        ({"split": "private", "seed": -1}, "at least 0"),
    ],
)
def test_questions_that_there_are_none_of_are_refused(fields: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        paper(**fields)
