"""Ask one question: through the planner of a robot, with its prompts, parsers and checks, and score the answers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from llm_flock.errors import ModelError
from llm_flock.llm import (
    REASONING,
    Attempt,
    Call,
    ChatMessage,
    FrameName,
    LanguageModel,
    LanguagePlanner,
    PromptSet,
    Reply,
    drawn_program,
    edit_call,
    frame_plan,
    frame_step,
    mission_call,
    place_text,
)
from llm_flock.mission import Mission
from llm_flock.planner import (
    JudgementAnswer,
    JudgementQuestion,
    NoAnswer,
    PlanAnswer,
    PlanQuestion,
    StepAnswer,
    StepQuestion,
)
from llm_flock.protocol import GeometryPlanner, Verdict
from llm_flock.protocol import judge as judge_step
from llm_flock_lab._exam.questions import Question
from llm_flock_lab._exam.score import (
    Marks,
    objection_to_plan,
    plan_marks,
    shortfall,
    step_marks,
    word_marks,
)

SCRIPT = "exam:script"  # name of the model of answers that are put into a model's mouth

SAID = "I have worked it out."


Usable: TypeAlias = PlanAnswer | StepAnswer | JudgementAnswer
Asked: TypeAlias = PlanQuestion | StepQuestion | JudgementQuestion


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The result of one question, once; `readable`, `flyable`, `error` and `reason` are those of its first answer."""

    question: str
    section: str
    tags: tuple[str, ...]
    n: int
    distance: float | None
    repeat: int
    tries: int | None  # reasons given before the answer was right; None if it never was
    readable: bool
    flyable: bool  # as it is; for words: whether nothing wrong would be shown to people
    error: float | None = None
    calls: int
    tokens_input: int
    tokens_output: int
    seconds: float  # waits for faults of the provider included
    cost_usd: float | None  # None where the price is not known
    answered_by: str | None = None
    cause: str | None = None  # kind of the fault where no answer came
    reason: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Asked:
    """The result of one robot: its accepted answer, its calls without scripted ones, and its first answer."""

    answer: Usable | NoAnswer
    attempts: Sequence[Attempt] = ()
    first: Usable | None = None


class Scripted:
    """A `LanguageModel` that gives fixed answers first, and asks another one from then on."""

    def __init__(self, model: LanguageModel, texts: tuple[str, ...]) -> None:
        self.name = model.name
        self._model = model
        self._texts = list(texts)

    async def ask(self, call: Call) -> Reply:
        if self._texts:
            return Reply(text=self._texts.pop(0), model=SCRIPT, cost_usd=0.0)
        return await self._model.ask(call)


def round_of(question: Question, repeat: int) -> int:
    """The number of a question's calls in any selection: recordings find them by it, stand-ins draw chance from it."""
    section, _, number = question.id.rpartition("-")
    place = int.from_bytes(hashlib.blake2b(section.encode(), digest_size=1).digest()) * 1000 + int(number)
    return repeat * 1_000_000 + place


