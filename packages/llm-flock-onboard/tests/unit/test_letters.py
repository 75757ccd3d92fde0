"""Questions for one letter in a run: the open ways, the planner, and what it does where there is nothing to choose."""

import asyncio
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from llm_flock import run
from llm_flock.errors import AnswerError, InputError
from llm_flock.llm._answer_forms import LETTER_TOKENS, answer_grammar, longest_answer
from llm_flock.llm._letters import check_wish, read_letter, read_way, ways_of, ways_text
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import Attempt, Call, Reply
from llm_flock.llm._prompting import PromptSet
from llm_flock.mission import build_mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock_onboard._local.weights import find_weights, is_packaged

MISSION = build_mission(shape="triangle", n_robots=3, center=(50.0, 50.0), spacing=12.0, max_step=6.0)


def question(*neighbors: tuple[float, float], goal: tuple[float, float] = (80.0, 20.0), **more: Any) -> StepQuestion:
    assert MISSION.ideal is not None
    asked = StepQuestion(
        mission=MISSION,
        robot=0,
        round=1,
        position=(20.0, 20.0),
        neighbors=neighbors,
        plan=Plan.of(MISSION.ideal),
        slot=0,
        target=goal,
    )
    return replace(asked, **more)


class Saying:
    """A model that gives these answers in turn, and keeps what it was asked."""

    name = "test"

    def __init__(self, *answers: str) -> None:
        self.answers, self.calls = list(answers), list[Call]()

    async def ask(self, call: Call) -> Reply:
        self.calls.append(call)
        return Reply(text=self.answers.pop(0), model="test")


def asked(model: Saying, about: StepQuestion, wish: str = "Keep left.") -> tuple[StepAnswer | NoAnswer, list[Attempt]]:
    attempts: list[Attempt] = []
    planner = LanguagePlanner(0, model, PromptSet.load("letters", wish=wish), on_attempt=attempts.append)
    return asyncio.run(planner.step(about)), attempts


def test_open_ways_stand_farthest_first_with_their_room() -> None:
    straight, left, right, half = ways_of(question())
    assert [straight.letter, left.letter, right.letter, half.letter] == ["S", "L", "R", "H"]
    assert straight.waypoint == pytest.approx((26.0, 20.0)) and half.waypoint == pytest.approx((23.0, 20.0))
    assert left.waypoint[1] > 20 > right.waypoint[1] and straight.progress == pytest.approx(1.0)
    assert ways_text(ways_of(question())) == "S free, L free, R free, H free"


def test_robots_obstacles_and_walls_count_in_the_room() -> None:
    ahead = ways_of(question((26.0, 18.0)))
    assert ways_text(ahead) == "L wide, R tight, H tight"
    # What counts is the whole way, not only its end.
    assert "S" not in {way.letter for way in ways_of(question((23.0, 21.0), goal=(26.5, 20.0)))}
    disc = MISSION.model_copy(update={"obstacles": (Obstacle(center=(24.0, 24.0), radius=1.0),)})
    rooms = {way.letter: way.room for way in ways_of(question(mission=disc))}
    assert "L" not in rooms and rooms["R"] == "free"
    wall = ways_of(question(position=(20.0, 1.0), goal=(80.0, 1.0)))
    assert "R" not in {way.letter for way in wall}, "it leads out of the arena"


def test_waiting_is_open_every_other_round_of_a_blocked_way() -> None:
    letters = [{w.letter for w in ways_of(question((26.0, 20.0), round=k))} for k in (1, 2, 3)]
    assert ["W" in found for found in letters] == [False, True, False]
    assert "W" not in {way.letter for way in ways_of(question(round=2))}
    assert "W" in {way.letter for way in ways_of(question((26.0, 20.0)), wait=True)}


def test_ways_in_space_turn_about_the_vertical() -> None:
    corners = ((0.0, 0.0, 0.0), (12.0, 0.0, 0.0), (0.0, 12.0, 0.0), (0.0, 0.0, 12.0))
    cube = ((0.0, 0.0, 0.0), (100.0, 100.0, 100.0))
    space = build_mission(shape="points", points=corners, n_robots=4, center=(50.0, 50.0, 50.0), arena=cube)
    plan = Plan.of(space.ideal or ())
    about = question(mission=space, position=(20.0, 20.0, 30.0), target=(80.0, 20.0, 60.0), plan=plan)
    found = {way.letter: way.waypoint for way in ways_of(about)}
    assert found["L"][2] == pytest.approx(found["S"][2]) and found["L"][1] > 20 > found["R"][1]
    assert math.dist(found["L"], about.position) == pytest.approx(space.max_step)


