"""Questions for a judgement: prompts, answers, simulated models, and whole runs."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import llm_flock
from llm_flock.errors import AnswerError, InputError, ModelError
from llm_flock.llm._answer_forms import answer_grammar, answer_schema, longest_answer
from llm_flock.llm._choices import read_choice
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import AnswerForm, Call, Reply
from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.llm._thoughts import NO_TEXT
from llm_flock.message import Choice
from llm_flock.mission import Mission
from llm_flock.planner import AIMS, JudgementAnswer, JudgementOption, JudgementQuestion, NoAnswer
from llm_flock.runtime import RunConfig, RunResult, Stream, stream

NAMES: tuple[Choice, ...] = ("leave", "close", "replan")
MISSION = Mission(shape="line", n_robots=5)


def option(choice: Choice, rounds: int, distance: float, gaps: int = 0) -> JudgementOption:
    return JudgementOption(choice=choice, does=f"Do {choice}.", rounds=rounds, distance=distance, gaps=gaps)


QUESTION = JudgementQuestion(
    mission=MISSION,
    robot=1,
    round=9,
    event="Robot 2 has failed, and nobody fills its place.",
    options=(option("leave", 0, 0.0, 1), option("close", 8, 20.0), option("replan", 6, 90.5)),
)


@pytest.mark.parametrize(
    ("answer", "choice", "reason"),
    [
        ("It is whole again soon.\n\nChoice: replan", "replan", "It is whole again soon."),
        ("**Choice:** `close`", "close", ""),
        ('{"reasoning": "It is \\"cheap\\".", "choice": "leave"}', "leave", 'It is \\"cheap\\".'),
        ("<think>Choice: leave?</think>Choice: Close.", "close", ""),
        ("Choice: close. So my final choice: close", "close", ""),
        (" replan.\n", "replan", ""),
    ],
)
def test_a_choice_is_read_with_its_reason(answer: str, choice: str, reason: str) -> None:
    read = read_choice(answer, NAMES)
    assert (read.choice, read.reason) == (choice, reason)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ("I would close up.", "it holds no choice; one of leave, close, replan is required"),
        ("Choice: NAME", "name is not among the options"),
        ("Choice: swap", "swap is not among the options"),
        ("Choice: leave\nChoice: close", "it chooses close and leave"),
        ("<think>Choice: leave", "nothing but thoughts"),
        (NO_TEXT, "it holds no choice"),
    ],
)
def test_what_is_no_choice_is_refused_with_the_reason(answer: str, says: str) -> None:
    with pytest.raises(AnswerError, match=says):
        read_choice(answer, NAMES)


def test_the_question_names_options_figures_and_what_counts() -> None:
    text = PromptSet.load().judgement(QUESTION)
    assert "- replan: Do replan. Rounds: 6; flying: 90.5 units; empty places: 0; robots lost: 0." in text
    assert f"after that, {next(iter(AIMS))}" in text and text.endswith("Choice: NAME")
    asked = PromptSet.load(json=True, wish="the children must not be frightened.").judgement(QUESTION)
    assert "after that, the children must not be frightened." in asked and '"choice": "..."' in asked
    retry = PromptSet.load("brief").retry("it holds no choice.", QUESTION)
    assert retry.startswith("This answer cannot be used: it holds no choice.") and retry.endswith(text)


def test_forms_hold_the_names_of_the_options() -> None:
    form = AnswerForm(n=5, dim=2, choices=NAMES)
    assert answer_schema("judgement", form)["properties"]["choice"] == {"type": "string", "enum": [*NAMES]}
    grammar = answer_grammar("judgement", form)
    assert '"Choice: " ("leave" | "close" | "replan")' in grammar
    assert '"choice\\": \\""' in answer_grammar("judgement", AnswerForm(n=5, dim=2, json=True, choices=NAMES))
    assert longest_answer("judgement", form) < 300


class Scripted:
    """A *simulated* model that gives these answers in turn."""

    name, simulated = "scripted", True

    def __init__(self, *answers: str) -> None:
        self.answers, self.calls = [*answers], list[Call]()

    async def ask(self, call: Call) -> Reply:
        self.calls.append(call)
        return Reply(text=self.answers.pop(0), model=self.name)


def judged(
    model: Any, prompts: PromptSet | None = None, asked: JudgementQuestion = QUESTION
) -> JudgementAnswer | NoAnswer:
    return asyncio.run(LanguagePlanner(1, model, prompts or PromptSet.load()).judge(asked))


def test_an_unusable_answer_goes_back_with_the_reason() -> None:
    model = Scripted("Hm.", "It is quick.\nChoice: replan")
    assert judged(model) == JudgementAnswer(choice="replan", reason="It is quick.")
    assert [call.kind for call in model.calls] == ["judgement", "judgement"]
    assert "it holds no choice" in model.calls[1].messages[-1].text
    assert isinstance(judged(Scripted("Hm.", "Hm, hm.", "Hm!")), NoAnswer)


def test_the_letter_prompts_have_no_judgement() -> None:
    answer = judged(Scripted(), PromptSet.load("letters"))
    assert isinstance(answer, NoAnswer) and "letters" in answer.reason


def simulated(profile: str, robot: int = 0) -> SimulatedModel:
    return SimulatedModel(parse_profile(profile), stream(3, Stream.MODEL, 0 if "alike" in profile else robot))


@pytest.mark.parametrize(("aim", "choice"), [*zip(AIMS, ("replan", "leave", "leave"), strict=True)])
def test_a_good_stand_in_chooses_by_what_counts(aim: str, choice: str) -> None:
    for json_ in (False, True):
        answer = judged(simulated("ideal"), PromptSet.load(json=json_, wish=aim))
        assert isinstance(answer, JudgementAnswer)
        assert answer.choice == choice and answer.reason.startswith("Of 3 options I prefer")


def test_bad_stand_ins_choose_something_else() -> None:
    found = [judged(simulated("misjudge", robot)) for robot in range(12)]
    assert {one.choice for one in found if isinstance(one, JudgementAnswer)} == {"leave", "close"}
    alike = [judged(simulated("alike,misjudge", robot)) for robot in range(6)]
    assert len({one.choice for one in alike if isinstance(one, JudgementAnswer)}) == 1
    chance = [judged(simulated("random", robot)) for robot in range(24)]
    assert {one.choice for one in chance if isinstance(one, JudgementAnswer)} == {*NAMES}
    assert isinstance(judged(simulated("malformed")), NoAnswer)


def test_a_stand_in_reads_no_wish_in_free_words() -> None:
    answer = judged(simulated("ideal"), PromptSet.load(wish="be gentle."))
    assert isinstance(answer, NoAnswer) and answer.cause == "refused"
    with pytest.raises(ModelError, match="cannot read the wish"):
        simulated("ideal").answer([("user", PromptSet.load(wish="be gentle.").judgement(QUESTION))])
    with pytest.raises(InputError, match=r"judgement\.j2"):
        simulated("ideal").answer([("user", "Something has come up: rain.")])


def test_an_order_says_what_counts() -> None:
    least = [*AIMS][2]
    for words, choice in ((least, "leave"), ("close: robot 3", "close"), ("close robot 3", None), ("spare", None)):
        asked = replace(QUESTION, words=words)
        text = PromptSet.load(wish="be gentle.").judgement(asked)
        assert text.count(words) == 1 and "be gentle" not in text
        answer = judged(simulated("ideal"), PromptSet.load(wish="be gentle."), asked)
        assert getattr(answer, "choice", None) == choice


def test_a_folder_may_replace_the_question(tmp_path: Any) -> None:
    (tmp_path / "judgement.j2").write_text("{{ event }} {{ aim }} {{ choices }}", encoding="utf-8")
    text = PromptSet.load(tmp_path).judgement(QUESTION)
    assert text.startswith("Robot 2 has failed") and text.endswith("leave, close, replan")


class Events:
    """Keeps the events of a run."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, str, Any]] = []

    def write(self, entry: Any) -> None:
        if type(entry).__name__ == "ProtocolEvent":
            self.seen.append((entry.robot, entry.kind, entry.detail))

    def of(self, kind: str, about: str) -> dict[int, Any]:
        return {j: detail for j, one, detail in self.seen if one == kind and detail.get("about") == about}