class Examiner:
    """Asks questions with one set of prompts, in the coordinates of a frame; a refused answer is sent back with why."""

    def __init__(self, prompts: PromptSet, frame: FrameName, *, max_retries: int = 2) -> None:
        self._prompts = prompts
        self._frame: FrameName = frame
        self._retries = max_retries

    def first_messages(self, question: Question) -> Iterator[tuple[ChatMessage, ...]]:
        """The first messages to a model, for each robot that is asked, without scripted answers."""
        if question.words is not None:
            yield self._call_of(question).messages
            return
        mission = question.build_mission()
        for robot in question.robots:
            if question.options:
                system = self._prompts.system(mission)
                user = self._wishing(question).judgement(question.judgement_question(mission, 0))
            elif question.asks_plan:
                plan = frame_plan(question.plan_question(mission, robot, 0), self._frame).framed
                system, user = self._prompts.system(plan.mission), self._prompts.plan(plan)
            else:
                step = frame_step(question.step_question(mission, 0), self._frame).framed
                system, user = self._prompts.system(step.mission), self._prompts.step(step)
            yield ChatMessage("system", system), ChatMessage("user", user)

    def prompts_digest(self, questions: Sequence[Question]) -> str:
        """16 hexadecimal digits that identify all prompts of these questions."""
        found = hashlib.blake2b(digest_size=8)
        for question in questions:
            for messages in self.first_messages(question):
                found.update("\0".join(message.text for message in messages).encode())
        return found.hexdigest()

    async def ask(self, question: Question, model: LanguageModel | None, repeat: int = 0) -> Outcome:
        """Ask a question for the `repeat`-th time, and score what comes back; without a model, geometry answers."""
        round_ = round_of(question, repeat)
        if question.words is not None:
            return await self._ask_words(question, model, round_, repeat)
        mission = question.build_mission()
        asked = [await self._ask_robot(question, mission, robot, model, round_) for robot in question.robots]
        return _outcome(question, mission, asked, repeat)

    async def _ask_robot(
        self, question: Question, mission: Mission, robot: int, model: LanguageModel | None, round_: int
    ) -> _Asked:
        attempts: list[Attempt] = []
        seen: list[PlanAnswer | StepAnswer] = []
        first: PlanAnswer | StepAnswer | None = None
        asked: Asked
        if question.options:
            asked = question.judgement_question(mission, round_)
        elif question.asks_plan:
            asked = question.plan_question(mission, robot, round_)
        else:
            asked = question.step_question(mission, round_)

        def check_plan(given: PlanQuestion, answer: PlanAnswer) -> str | None:
            if given is asked:
                seen.append(answer)
            # Which place robots choose is asked apart from whether their plans are right.
            return None if question.section == "place" else objection_to_plan(given, answer)

        def judge(given: StepQuestion, answer: StepAnswer) -> Verdict:
            if given is asked:
                seen.append(answer)
            return judge_step(given, answer, shield_on=True)

        def note(attempt: Attempt) -> None:
            nonlocal first
            if attempt.reply.model == SCRIPT:
                seen.clear()
                return
            attempts.append(attempt)
            if len(attempts) == 1:
                # The checks have seen the answer, if it could be read.
                first = next(iter(seen), None)

        if model is None:
            return await _by_geometry(asked, check_plan, judge)
        with_history = question.own is not None and self._frame == "world"
        planner = LanguagePlanner(
            robot,
            Scripted(model, self._script(question, mission, robot, round_)),
            self._wishing(question),
            max_retries=self._retries + (question.first is not None),
            history=None if with_history else 0,
            on_attempt=note,
            check_plan=check_plan,
            judge=judge,
            frame=self._frame,
        )
        if with_history:
            await planner.plan(question.plan_question(mission, robot, round_))
        if isinstance(asked, JudgementQuestion):
            answer = await planner.judge(asked)
            chosen = None if isinstance(answer, NoAnswer) or len(attempts) > 1 else answer
            return _Asked(answer=answer, attempts=attempts, first=chosen)
        answer = await (planner.plan(asked) if isinstance(asked, PlanQuestion) else planner.step(asked))
        return _Asked(answer=answer, attempts=attempts, first=first)

    def _wishing(self, question: Question) -> PromptSet:
        return self._prompts if question.wish is None else replace(self._prompts, wish=question.wish)

    def _script(self, question: Question, mission: Mission, robot: int, round_: int) -> tuple[str, ...]:
        """The answers to put into the model's mouth, in the frame and the form of the prompts."""
        if question.own is not None and self._frame == "world":
            return (self._plan_text(question.own, question, mission, robot, round_),)
        if question.first is None:
            return ()
        if "text" in question.first:
            return (question.first["text"],)
        if "plan" in question.first:
            return (self._plan_text(question.first, question, mission, robot, round_),)
        framed = frame_step(question.step_question(mission, round_), self._frame).frame
        waypoint = question.first["waypoint"]
        place = place_text(waypoint if framed is None else framed.rounded(waypoint))
        return (self._word_answer(f"Position: {place}", {"position": json.loads(place)}),)

    def _plan_text(
        self, reply: Mapping[str, Any], question: Question, mission: Mission, robot: int, round_: int
    ) -> str:
        framed = frame_plan(question.plan_question(mission, robot, round_), self._frame).frame
        rows = reply["plan"] if framed is None else [framed.rounded(point) for point in reply["plan"]]
        plan = f"[{', '.join(map(place_text, rows))}]"
        lines = f"Plan: {plan}\nmy plan: {reply['slot']}"
        return self._word_answer(lines, {"plan": json.loads(plan), "my_plan": reply["slot"]})

    def _word_answer(self, lines: str, fields: dict[str, Any]) -> str:
        """An answer in the form that the prompts ask for."""
        if self._prompts.json:
            return json.dumps({REASONING: SAID, **fields} if self._prompts.reasons else fields)
        return f"{SAID}\n\n{lines}" if self._prompts.reasons else lines

    async def _ask_words(self, question: Question, model: LanguageModel | None, round_: int, repeat: int) -> Outcome:
        """Ask once for a mission or an edit in words; geometry reads none."""
        if model is None:
            return _score(question, repeat, [], tries=None, marks=None, cause=None, reason="geometry reads no words.")
        call = replace(self._call_of(question), round=round_)
        try:
            reply = await model.ask(call)
        except ModelError as error:
            attempt = Attempt.failed(call, error, model.name)
            return _score(question, repeat, [attempt], tries=None, marks=None, cause=error.kind, reason=str(error))
        marks = word_marks(question, reply.text)
        attempt = Attempt(call=call, reply=reply, rejected=marks.reason)
        tries = 0 if marks.reason is None else None
        scored = _score(question, repeat, [attempt], tries=tries, marks=None, cause=None, reason=marks.reason)
        return replace(scored, readable=marks.read, flyable=marks.safe)

    def _call_of(self, question: Question) -> Call:
        """The question in words as people's missions and edits are asked."""
        assert question.words is not None and question.mission is not None
        brief = self._prompts.programs and not self._prompts.reasons
        if question.section == "edit":
            return edit_call(question.words, drawn_program(question.mission["shape"]), question.n, brief=brief)
        return mission_call(question.words, question.build_mission(), flying=question.flying, brief=brief)


