"""Questions for one letter: the ways, the right one, the split, and what programs without a model get."""

import itertools
import json
import math
from collections import Counter
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.distill.choices import (
    DISTANCES,
    LETTERS,
    NEIGHBORS,
    SYSTEM,
    WORDINGS,
    choice_examples,
    choice_figures,
    draw_choices,
    measure_choices,
    read_letter,
    right_way,
    taught_choices,
    ways_of,
)
from llm_flock.llm.port import Call, Reply
from llm_flock.mission import build_mission
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import StepQuestion

MISSION = build_mission(shape="triangle", n_robots=3, center=(50.0, 50.0), spacing=12.0, max_step=6.0)


def question(*neighbors: tuple[float, float]) -> StepQuestion:
    assert MISSION.ideal is not None
    plan = Plan.of(MISSION.ideal)
    return StepQuestion(
        mission=MISSION,
        robot=0,
        round=1,
        position=(0.0, 0.0),
        neighbors=neighbors,
        plan=plan,
        slot=0,
        target=(60.0, 0.0),
        horizon=1,
    )


def test_ways_are_computed_and_measured() -> None:
    straight, half, left, right, wait = ways_of(question((6.0, -2.0)))
    assert straight.waypoint == pytest.approx((6.0, 0.0)) and half.waypoint == pytest.approx((3.0, 0.0))
    assert left.waypoint[1] > 0 > right.waypoint[1] and wait.waypoint == pytest.approx((0.0, 0.0))
    assert straight.progress == pytest.approx(1.0) and wait.progress == pytest.approx(0.0)
    assert straight.gap == pytest.approx(2 / 3) and not straight.safe
    assert wait.gap == pytest.approx(math.hypot(6, 2) / 3) and wait.safe
    # The gap is that on the way, not only at its end.
    assert ways_of(question((3.0, 1.0)))[0].gap == pytest.approx(1 / 3)


def test_the_wish_decides_only_among_safe_ways() -> None:
    free, ahead = ways_of(question()), ways_of(question((4.5, -1.5)))
    named = {wish: right_way(free, wish) for wish in WORDINGS}
    assert {wish: way and way.name for wish, way in named.items()} == {
        "far": "straight on",
        "left": "round to the left",
        "right": "round to the right",
        "clear": None,
        "yield": "wait",
    }
    found = right_way(ahead, "right")
    assert found is not None and found.safe and found.name == "round to the left", "the right side is not safe"
    roomy = right_way(ahead, "clear")
    assert roomy is not None and roomy.name == "round to the left"
    assert right_way((), "far") is None


def test_splits_share_no_wording_number_distance_or_prompt() -> None:
    for wordings in WORDINGS.values():
        assert not set(wordings["train"]) & set(wordings["held-out"])
    assert not set(NEIGHBORS["train"]) & set(NEIGHBORS["held-out"])
    assert DISTANCES["train"][1] <= DISTANCES["held-out"][0]
    held = list(choice_examples(1, 400, "held-out"))
    assert not {example.user for example in held} & taught_choices()
    assert {example.team.partition(" ")[0] for example in held} <= {"star", "wedge"}
    assert held == list(choice_examples(1, 400, "held-out")) != list(choice_examples(2, 400, "held-out"))
    assert all(example.kind == "choice" and example.system == SYSTEM for example in held)


def test_neither_letter_nor_one_rule_tells_the_answer() -> None:
    choices = list(itertools.islice(draw_choices(3, "held-out"), 1000))
    letters = Counter(choice.right for choice in choices)
    assert all(0.15 < letters[letter] / len(choices) < 0.25 for letter in LETTERS)
    names = Counter(choice.ways[LETTERS.index(choice.right)].name for choice in choices)
    assert max(names.values()) < 0.5 * len(choices) and len(names) >= 4
    ideal = choice_figures(choices, [choice.right for choice in choices])
    assert ideal.parsed == ideal.right == ideal.safe == 1.0 and set(ideal.by_wish) == set(WORDINGS)
    nothing = choice_figures(choices, [None] * len(choices))
    assert nothing.parsed == nothing.right == nothing.safe == 0.0
    assert any(not way.safe for choice in choices for way in choice.ways)


def test_only_a_letter_of_the_question_is_read() -> None:
    assert [read_letter(text) for text in ("B", " C.", "D: wait", "F", "Always", "", "b", "1 A")] == [
        *("B", "C", "D"),
        *[None] * 5,
    ]


def test_a_model_is_asked_and_stands_beside_programs_that_read_no_wish(monkeypatch: pytest.MonkeyPatch) -> None:
    right = {choice.user: choice.right for choice in itertools.islice(draw_choices(0, "held-out"), 60)}

    class Knowing:
        name = "test"

        async def ask(self, call: Call) -> Reply:
            assert call.form is None, "no grammar holds the answer to its form"
            return Reply(text=right[call.messages[-1].text], model="test")

    monkeypatch.setattr("llm_flock.llm.models.ModelPool.model", lambda *_, **__: Knowing())
    found = measure_choices("any", 60)
    assert found["choice"].right == 1.0 and found["choice"].taught == 0
    assert found["first_letter"].right < 0.5 and found["random_letter"].right < 0.5
    assert found["farthest_safe"].safe == 1.0 and found["farthest_safe"].by_wish["far"] == 1.0
    assert found["farthest_safe"].right < 0.7
    monkeypatch.undo()
    line = ["distill", "eval", "simulated:ideal", "--count", "1", "--paths", "0", "--plans", "0", "--frame", "own"]
    monkeypatch.setattr("llm_flock.distill.choices.measure_choices", lambda *_: found)
    shown = CliRunner().invoke(app, [*line, "--choices", "60", "--json"], catch_exceptions=False)
    assert json.loads(shown.output)["choices"]["choice"]["asked"] == 60
    table = CliRunner().invoke(app, [*line, "--choices", "60"], catch_exceptions=False, env={"COLUMNS": "200"})
    assert "farthest safe" in table.output


def test_a_choice_whose_answer_is_nearly_a_tie_is_left_out() -> None:
    straight, *rest = ways_of(question())
    assert right_way((straight, replace(rest[0], progress=0.99)), "far") is None