def fly(shape: str, n: int, **options: Any) -> tuple[RunResult, Events]:
    events = Events()
    mission: dict[str, Any] = {"shape": shape, "n_robots": n, "comm_range": 60.0} | options.pop("mission", {})
    options.setdefault("judge", "models")
    flown = llm_flock.run(llm_flock.Mission(**mission), sink=events, **options)
    return flown, events


@pytest.mark.parametrize("decide", ["every-round", "on-event"])
def test_a_team_plans_again_because_its_models_choose_to(decide: str) -> None:
    flown, events = fly("circle", 6, seed=4, kill="2@6", decide=decide)
    agreed, judged_ = events.of("agreed", "death"), events.of("judged", "death")
    assert {one["choice"] for one in agreed.values()} == {"replan"} and len(agreed) == len(judged_) == 5
    assert sum(kind == "judged" for _, kind, _ in events.seen) == 5  # each robot was asked once
    assert flown.summary.formed and flown.summary.gaps == 0
    assert all(plan is not None and len(plan) == 5 for j, plan in enumerate(flown.plans) if j != 2)


def test_a_team_leaves_the_gap_where_little_flying_counts() -> None:
    aim = [*AIMS][2]
    flown, events = fly("circle", 6, seed=4, kill="2@20", wish=aim)
    assert {one["choice"] for one in events.of("agreed", "death").values()} == {"leave"}
    assert flown.summary.gaps == 1


