"""Answers that draw a plan as a formation program."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

import llm_flock
from llm_flock.errors import AnswerError
from llm_flock.formation import parse_program, program_points
from llm_flock.llm._answer_forms import longest_answer
from llm_flock.llm._port import AnswerForm
from llm_flock.llm._program_answers import read_program
from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.llm._thoughts import MAX_CHARS
from llm_flock.mission import Mission
from llm_flock.planner import PlanQuestion

MISSION = Mission(shape="text:a kite", n_robots=4, center=(40.0, 60.0))
KITE = {"draw": [{"points": [[0, 0], [2, 3], [0, 5], [-2, 3]], "closed": True}]}


def said(**changes: Any) -> str:
    return json.dumps({"reasoning": "A kite has four corners.", "program": KITE, "my_plan": 2} | changes)


@pytest.mark.parametrize(
    "frame", ["{}", "Here it is:\n```json\n{}\n```\nDone.", "<think>{{}} or so</think>{}", "{0} {0}"]
)
def test_the_program_is_read_wherever_the_object_stands(frame: str) -> None:
    plan, slot = read_program(frame.format(said()), MISSION)
    points = program_points(parse_program(KITE), 4, 2, MISSION.spacing) + np.array(MISSION.center)
    assert slot == 2 and plan.program == parse_program(KITE).text
    np.testing.assert_allclose(plan.array, points, atol=1e-6)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ("A kite.", "it holds no complete program"),
        (said()[:-20], "it holds no complete program"),
        (said() + said(my_plan=1), "2 programs that differ"),
        (said(places=4), "a field 'places'"),
        (said(my_plan=4), "my_plan is 4; a whole number from 0 to 3"),
        (said(my_plan=True), "my_plan is True"),
        (said(my_plan=None), "my_plan is None"),
        (said(program=None), "cannot be drawn: program: expected an object with draw or groups"),
        (said(program={"draw": [{"shape": "blob"}]}), "cannot be drawn: program.draw"),
        (said(program={"draw": [{"shape": "cube"}]}), "cannot be drawn"),
        (said(program={"draw": [{"text": "FLOCK"}]}), "cannot be drawn: n_robots = 4"),
        ("<think>" + said(), "nothing but thoughts"),
        (" " * (MAX_CHARS + 1), "the limit"),
    ],
)
def test_what_is_no_program_is_refused_with_the_reason(answer: str, reason: str) -> None:
    with pytest.raises(AnswerError) as caught:
        read_program(answer, MISSION)
    assert reason in str(caught.value)


@pytest.mark.parametrize(
    ("shape", "n"), [("circle", 10), ("square", 8), ("triangle", 6), ("polygon:5", 10), ("cross", 5)]
)
def test_stand_ins_fly_named_shapes_by_programs(shape: str, n: int) -> None:
    flown = llm_flock.run(shape=shape, n_robots=n, prompts="program", seed=3, trace=False)
    assert flown.formed and flown.summary.calls_rejected == 0
    assert {plan.program for plan in flown.plans if plan is not None} != {""}


def test_stand_ins_draw_wrong_programs_at_their_rates() -> None:
    flown = llm_flock.run(prompts="program", seed=3, model="simulated:distorted@0.5,malformed@0.2", trace=False)
    assert flown.formed and flown.summary.calls_rejected > 2
    unread = llm_flock.run(shape="text:a kite", n_robots=4, prompts="program", rounds=4, trace=False)
    assert not unread.formed and "draws named shapes only" in str(unread.summary.reason)


@pytest.mark.parametrize("shape", ["letters:S", "sphere", "helix"])
def test_stand_ins_fly_letters_and_bodies_by_programs(shape: str) -> None:
    flown = llm_flock.run(shape=shape, n_robots=12, prompts="program", seed=3, trace=False)
    assert flown.formed and flown.summary.calls_rejected == 0
    assert all(plan is not None and plan.program for plan in flown.plans)


@pytest.mark.parametrize(
    ("shape", "fault", "reason"),
    [
        ("circle", "misread", "point nearest to point"),
        ("circle", "stranger", "nearest to point|apart|off the shape|cannot be drawn"),
        ("letters:S", "mirrored", "off the shape"),
        ("circle", "open", "the outline is open"),
        ("circle", "crowded", "size = 5.0: expected at least 32.29, the width that 10 robots need"),
    ],
)
def test_faults_of_programs_are_found_and_named(shape: str, fault: str, reason: str) -> None:
    options = {"shape": shape, "n_robots": 10, "prompts": "program", "seed": 3, "trace": False}
    flown = llm_flock.run(**options, model=f"simulated:{fault}", rounds=4)
    assert not flown.formed and all(plan is None for plan in flown.plans)
    assert re.search(reason, str(flown.summary.reason))
    assert llm_flock.run(**options, model=f"simulated:{fault}@0.6").formed


def test_one_mistake_is_the_same_and_strangers_are_not() -> None:
    """What robots draw by two kinds of a wrong shape."""
    mission = Mission(n_robots=10)
    prompts = PromptSet.load("program")
    asked = PlanQuestion(mission=mission, robot=7, round=1, position=(3.0, 4.0), neighbors=())
    talk = [("system", prompts.system(mission)), ("user", prompts.plan(asked))]

    def drawn(fault: str) -> set[str]:
        models = [SimulatedModel(parse_profile(fault), np.random.default_rng(seed)) for seed in range(20)]
        return {json.loads(model.answer(talk))["program"]["draw"][0]["shape"] for model in models}

    assert drawn("ideal") == {"circle"} and drawn("misread") == {"triangle"}
    assert len(drawn("stranger")) > 3 and not drawn("stranger") & {"circle", "polygon"}


def test_the_question_does_not_grow_with_the_team() -> None:
    lengths = list[int]()
    for n in (10, 30, 100, 300):
        mission = Mission(shape="text:a kite", n_robots=n, arena=((0, 0), (1000, 1000)), center=(500, 500))
        asked = PlanQuestion(mission=mission, robot=7, round=1, position=(3.0, 4.0), neighbors=((1.0, 2.0),) * (n - 1))
        prompts = PromptSet.load("program")
        lengths.append(len(prompts.system(mission)) + len(prompts.plan(asked)))
    assert max(lengths) <= 1.01 * min(lengths)


def test_own_frames_keep_the_program() -> None:
    flown = llm_flock.run(n_robots=10, prompts="program", frame="own", seed=2, trace=False)
    assert flown.formed and all(plan is not None and plan.program for plan in flown.plans)


def test_no_team_makes_a_program_on_board_longer() -> None:
    form = AnswerForm(n=10, dim=2, json=True, program=True)
    assert longest_answer("plan", form) == longest_answer("plan", AnswerForm(n=300, dim=2, json=True, program=True))