def test_only_a_letter_of_the_question_is_read() -> None:
    texts = ("S", " L.", "R: go", "X", "Straight", "", "s", "1 S")
    assert [read_letter(text) for text in texts] == ["S", "L", "R", None, None, None, None, None]
    open_ways = ways_of(question((26.0, 18.0)))
    assert read_way("H", open_ways).letter == "H"
    with pytest.raises(AnswerError, match="S is not among the ways; one of L, R, H is required"):
        read_way("S", open_ways)
    with pytest.raises(AnswerError, match="does not begin with a letter"):
        read_way("north", open_ways)


def test_chosen_letter_is_flown_under_a_grammar_of_open_ways() -> None:
    model = Saying("L")
    answer, attempts = asked(model, question((26.0, 18.0)))
    assert isinstance(answer, StepAnswer) and answer.by == "model"
    assert answer.waypoint == ways_of(question((26.0, 18.0)))[0].waypoint
    call = model.calls[0]
    assert [message.text for message in call.messages][1] == "Wish: Keep left.\nL wide, R tight, H tight"
    assert call.form is not None and answer_grammar("step", call.form) == 'root ::= "L" | "R" | "H"\n'
    assert longest_answer("step", call.form) == LETTER_TOKENS <= 12
    assert attempts[0].parsed == {"waypoint": list(answer.waypoint)} and attempts[0].error is None


def test_a_closed_way_is_refused_with_the_reason() -> None:
    model = Saying("S", "Left!", "H")
    answer, attempts = asked(model, question((26.0, 18.0)))
    assert isinstance(answer, StepAnswer) and [bool(attempt.rejected) for attempt in attempts] == [True, True, False]
    assert "S is not among the ways" in model.calls[1].messages[-1].text
    given_up, _ = asked(Saying("S", "S", "S"), question((26.0, 18.0)))
    assert isinstance(given_up, NoAnswer) and "one of L, R, H is required" in given_up.reason


def test_no_model_is_asked_if_there_is_nothing_to_choose() -> None:
    arrives = question(goal=(24.0, 21.0))
    answer, attempts = asked(Saying(), arrives)
    assert answer == StepAnswer(waypoint=(24.0, 21.0), by="geometry") and not attempts
    ring = [(20 + 3.2 * math.cos(a), 20 + 3.2 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 8, endpoint=False)]
    assert ways_of(question(*ring)) == ()
    shut, _ = asked(Saying(), question(*ring))
    assert isinstance(shut, StepAnswer) and shut.by == "geometry" and shut.waypoint == pytest.approx((26.0, 20.0))


def test_plans_by_geometry_are_marked() -> None:
    planner = LanguagePlanner(1, Saying(), PromptSet.load("letters"))
    answer = asyncio.run(
        planner.plan(PlanQuestion(mission=MISSION, robot=1, round=1, position=(0.0, 0.0), neighbors=()))
    )
    assert isinstance(answer, PlanAnswer) and answer.by == "geometry" and answer.slot == 1
    words = build_mission(shape="text:a boat", n_robots=3)
    unknown = asyncio.run(
        planner.plan(PlanQuestion(mission=words, robot=1, round=1, position=(0.0, 0.0), neighbors=()))
    )
    assert isinstance(unknown, NoAnswer) and "geometry knows no points" in unknown.reason


def test_run_by_letters_names_geometry_and_asks_only_letters() -> None:
    done = run(shape="circle", n_robots=5, prompts="letters", wish="Keep left.", seed=1).summary
    assert done.formed and done.simulated and (done.min_separation or 0.0) >= MISSION.safe_distance
    assert done.plan_by == "geometry" and done.waypoints["geometry"] > 0 and done.waypoints["model"] > 0
    assert done.tokens_output == done.model_calls, "an answer is one token of a stand-in"
    no_letters = run(shape="circle", n_robots=5, prompts="letters", seed=1, model="simulated:malformed").summary
    assert no_letters.formed, "geometry stands in where no letter can be read"
    assert no_letters.waypoints["model"] == 0


def test_a_wish_that_cannot_be_asked_is_refused() -> None:
    refused: tuple[tuple[dict[str, Any], str], ...] = (
        ({"wish": "Keep left."}, "wish"),
        ({"wish": "a\nb", "prompts": "letters"}, "wish"),
        ({"prompts": "letters", "answers": "json"}, "answers"),
    )
    for wrong, field in refused:
        with pytest.raises(InputError) as found:
            run(shape="circle", n_robots=5, **wrong)
        assert found.value.field == field
    assert check_wish("  Keep left. ") == "Keep left."
    with pytest.raises(InputError, match="200 characters"):
        check_wish("x" * 201)


def test_the_packaged_adapter_for_letters_is_another_file() -> None:
    pytest.importorskip("xllamacpp")
    weights, first = find_weights("smollm2+letters"), find_weights("smollm2")
    assert weights.adapter is not None and weights.adapter.name == "smollm2-letters.gguf" != first.adapter
    assert weights.model == first.model and is_packaged("smollm2+letters")
    assert weights.adapter.stat().st_size < 6e6
