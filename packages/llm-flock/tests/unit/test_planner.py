"""The conversation: asking again, what is kept, what is told to the sink, and that robots share nothing."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from llm_flock.errors import BudgetExceeded, InputError, ModelError, ReplayDrift
from llm_flock.llm._models import parse_history
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import Attempt, Call, Reply, Usage
from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._replay import CassetteWriter, ReplayModel
from llm_flock.llm._thoughts import MAX_QUOTED, NO_TEXT
from llm_flock.mission import build_mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._verification.steps import Verdict

MISSION = build_mission(shape="triangle", n_robots=3)
PROMPTS = PromptSet.load()
POINTS = [[50.0, 55.77], [45.0, 47.11], [55.0, 47.11]]
PLAN_TEXT = f"Plan: {POINTS}\nmy plan: 2"


class Scripted:
    """A language model that says what it was given to say, and remembers what it was asked."""

    name = "scripted:one"

    def __init__(self, *script: str | Exception | Reply) -> None:
        self.script = list(script)
        self.calls: list[Call] = []

    async def ask(self, call: Call) -> Reply:
        self.calls.append(call)
        said = self.script.pop(0)
        if isinstance(said, Exception):
            raise said
        if isinstance(said, Reply):
            return said
        return Reply(text=said, model=self.name, latency_s=0.25, faults=("timeout",))


def planner(model: Any, robot: int = 0, **options: Any) -> tuple[LanguagePlanner, list[Attempt]]:
    heard: list[Attempt] = []
    prompts = PromptSet.load(json=True) if options.pop("answers", "text") == "json" else PROMPTS
    return LanguagePlanner(robot, model, prompts, on_attempt=heard.append, **options), heard


def plan_question(round_: int = 1, robot: int = 0) -> PlanQuestion:
    return PlanQuestion(mission=MISSION, robot=robot, round=round_, position=(1.0, 2.0), neighbors=())


def step_question(round_: int = 1, robot: int = 0, x: float = 1.0) -> StepQuestion:
    return StepQuestion(
        mission=MISSION, robot=robot, round=round_, position=(x, 2.0), neighbors=(), plan=Plan.of(POINTS), slot=2
    )


def roles(call: Call) -> str:
    return "".join(message.role[0] for message in call.messages)


def test_one_good_answer_is_one_call() -> None:
    model = Scripted(PLAN_TEXT)
    thinker, heard = planner(model)
    answer = asyncio.run(thinker.plan(plan_question()))
    assert answer == PlanAnswer(plan=Plan.of(POINTS), slot=2)
    (attempt,) = heard
    assert attempt.parsed == {"plan": POINTS, "slot": 2} and attempt.rejected is None and attempt.error is None
    assert (attempt.call.attempt, attempt.reply.latency_s, attempt.reply.faults) == (0, 0.25, ("timeout",))
    assert attempt.call.schema is None and roles(attempt.call) == "su"
    assert attempt.call.messages[0].text == PROMPTS.system(MISSION)


def test_a_rejected_answer_goes_back_with_the_reason() -> None:
    model = Scripted("Plan: [[1, 2]]\nmy plan: 0", "", PLAN_TEXT)
    thinker, heard = planner(model)
    assert isinstance(asyncio.run(thinker.plan(plan_question())), PlanAnswer)
    assert [roles(call) for call in model.calls] == ["su", "suau", "suauau"]
    assert [call.attempt for call in model.calls] == [0, 1, 2]
    last = [message.text for message in model.calls[-1].messages]
    assert last[2] == "Plan: [[1, 2]]\nmy plan: 0" and "the plan holds 1 point, 3 are required" in last[3]
    assert last[4] == NO_TEXT and "no complete plan" in last[5]
    assert heard[0].rejected == "the plan holds 1 point, 3 are required." and heard[0].parsed is None
    assert heard[2].rejected is None


def reply(text: str, reason: str | None = "length", **fields: Any) -> Reply:
    return Reply(text=text, model="scripted:one", finish_reason=reason, **fields)


CAPPED = {"max_tokens": 64}
USED = Usage(input=300, output=64)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (
            reply("Position: [51.2, 4", usage=USED),
            "it was cut off at 64 tokens before it was complete; answer more brief",
        ),
        (reply("Position: [1, 2]", usage=USED), "it was cut off at 64 tokens before it was complete"),
        (reply("Position: [x, y]\nPosition: [x, y]"), "it copies the form: put numbers in place of x and y"),
        (reply("I go. " + "I go to the goal. " * 9), "it says the same again and again"),
        (
            reply("Give your reason in a sentence or two, and finish with this line, numbers only:\n"),
            "it repeats the question: give only the answer",
        ),
        (reply("Position: [1, 2]"), "it was cut off before it was complete"),
        (reply("", usage=USED, settings=CAPPED), "thought but did not answer (a cap of 64 tokens"),
        (reply("<think>Position: [1, 2]", usage=USED), "it was cut off at 64 tokens while you were still thinking"),
        (reply("<think>Position: [1, 2]", "stop"), "nothing but thoughts: you thought but did not answer; think less"),
        (reply("", "stop", thought=True), "nothing but thoughts: you thought but did not answer"),
        (
            reply(" ", None, thought=True, settings=CAPPED),
            "(a cap of 64 tokens for thoughts and answer together may be",
        ),
        (reply("Position: [1, 2]", "content_filter"), "content filter stopped it"),
        (reply("", "stop", settings=CAPPED), "it holds no complete position"),
    ],
)
def test_cut_off_or_thought_only_reply_is_no_answer(answer: Reply, reason: str) -> None:
    model = Scripted(answer, reply("Position: [3, 2]", "stop"))
    thinker, heard = planner(model)
    asked = replace(step_question(), position=(1.0, 2.0))
    got = asyncio.run(thinker.step(asked))
    assert isinstance(got, StepAnswer) and got.waypoint == (3.0, 2.0)
    assert heard[0].rejected is not None and reason in heard[0].rejected and heard[0].parsed is None
    assert reason in model.calls[1].messages[3].text and "Position: [x, y]" in model.calls[1].messages[3].text
    assert heard[0].reply == answer


def test_thoughts_do_not_go_back_to_the_model() -> None:
    model = Scripted("<think>Position: [5, 0]", "<think>Position: [5, 0]</think> I stay.", "Position: [3, 2]")
    thinker, _ = planner(model)
    assert isinstance(asyncio.run(thinker.step(step_question())), StepAnswer)
    texts = [message.text for message in model.calls[2].messages if message.role == "assistant"]
    assert texts == [NO_TEXT, " I stay."]


@pytest.mark.parametrize("retries", [0, 1, 4])
def test_after_too_many_tries_there_is_no_answer(retries: int) -> None:
    model = Scripted(*["no idea"] * (retries + 1))
    thinker, heard = planner(model, max_retries=retries)
    answer = asyncio.run(thinker.step(step_question()))
    assert isinstance(answer, NoAnswer) and answer.cause == "answer"
    assert f"{retries + 1} tr" in answer.reason and "no complete position" in answer.reason
    assert len(heard) == retries + 1 and not model.script


def test_a_repeated_answer_is_not_asked_for_in_the_same_words() -> None:
    model = Scripted("no idea", "no idea", "Position: [1, 2]")
    thinker, heard = planner(model, max_retries=2)
    asyncio.run(thinker.step(step_question()))
    first, second = (attempt.call.messages[-1].text for attempt in heard[1:3])
    assert first != second and "the same answer before, word for word" in second


def test_a_repeated_answer_at_temperature_zero_is_the_last() -> None:
    said = Reply(text="no idea", model="scripted:one", settings={"temperature": 0.0})
    model = Scripted(said, said, "Position: [1, 2]")
    thinker, heard = planner(model, max_retries=2)
    answer = asyncio.run(thinker.step(step_question()))
    assert isinstance(answer, NoAnswer) and "in 2 tries" in answer.reason and len(heard) == 2


@pytest.mark.parametrize(
    ("error", "cause"),
    [(ModelError("server", "500", faults=("server", "server")), "server"), (BudgetExceeded("max_calls"), "budget")],
)
def test_failing_provider_is_no_answer_and_is_reported(error: ModelError, cause: str) -> None:
    thinker, heard = planner(Scripted("nothing", error))
    answer = asyncio.run(thinker.step(step_question()))
    assert isinstance(answer, NoAnswer) and answer.cause == cause and error.detail in answer.reason
    assert heard[1].error == (cause, error.detail) and heard[1].reply.faults == error.faults
    assert heard[1].reply.text == "" and heard[1].reply.model == "scripted:one"


def test_a_drifting_replay_is_not_swallowed() -> None:
    thinker, _ = planner(Scripted(ReplayDrift("other question")))
    with pytest.raises(ReplayDrift, match="other question"):
        asyncio.run(thinker.step(step_question()))


def test_attempts_are_numbered_per_round_over_both_questions() -> None:
    model = Scripted("hm", PLAN_TEXT, "Position: [1, 2]", "Position: [3, 4]", ModelError("server", ""), PLAN_TEXT)
    thinker, _ = planner(model)

    async def talk() -> None:
        await thinker.plan(plan_question(1))
        await thinker.step(step_question(1))
        await thinker.step(step_question(2))
        await thinker.step(step_question(3))
        await thinker.plan(plan_question(3))

    asyncio.run(talk())
    assert [(c.round, c.attempt) for c in model.calls] == [(1, 0), (1, 1), (1, 2), (2, 0), (3, 0), (3, 1)]


@pytest.mark.parametrize(
    ("history", "seen"),
    [("none", [0, 0, 0, 0]), ("last:1", [0, 1, 1, 1]), ("last:2", [0, 1, 2, 2]), ("full", [0, 1, 2, 3])],
)
def test_history_keeps_accepted_exchanges_only(history: str, seen: Sequence[int]) -> None:
    model = Scripted(PLAN_TEXT, "rubbish", "Position: [1, 1]", "Position: [2, 2]", "Position: [3, 3]")
    thinker, _ = planner(model, history=parse_history(history))

    async def talk() -> None:
        await thinker.plan(plan_question(1))
        for round_ in (1, 2, 3):
            await thinker.step(step_question(round_, x=round_))

    asyncio.run(talk())
    first_tries = [call for call in model.calls if "rubbish" not in call.messages[-2].text]
    assert [(len(call.messages) - 2) // 2 for call in first_tries] == seen
    assert all(roles(call) == "s" + "ua" * ((len(call.messages) - 2) // 2) + "u" for call in first_tries)
    assert not any("rubbish" in message.text for call in first_tries for message in call.messages)
    if history == "full":
        told = [message.text for message in first_tries[-1].messages if message.role == "assistant"]
        assert told == [PLAN_TEXT, "Position: [1, 1]", "Position: [2, 2]"]


@pytest.mark.parametrize(("text", "exchanges"), [("none", 0), ("full", None), ("last:1", 1), ("last:30", 30)])
def test_history_options(text: str, exchanges: int | None) -> None:
    assert parse_history(text) == exchanges


@pytest.mark.parametrize("text", ["", "last", "last:", "last:0", "last:-1", "last:x", "last:\u0661", "all", "none:1"])
def test_history_options_that_do_not_exist(text: str) -> None:
    with pytest.raises(InputError, match="none, full, or last:K"):
        parse_history(text)


def test_json_answers_come_with_a_schema() -> None:
    model = Scripted(json.dumps({"plan": POINTS, "my_plan": 2}), '{"position": [1, 2]}')
    thinker, _ = planner(model, answers="json")
    assert asyncio.run(thinker.plan(plan_question())) == PlanAnswer(plan=Plan.of(POINTS), slot=2)
    assert asyncio.run(thinker.step(step_question())) == StepAnswer(waypoint=(1.0, 2.0))
    for call, field in zip(model.calls, ("plan", "position"), strict=True):
        assert call.schema is not None and field in call.schema["properties"]


@pytest.mark.parametrize("form", ["text", "json"])
def test_path_is_read_if_several_waypoints_may_be_given(form: str) -> None:
    said = '{"path": [[1, 2], [3, 4]]}' if form == "json" else "Path: [[1, 2], [3, 4]]"
    model = Scripted("Path: [[1, 2], [3, 4], [5, 6]]", said)
    thinker, heard = planner(model, answers=form)
    question = replace(step_question(), horizon=2)
    assert asyncio.run(thinker.step(question)) == StepAnswer(waypoint=(1.0, 2.0), path=((3.0, 4.0),))
    assert heard[0].rejected == "the path holds 3 positions, 1 to 2 are required."
    assert heard[1].parsed == {"waypoint": [1.0, 2.0], "path": [[3.0, 4.0]]}
    assert all((call.schema is None) == (form == "text") for call in model.calls)
    if form == "json":
        assert (model.calls[0].schema or {})["properties"]["path"]["maxItems"] == 2


def test_check_gives_the_model_its_reason_as_text() -> None:
    def too_far(question: StepQuestion, answer: StepAnswer) -> Verdict:
        long = answer.waypoint[0] > question.position[0] + 6
        return Verdict(reason="the step is too long." if long else None, fit=None)

    def off_center(question: PlanQuestion, answer: PlanAnswer) -> str | None:
        return f"robot {question.robot}: the centre is off." if answer.slot == 0 else None

    model = Scripted("Position: [9, 2]", "Position: [7, 2]", f"Plan: {POINTS}\nmy plan: 0", PLAN_TEXT)
    thinker, heard = planner(model, judge=too_far, check_plan=off_center)
    assert asyncio.run(thinker.step(step_question())) == StepAnswer(waypoint=(7.0, 2.0))
    assert isinstance(asyncio.run(thinker.plan(plan_question())), PlanAnswer)
    reasons = ["the step is too long.", None, "robot 0: the centre is off.", None]
    assert [attempt.rejected for attempt in heard] == reasons
    assert [attempt.parsed is None for attempt in heard] == [True, False, True, False]
    assert "the step is too long." in model.calls[1].messages[-1].text


def test_a_runaway_answer_is_repeated_in_part_only() -> None:
    model = Scripted("x" * 1_000_001, "Position: [1, 2]")
    thinker, heard = planner(model)
    asyncio.run(thinker.step(step_question()))
    assert len(model.calls[1].messages[2].text) == MAX_QUOTED
    assert heard[0].reply is not None and len(heard[0].reply.text) == 1_000_001


def test_robots_share_no_memory() -> None:
    """Two robots of one team, the same prompts object, all the history there is, questions interleaved."""
    secrets = ("ALPHA", "OMEGA")
    models = [Scripted(*[f"{secret} {k}\nPosition: [{k}, {k}]" for k in range(5)]) for secret in secrets]
    thinkers = [planner(model, robot, history=None)[0] for robot, model in enumerate(models)]

    async def talk() -> None:
        for round_ in range(5):
            for robot in (0, 1):
                await thinkers[robot].step(step_question(round_, robot, x=1000.0 * (robot + 1) + round_))

    asyncio.run(talk())
    for robot, model in enumerate(models):
        text = "\n".join(message.text for call in model.calls for message in call.messages)
        assert all(call.robot == robot for call in model.calls)
        assert secrets[robot] in text and f"{1000 * (robot + 1)}.000" in text
        assert secrets[1 - robot] not in text and f"{1000 * (2 - robot)}.000" not in text


def test_a_recorded_conversation_replays_call_for_call(tmp_path: Path) -> None:
    async def talk(thinker: LanguagePlanner) -> list[object]:
        return [await thinker.plan(plan_question(1)), await thinker.step(step_question(1)),
                await thinker.step(step_question(2))]  # fmt: skip

    script = ["hm", PLAN_TEXT, ModelError("server", "500", faults=("server",)), "Position: [3, 4]"]
    first: list[Attempt] = []
    with CassetteWriter(tmp_path / "c.jsonl") as cassette:
        record: Callable[[Attempt], None] = lambda attempt: (first.append(attempt), cassette(attempt))[0]  # noqa: E731
        told = asyncio.run(talk(LanguagePlanner(0, Scripted(*script), PROMPTS, on_attempt=record)))
    with ReplayModel(tmp_path / "c.jsonl") as replay:
        again, heard = planner(replay)
        assert asyncio.run(talk(again)) == told
    assert [(a.call, a.parsed, a.rejected, a.error, a.reply.faults) for a in heard] == [
        (a.call, a.parsed, a.rejected, a.error, a.reply.faults) for a in first
    ]


def test_the_question_says_how_many_places_a_plan_has() -> None:
    question = replace(plan_question(), mission=MISSION.change(shape="line", places=2))
    two = "Plan: [[1, 2], [3, 4]]\nmy plan: 0"
    model = Scripted(PLAN_TEXT, two)
    answer = asyncio.run(planner(model)[0].plan(question))
    assert isinstance(answer, PlanAnswer) and len(answer.plan) == 2
    assert "the plan holds 3 points, 2 are required" in model.calls[1].messages[-1].text
    assert "Places: 2 for 3 robots" in model.calls[0].messages[0].text
    model = Scripted(two)
    asyncio.run(planner(model, answers="json")[0].plan(question))
    schema = model.calls[0].schema
    assert schema is not None and schema["properties"]["plan"]["maxItems"] == 2


def test_new_mission_not_travel_begins_a_new_conversation() -> None:
    moving = MISSION.change(velocity=(1, 0))
    missions = [MISSION, MISSION, moving, moving.at(3), moving.at(4), moving.change(velocity=(1, 1)), MISSION]
    model = Scripted(*["Position: [1, 2]"] * len(missions))
    thinker, _ = planner(model, history=None)

    async def talk() -> None:
        for mission in missions:
            await thinker.step(replace(step_question(), mission=mission))

    asyncio.run(talk())
    assert [len(call.messages) // 2 - 1 for call in model.calls] == [0, 1, 0, 1, 2, 0, 0]
    assert "[54, 50]" in model.calls[4].messages[0].text