def test_a_spare_robot_takes_the_place_of_a_weak_one() -> None:
    mission = {"places": 6}
    left, asleep = fly("circle", 7, seed=2, battery="2@2:6", judge="rule", mission=mission)
    assert asleep.of("incident", "battery") == {} and left.summary.killed
    flown, events = fly("circle", 7, seed=2, battery="2@2:6", mission=mission)
    assert {one["choice"] for one in events.of("agreed", "battery").values()} == {"spare"}
    assert not flown.summary.killed and flown.summary.formed and flown.slots[2] is None


def test_models_that_do_not_answer_leave_it_to_the_configuration() -> None:
    model = "0-5=simulated:malformed"
    flown, events = fly("circle", 6, seed=4, kill="2@6", gaps="replan", model=model, fallback="geometry")
    assert {one["choice"] for one in events.of("agreed", "death").values()} == {None}
    fallbacks = [one for _, kind, one in events.seen if kind == "fallback" and one["question"] == "judgement"]
    assert len(fallbacks) == 5 and flown.summary.gaps == 0
    _, events = fly("circle", 6, seed=4, kill="2@6", model="geometry")
    assert {one["choice"] for one in events.of("agreed", "death").values()} == {None}


def test_an_empty_battery_stops_the_body_where_it_is() -> None:
    flown, _ = fly("circle", 6, seed=4, battery="2@1:7.5", judge="rule", rounds=20, stop_when_formed=False)
    ways = flown.positions[1:, 2] - flown.positions[:-1, 2]
    assert sum((ways**2).sum(axis=1) ** 0.5) == pytest.approx(7.5)
    assert flown.summary.killed == ("2@3",)


HURRY: dict[str, Any] = {"judge": "models"}


def test_a_team_waits_and_goes_on_as_it_is_ordered() -> None:
    words = ((3, "wait"), (12, "continue"))
    changes = [{"round": when, "robot": 0, "words": said} for when, said in words]
    flown, events = fly("circle", 6, seed=4, changes=changes, stop_when_formed=False, rounds=30)
    ways = np.linalg.norm(np.diff(flown.positions, axis=0), axis=2).max(axis=1)
    assert [one["words"] for _, kind, one in events.seen if kind == "order"] == ["wait", "continue"]
    assert {one["choice"] for one in events.of("agreed", "order").values()} == {"continue"}
    assert ways[5:12].max() < 1e-9 < 1.0 < ways[14:].max() and flown.formed


def test_a_robot_that_an_order_names_gets_a_rest() -> None:
    change = {"round": 12, "robot": 0, "words": "spare: robot 2"}
    flown, events = fly("circle", 6, seed=4, changes=[change], mission={"places": 5})
    assert {one["choice"] for one in events.of("agreed", "order").values()} == {"spare"}
    assert flown.slots[2] is None and flown.formed


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"battery": "3@12"}, "ID@ROUND:LENGTH"),
        ({"battery": "3@12:x"}, "ID@ROUND:LENGTH"),
        ({"battery": "3@12:-4"}, "ID@ROUND:LENGTH"),
        ({"battery": "30@12:4"}, "there is no robot 30"),
        ({"battery": "3@12:4", "kill": "3@5"}, "a robot that is awake in round 12"),
        ({"changes": [{"round": 3, "robot": 0, "words": "hurry"}]}, "'models', who judge the orders"),
        (HURRY | {"changes": [{"round": 3, "robot": 0, "words": "h" * 129}]}, "words of at most 128 bytes"),
        (HURRY | {"changes": [{"round": 3, "robot": 0, "words": "now", "set": {"spacing": 9}}]}, "set, or words"),
        ({"changes": [{"round": 3, "robot": 0}]}, "set, or words"),
        (HURRY | {"changes": [{"round": 3, "robot": 30, "words": "now"}]}, "a robot from 0 to 9"),
        (HURRY | {"changes": [{"round": 3, "robot": 0, "words": "now"}] * 17}, "at most 16 orders in words"),
        ({"judge": "models", "protocol": "paper"}, "'rule' unless places are given by the auction"),
    ],
)
def test_impossible_batteries_and_judges_are_errors(fields: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        RunConfig.build(**fields)


def test_several_batteries_are_read() -> None:
    schedule = RunConfig.build(battery="3@12:40, 5@12:8.5,1@2:0").schedule()
    assert schedule.weak == {12: ((3, 40.0), (5, 8.5)), 2: ((1, 0.0),)} and schedule.last == 12