async def _by_geometry(
    asked: Asked,
    check_plan: Callable[[PlanQuestion, PlanAnswer], str | None],
    judge: Callable[[StepQuestion, StepAnswer], Verdict],
) -> _Asked:
    """The answer of geometry, after the checks that a model's answer goes through."""
    reason: str | None = None
    if isinstance(asked, JudgementQuestion):  # it has no opinion: the team does the first
        answer = JudgementAnswer(choice=asked.options[0].choice)
    elif isinstance(asked, PlanQuestion):
        answer = await GeometryPlanner().plan(asked)
        reason = check_plan(asked, answer) if isinstance(answer, PlanAnswer) else None
    else:
        answer = await GeometryPlanner().step(asked)
        reason = judge(asked, answer).reason if isinstance(answer, StepAnswer) else None
    first = None if isinstance(answer, NoAnswer) else answer
    return _Asked(answer=answer if reason is None else NoAnswer(cause="answer", reason=reason), first=first)


def _outcome(question: Question, mission: Mission, asked: Sequence[_Asked], repeat: int) -> Outcome:
    usable = [one.answer for one in asked if not isinstance(one.answer, NoAnswer)]
    failed = [one.answer for one in asked if isinstance(one.answer, NoAnswer)]
    cause = next((answer.cause for answer in failed if answer.cause != "answer"), None)
    refused = (one.attempts[0].rejected for one in asked if one.attempts)
    reason = next(filter(None, refused), None) or next((answer.reason for answer in failed), None)
    tries: int | None = None
    if not failed:
        lacking = shortfall(question, mission, usable)
        reason = reason or lacking
        if lacking is None:
            tries = max(max(0, len(one.attempts) - 1) for one in asked)
    marks: Marks | None = None
    first = next((one.first for one in asked if one.first is not None), None)
    if isinstance(first, PlanAnswer):
        marks = plan_marks(question, mission, first)
    elif isinstance(first, JudgementAnswer):
        chosen = next(option for option in question.options if option["choice"] == first.choice)
        marks = Marks(flyable=chosen["lost"] == 0)
    elif first is not None:
        marks = step_marks(question, mission, first)
    attempts = [attempt for one in asked for attempt in one.attempts]
    return _score(question, repeat, attempts, tries=tries, marks=marks, cause=cause, reason=reason)


def _score(
    question: Question,
    repeat: int,
    attempts: list[Attempt],
    *,
    tries: int | None,
    marks: Marks | None,
    cause: str | None,
    reason: str | None,
) -> Outcome:
    replies = [attempt.reply for attempt in attempts if attempt.error is None]
    costs = [reply.cost_usd for reply in replies]
    return Outcome(
        question=question.id,
        section=question.section,
        tags=question.tags,
        n=question.n,
        distance=question.distance,
        repeat=repeat,
        tries=tries,
        readable=marks is not None,
        flyable=marks is not None and marks.flyable,
        error=None if marks is None or marks.error is None else round(marks.error, 4),
        calls=len(attempts),
        tokens_input=sum(reply.usage.input for reply in replies),
        tokens_output=sum(reply.usage.output for reply in replies),
        seconds=round(sum(attempt.reply.latency_s for attempt in attempts), 4),
        cost_usd=None if None in costs else sum(cost for cost in costs if cost is not None),
        answered_by=replies[0].model if replies else None,
        cause=cause,
        reason=None if reason is None else reason[:300],
    )
