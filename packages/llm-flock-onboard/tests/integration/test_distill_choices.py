"""Questions for one letter as examples: the right answer, the split, and what programs without a model get."""

import itertools
import json
import re
from collections import Counter

import pytest
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.llm._letters import Letter, LetterWay, Room
from llm_flock.llm._port import Call, Reply
from llm_flock.llm._prompting import PromptSet
from llm_flock_onboard._distill.choices import (
    DISTANCES,
    LETTERS,
    NEIGHBORS,
    WAYS,
    choice_examples,
    draw_choices,
    measure_choices,
    right_letter,
    system_message,
)
from llm_flock_onboard._distill.wishes import BESIDE, WORDINGS

LINE = ["distill", "eval", "simulated:ideal", "--count", "60"]
GAPS: dict[Room, float] = {"tight": 1.2, "wide": 2.0, "free": 9.0}


def ways(*named: tuple[Letter, Room]) -> list[LetterWay]:
    return [LetterWay(letter=letter, waypoint=(0.0, 0.0), progress=0.5, gap=GAPS[room]) for letter, room in named]


def test_the_wish_decides_only_among_open_ways() -> None:
    every = ways(("S", "tight"), ("L", "wide"), ("R", "wide"), ("H", "tight"), ("W", "free"))
    assert {wish: right_letter(every, wish) for wish in WORDINGS} == {
        "far": "S",
        "slow": "H",
        "left": "L",
        "right": "R",
        "clear": "L",
        "yield": "W",
    }
    few = ways(("R", "wide"), ("L", "wide"))
    assert {wish: right_letter(few, wish) for wish in WORDINGS} == {**dict.fromkeys(WORDINGS, "R"), "left": "L"}
    assert right_letter(ways(("W", "free")), "clear") == "W", "standing still is better than nothing"


def test_splits_share_no_wording_number_distance_or_prompt() -> None:
    for said in (*WORDINGS.values(), BESIDE):
        assert not set(said["train"]) & set(said["held-out"])
    assert not set(NEIGHBORS["train"]) & set(NEIGHBORS["held-out"])
    assert DISTANCES["train"][1] <= DISTANCES["held-out"][0]
    held = list(choice_examples(1, 100, "held-out"))
    assert not {example.messages[1][1] for example in held} & {
        example.messages[1][1] for example in choice_examples(0, 1_000, "train")
    }
    assert {example.topic.partition(" ")[0] for example in held} <= {"star", "wedge"}
    assert held == list(choice_examples(1, 100, "held-out")) != list(choice_examples(2, 100, "held-out"))
    assert all(example.kind == "choice" and example.messages[0][1] == system_message() for example in held)


def test_no_held_out_wording_is_nearly_a_taught_one() -> None:
    """Of two wordings of one wish at most half of the words are the same, and most held-out ones have a new word."""

    def words(text: str) -> frozenset[str]:
        return frozenset(re.findall(r"[a-z]+", text.lower()))

    shared = [
        len(words(taught) & words(held)) / len(words(taught) | words(held))
        for said in WORDINGS.values()
        for taught in said["train"]
        for held in said["held-out"]
    ]
    assert max(shared) <= 0.5
    known = frozenset().union(*(words(text) for said in WORDINGS.values() for text in said["train"]))
    held_out = [text for said in WORDINGS.values() for text in said["held-out"]]
    assert sum(not words(text) <= known for text in held_out) >= 0.8 * len(held_out)


def test_examples_ask_as_a_run_does() -> None:
    found = next(c for c in draw_choices(0, "train") if len(c.ways) == 4 and "W" not in {w.letter for w in c.ways})
    prompts = PromptSet.load("letters", wish=found.words)
    assert prompts.step(found.question) == found.user
    assert prompts.system(found.question.mission) == found.example().messages[0][1]


def test_no_program_without_a_model_reads_the_held_out_wishes() -> None:
    choices = list(itertools.islice(draw_choices(3, "held-out"), 600))
    letters = Counter(choice.right for choice in choices)
    assert all(0.1 < letters[letter] / len(choices) < 0.35 for letter in LETTERS)
    by_first_way = [choice.ways[0].letter == choice.right for choice in choices]
    of_known_wish = [WAYS.get(choice.wish, "S") == choice.right for choice in choices]
    assert max(sum(by_first_way), sum(of_known_wish)) < 0.75 * len(choices)


def test_a_model_is_asked_for_letters_without_a_grammar(monkeypatch: pytest.MonkeyPatch) -> None:
    right = {choice.user: choice.right for choice in itertools.islice(draw_choices(0, "held-out"), 60)}

    class Knowing:
        name = "test"

        async def ask(self, call: Call) -> Reply:
            assert call.form is None, "no grammar holds the answer to its form"
            return Reply(text=right[call.messages[-1].text], model="test")

    monkeypatch.setattr("llm_flock.llm._models.ModelPool.model", lambda *_, **__: Knowing())
    found = measure_choices("any", 60)
    assert found.asked == 60 and found.parsed == found.right == 1.0 and set(found.by_wish) == set(WORDINGS)
    monkeypatch.undo()
    shown = CliRunner().invoke(app, [*LINE, "--json"], catch_exceptions=False)
    assert json.loads(shown.output)["right"] < 1.0, "a stand-in does not know these prompts"
    table = CliRunner().invoke(app, LINE, catch_exceptions=False, env={"COLUMNS": "250"})
    assert "wish: yield" in table.output
