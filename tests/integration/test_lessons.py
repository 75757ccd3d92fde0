"""What the model on board is taught: right answers, and nothing that is held out or asked by the exam."""

import json
import re
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
import pytest
from benchmarks.lessons import PROMPTS, draw_motion, drawing, lessons, taught, way_round
from benchmarks.lessons_in_words import draw_edit, draw_request, filled, written

from llm_flock.formation import parse_program
from llm_flock.llm import PromptSet, answer_of, frame_plan
from llm_flock.planner import PlanQuestion
from llm_flock.protocol import step_faults
from llm_flock_lab._exam.ask import Examiner
from llm_flock_lab._exam.generate_plans import CIRCLES, DISTRACTIONS
from llm_flock_lab._exam.splits import public_split
from llm_flock_onboard._distill.curriculum import CURRICULUM, plan_mission, taught_teams
from llm_flock_onboard._distill.examples import TEAMS, draw_mission, draw_step

EXAM = [question for question in public_split() if question.words is not None or question.section == "distraction"]


WRITTEN: list[dict[str, Any]] = [*written("mission"), *written("edit")]


def _fives(text: str) -> set[tuple[str, ...]]:
    words = re.findall(r"[a-z']+", text)
    return set(zip(*(words[k:] for k in range(5)), strict=False))


def plain(words: str) -> str:
    return " ".join(words.split()).casefold().strip(" .!")


def plan_prompts(teams: tuple[tuple[str, int], ...]) -> set[str]:
    """What every robot of these teams is asked."""
    found: set[str] = set()
    for shape, n in teams:
        mission = plan_mission(shape, n)
        for robot in range(n):
            asked = PlanQuestion(mission=mission, robot=robot, round=1, position=mission.center, neighbors=())
            found.add(PROMPTS.plan(frame_plan(asked, "own").framed))
    return found


def test_examples_are_repeatable_and_of_all_kinds() -> None:
    found = list(lessons(3, 200))
    assert found == list(lessons(3, 200)) != list(lessons(4, 200))
    assert {example.kind for example in found} == {"plan", "step", "path", "judgement", "mission", "edit"}
    assert {len(example.messages) for example in found} == {2, 4}, "some are asked again"


def test_no_prompt_of_a_held_out_team_is_taught() -> None:
    taught_ones, held = plan_prompts(taught_teams()), plan_prompts(taught_teams(held_out=True))
    assert len(taught_ones) > 1000 and len(held) > 300 and not taught_ones & held
    given = CURRICULUM["plans"]
    assert not {n for _, n in taught_teams()} & {*given["held_out_sizes"]}
    assert not {shape for shape, _ in taught_teams()} & {*given["held_out_shapes"]}


def test_no_prompt_of_the_exams_words_is_taught() -> None:
    examiner = Examiner(PromptSet.load("brief-program"), "own")
    asked = {"\n".join(m.text for m in messages) for q in EXAM for messages in examiner.first_messages(q)}
    said = {plain(q.words) for q in EXAM if q.words is not None}
    rng = np.random.default_rng(0)
    drawn = [draw(rng) for draw in (draw_request, draw_edit) for _ in range(400)]
    for example in [one for one in drawn if one is not None] + list(lessons(1, 60)):
        assert example.prompt not in asked
        if example.kind in ("mission", "edit"):
            assert plain(example.messages[1][1].rpartition("\n\n")[2]) not in said


def test_no_wording_of_the_exam_is_among_the_pieces() -> None:
    said = {plain(question.words or question.wish or "") for question in public_split()}
    pieces = [*CURRICULUM["missions"]["refuse"]["train"], *chain(*CURRICULUM["missions"]["ask"].values())]
    pieces += chain(*(given["train"] for kind in ("wishes", "orders") for given in CURRICULUM[kind].values()))
    assert len(pieces) > 80 and not {plain(piece) for piece in pieces} & said
    whole = {plain(text) for given in WRITTEN for text in given["say"]}
    assert len(whole) > 2000 and not whole & said
    phrases, fives = [_fives(text) for text in said], map(_fives, [*whole, *map(plain, pieces)])
    assert not [own for own in fives if any(len(own & phrase) > 2 for phrase in phrases)], "nearly a sentence of it"
    beside = {plain(text.partition("}")[2]) for _, text in DISTRACTIONS}
    assert not {plain(text) for text in CURRICULUM["beside"]["train"]} & beside
    described = {plain(text) for _, text in CIRCLES}
    assert not {plain(text) for texts in CURRICULUM["texts"]["train"] for text in texts["say"]} & described


def test_written_requests_have_answers_that_are_legal() -> None:
    rng = np.random.default_rng(7)
    for given in WRITTEN[::5]:
        words, answer, program = filled(rng, given)
        assert "{" not in words
        if program is None:
            assert answer_of(json.dumps(answer)).answer == answer["answer"]
        elif "refuse" not in answer:
            assert parse_program(answer) != parse_program(program), words


@pytest.mark.parametrize(("shape", "n"), [("wedge", 12), ("grid", 8), ("grid", 30), ("star", 20), ("polygon:6", 18)])
def test_a_drawing_gives_the_places_of_its_shape(shape: str, n: int) -> None:
    mission = plan_mission(shape, n)
    asked = PlanQuestion(mission=mission, robot=2, round=1, position=mission.center, neighbors=())
    right = json.dumps({"program": {"draw": drawing(shape)}, "my_plan": 2})
    assert taught("plan", asked, right) is not None
    wrong = json.dumps({"program": {"draw": drawing("circle")}, "my_plan": 2})
    assert taught("plan", asked, wrong) is None


def test_the_way_round_passes_the_checks_and_gets_nearer() -> None:
    rng, around = np.random.default_rng(1), 0
    for _ in range(60):
        asked = draw_step(rng, draw_mission(rng, "train", TEAMS))
        other = tuple(h + 0.6 * (g - h) for h, g in zip(asked.position, asked.goal, strict=True))
        asked = replace(asked, neighbors=(other,))
        waypoint = way_round(asked)
        if waypoint is None:
            continue
        assert not step_faults(asked, waypoint)
        (a, b), (x, y) = (np.subtract(point, asked.position) for point in (asked.goal, waypoint))
        around += bool(abs(a * y - b * x) > 1e-6)
    assert around > 3
    assert draw_motion(np.random.default_rng(3), "step") is not None


def test_missions_are_taught_as_they_are_flown() -> None:
    rng = np.random.default_rng(5)
    answers = [json.loads(one.answer) for one in (draw_request(rng) for _ in range(200)) if one is not None]
    assert {answer["answer"] for answer in answers} == {"mission", "ask", "refuse"}
    order = ("answer", "robots", "keep_out", "gaps", "stages", "prefer", "about")
    for answer in answers:
        assert [*answer] == [name for name in order if name in answer], "the grammar allows the schema's order only"
        assert answer_of(json.dumps(answer)).answer == answer["answer"]
