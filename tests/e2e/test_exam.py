"""Sitting the exam: a key gets everything right, a guesser nothing, and each fault costs its own sections."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from exam_models import Guesser, Key

from llm_flock.llm._own import OwnModel
from llm_flock.llm._port import LanguageModel
from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock_lab._exam.ask import Examiner, Outcome, round_of
from llm_flock_lab._exam.questions import SECTIONS, Question
from llm_flock_lab._exam.rows import summary
from llm_flock_lab._exam.splits import paper, public_split

WORDS = {"mission", "edit"}  # a stand-in is not asked these here
UNREAD = {*WORDS, "distraction", "judgement"}  # all or some questions are in words, which a stand-in cannot read
AHEAD = {"others", "agreement"}  # a robot stands in the way
EXAMINER = Examiner(PromptSet.load("full"), "world")


def ask(model: LanguageModel | None, questions: Sequence[Question], repeats: int = 1) -> list[Outcome]:
    async def all_() -> list[Outcome]:
        return [await EXAMINER.ask(question, model, k) for k in range(repeats) for question in questions]

    return asyncio.run(all_())


def ask_simulated(profile: str, questions: Sequence[Question], repeats: int = 1) -> list[Outcome]:
    async def one(question: Question, repeat: int) -> Outcome:
        rng = np.random.default_rng([0, round_of(question, repeat), question.robots[0]])
        return await EXAMINER.ask(question, SimulatedModel(parse_profile(profile), rng), repeat)

    async def all_() -> list[Outcome]:
        return [await one(q, repeat) for repeat in range(repeats) for q in questions if q.words is None]

    return asyncio.run(all_())


@cache
def shares(profile: str, limit: int, seed: int | None = None) -> dict[str, float]:
    questions = paper("public" if seed is None else "private", seed, None, limit)
    return shares_of(ask_simulated(profile, questions))


def shares_of(outcomes: Sequence[Outcome]) -> dict[str, float]:
    return {name: found.first.value for name, found in summary(outcomes)["sections"].items()}


def test_right_answers_are_right_in_every_section() -> None:
    outcomes = ask(OwnModel(Key(public_split())), paper(limit=130))
    assert [(o.question, o.reason) for o in outcomes if o.tries != 0] == []
    assert {outcome.section for outcome in outcomes} == set(SECTIONS)


def test_the_ideal_stand_in_is_right_where_straight_steps_are() -> None:
    found = dict(shares("ideal", 1000))
    ahead, judged = [found.pop(name) for name in sorted(AHEAD)], found.pop("judgement")
    assert found == dict.fromkeys(set(SECTIONS) - AHEAD - UNREAD, 1.0) | {"distraction": 0.0}
    assert max(ahead) < 0.5, "it walks straight, and turns shapes by chance: robots in the way are beyond it"
    assert 0.2 < judged < 0.8, "it reads figures, but no wishes in words of their own"


@pytest.mark.parametrize(("limit", "seed"), [(1000, None), (30, 7)], ids=["public", "private"])
def test_the_careful_stand_in_is_always_right(limit: int, seed: int | None) -> None:
    found = {name: share for name, share in shares("careful", limit, seed).items() if name != "judgement"}
    assert found == dict.fromkeys(set(SECTIONS) - UNREAD, 1.0) | {"distraction": 0.0}


def test_the_random_stand_in_is_wrong_in_every_section() -> None:
    found = dict(shares("random", 1000))
    assert found.pop("judgement") < 0.5
    assert set(found) == set(SECTIONS) - WORDS - {"judgement"} and max(found.values()) <= 0.05
    asked = [outcome for outcome in ask_simulated("random", paper(limit=20)) if outcome.section != "judgement"]
    assert all(outcome.readable != (outcome.section in UNREAD) for outcome in asked)


def test_answers_by_chance_are_wrong() -> None:
    outcomes = ask(OwnModel(Guesser()), paper(limit=40))
    found = summary(outcomes)["sections"]
    assert found.pop("judgement").first.value < 0.6
    assert all(section.first.value <= 0.05 for section in found.values() if section.questions > 10)
    assert all(o.readable for o in outcomes if o.section == "plan")


PLANS, STEPS = {"plan", "place", "others", "retry"}, {"step", "path", "retry"}
FAULTS = {"distorted": PLANS, "overshoot": STEPS, "overlong": STEPS, "collapse": STEPS}


@pytest.mark.parametrize(
    ("fault", "sections"),
    [*FAULTS.items(), ("malformed", set(SECTIONS) - UNREAD - {"agreement"})],
    ids=[*FAULTS, "malformed"],
)
def test_a_fault_lowers_exactly_its_sections(fault: str, sections: set[str]) -> None:
    ideal, faulty = shares("ideal", 20), shares(fault, 20)
    assert {name for name in ideal if faulty[name] < ideal[name]} - {"agreement", "judgement"} == sections


@pytest.mark.parametrize(
    ("fault", "sections"), [*FAULTS.items(), ("random", set(SECTIONS) - UNREAD)], ids=[*FAULTS, "random"]
)
def test_a_fault_of_a_careful_model_lowers_its_sections(fault: str, sections: set[str]) -> None:
    """Steps among other robots count here too, which an ideal model, walking straight, gets wrong anyway."""
    faulty = shares(f"careful,{fault}", 20)
    assert {name for name, share in faulty.items() if share < 1.0} == sections | AHEAD | {"distraction", "judgement"}


def test_a_private_split_ranks_models_as_the_public_one() -> None:
    models = ("ideal", "distorted@0.3", "overshoot", "distorted,overshoot", "malformed@0.9")

    def order(seed: int | None) -> list[str]:
        return sorted(models, key=lambda model: -sum(shares(model, 10, seed).values()))

    public = order(None)
    assert public == order(7)
    assert public[0] == "ideal" and public[-1] == "malformed@0.9"


def test_a_reason_helps_where_a_fault_is_not_always_there() -> None:
    outcomes = ask_simulated("malformed@0.5", paper(sections="step", limit=40))
    right = [sum(o.tries is not None and o.tries <= reasons for o in outcomes) for reasons in range(3)]
    assert right[0] < right[1] < right[2]
    assert all(o.calls == (3 if o.tries is None else 1 + o.tries) for o in outcomes)


def test_repeats_show_how_steady_a_model_is() -> None:
    outcomes = ask_simulated("malformed@0.5", paper(sections="step", limit=20), repeats=3)
    by_question = {
        o.question: [other.tries == 0 for other in outcomes if other.question == o.question] for o in outcomes
    }
    assert len(by_question) == 20
    assert sum(0 < sum(found) < 3 for found in by_question.values()) > 10
    assert summary(outcomes)["sections"]["step"].questions == 20


def test_figures_do_not_depend_on_the_order_of_answers() -> None:
    outcomes = ask_simulated("malformed@0.5", paper(limit=3))
    assert summary(outcomes) == summary(outcomes[::-1])


def test_geometry_sits_without_prompts() -> None:
    outcomes = ask(None, paper(sections="plan,step,distraction", limit=8))
    assert shares_of(outcomes) == {"plan": 1.0, "step": 1.0, "distraction": 0.0}
    assert sum(o.calls for o in outcomes) == 0


ANSWERS: tuple[Any, ...] = (
    "", "\0" * 1000, "[" * 50_000, "9" * 100_000, "Plan: " + "[1e999, 1]," * 2000, "\ud800", "Position: [NaN, 1]",
    '{"shape": "circle", "n_robots": 99999999999999999999999}', '{"shape": "points:/etc/passwd", "n_robots": 3}',
    '{"shape": "text:x", "n_robots": 1e308, "center": [1e308, -1e308]}', None, 5, b"bytes", ["Position: [1, 2]"],
)  # fmt: skip


def test_answers_without_sense_are_wrong_answers() -> None:
    class Odd:
        calls = 0

        async def ask(self, call: Any) -> Any:
            self.calls += 1
            return ANSWERS[self.calls % len(ANSWERS)]

    outcomes = ask(OwnModel(Odd()), paper(limit=4))
    assert {o.tries for o in outcomes} == {None}
    assert all(o.reason and len(o.reason) <= 300 for o in outcomes)
    assert sum(o.cause == "garbage" for o in outcomes) > 3
