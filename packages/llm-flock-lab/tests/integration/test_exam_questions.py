"""The questions of the exam: fixed, distinct, answerable, and those of a private split are others."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from llm_flock.errors import InputError
from llm_flock.llm._mission_words import draft_of
from llm_flock.llm._prompting import PromptSet
from llm_flock.protocol._verification.steps import step_faults
from llm_flock_lab._exam.ask import Examiner, round_of
from llm_flock_lab._exam.generate_steps import sidestep
from llm_flock_lab._exam.questions import SECTIONS, Question, digest, from_lines, to_lines
from llm_flock_lab._exam.splits import PUBLIC_SEED, generate, paper, private_split, public_split

COUNTS = {
    "plan": 52,
    "place": 6,
    "step": 128,
    "others": 24,
    "path": 24,
    "retry": 40,
    "agreement": 20,
    "mission": 500,
    "distraction": 24,
}


def test_the_public_split_is_what_its_seed_generates() -> None:
    assert to_lines(public_split()) == to_lines(generate(PUBLIC_SEED))
    assert Counter(question.section for question in public_split()) == COUNTS
    assert list(COUNTS) == list(SECTIONS)


def test_the_public_questions_and_their_prompts_stay() -> None:
    stand_ins = [question for question in public_split() if question.section != "mission"]
    assert digest(public_split()) == "6a146e875bea2ba0" and digest(stand_ins) == "8403ccf95154c494"
    assert Examiner(PromptSet.load("full"), "world").prompts_digest(stand_ins) == "701de61afba7dd55"


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
    assert Counter(question.section for question in private) == COUNTS
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
    assert len(ahead) == 16
    for question in ahead:
        mission = question.build_mission()
        asked = question.step_question(mission, 0)
        here, goal = np.array(asked.position), np.array(asked.goal)
        share = min(1.0, mission.max_step / float(np.linalg.norm(goal - here)))
        assert step_faults(asked, tuple(here + share * (goal - here)))
        assert sidestep(question, mission) is not None


def test_words_say_a_mission_exactly_where_it_is_possible() -> None:
    words = [question for question in public_split() if question.section == "mission"]
    assert sum(not question.possible for question in words) == 100
    for question in words:
        try:
            wanted = dict(question.wanted or {})
            robots = wanted.pop("n_robots")
            draft_of(json.dumps({"answer": "mission", "robots": robots, "stages": [{"parts": [wanted]}]}))
            flies = True
        except InputError:
            flies = False
        assert flies == question.possible, question.words


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
