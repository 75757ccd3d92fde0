"""A robot's conversation with its language model: ask, read, ask again with the reason, give up after some tries.

Each robot has a planner of its own, and a planner holds nothing but its own robot's conversation. Every question brings
its mission along, which may be another one than the last time.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, TypeVar

from llm_flock.errors import AnswerError, InputError, ModelError
from llm_flock.llm import answers as read
from llm_flock.llm import schemas
from llm_flock.llm.frame import Asked, FrameName, ask_plan, ask_step
from llm_flock.llm.port import AnswerForm, Attempt, AttemptSink, Call, ChatMessage, Kind, LanguageModel
from llm_flock.llm.prompting import PromptSet
from llm_flock.mission import Mission
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion

logger = logging.getLogger(__name__)

A = TypeVar("A", PlanAnswer, StepAnswer)
Q = TypeVar("Q", PlanQuestion, StepQuestion)

Answers: TypeAlias = Literal["text", "json"]
CheckPlan: TypeAlias = Callable[[PlanQuestion, PlanAnswer], str | None]
CheckStep: TypeAlias = Callable[[StepQuestion, StepAnswer], str | None]
"""Says in a sentence for the model why an answer will not do, or None."""

MAX_QUOTED = 20_000
"""Characters of an answer that are repeated to the model; a runaway answer must not fill every later request."""

NO_TEXT = "(no text)"
"""Stands for an empty answer in the conversation: providers refuse empty messages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """How many earlier exchanges, a question with its accepted answer each, the model sees; None is all of them."""

    exchanges: int | None = 0


def parse_history(text: str) -> History:
    """Read `none`, `last:K` (K >= 1) or `full`.

    Raises:
        InputError: for field `history`.
    """
    if text in ("none", "full"):
        return History(exchanges=0 if text == "none" else None)
    last, _, count = text.partition(":")
    if last != "last" or not (count.isascii() and count.isdecimal() and len(count) <= 9 and int(count) >= 1):
        raise InputError("history", text, "none, full, or last:K with a whole number K >= 1")
    return History(exchanges=int(count))


def _same_task(one: Mission, other: Mission) -> bool:
    """Whether two missions are the same but for the way that a moving centre has come."""
    if one.digest == other.digest:
        return True
    if one.velocity is None or one.velocity != other.velocity:
        return False
    way = {"center", "since"}
    return one.model_dump(exclude=way) == other.model_dump(exclude=way)


def _objection(asked: Asked[Q], told: A, answer: A, check: Callable[[Q, A], str | None] | None) -> str | None:
    """Why an answer will not do, in the numbers that the model was told and has given."""
    rejected = None if check is None else check(asked.question, answer)
    if check is None or rejected is None or asked.frame is None:
        return rejected
    # The world decides. By a hair of rounding the same answer may pass in the model's own numbers.
    return check(asked.told, told) or f"in the team's coordinates, which are not yours, {rejected}"


def _plain(question: PlanQuestion | StepQuestion, answer: PlanAnswer | StepAnswer) -> dict[str, Any]:
    """An answer as it is recorded, in the world."""
    if isinstance(answer, PlanAnswer):
        return {"plan": [list(point) for point in answer.plan.points], "slot": answer.slot}
    plain: dict[str, Any] = {"waypoint": list(answer.waypoint)}
    if isinstance(question, StepQuestion) and question.horizon > 1:
        plain["path"] = [list(point) for point in answer.path]
    return plain


class LanguagePlanner:
    """A `Planner` that asks a language model.

    An answer that cannot be read, or that a check objects to, goes back to the model with the reason. Rejected tries
    stay in the conversation of their question only: what later questions see is the accepted exchange.

    Args:
        robot: whose planner this is.
        model: who answers.
        prompts: how questions are put into words; loaded for the same form of answers.
        max_retries: how often a rejected answer is sent back before giving up.
        history: what is kept between questions.
        answers: the paper's text forms, or JSON objects with a schema.
        on_attempt: told of every call and what came of it.
        check_plan: an objection to a plan that can be read, or None.
        check_step: an objection to a waypoint or path that can be read, or None.
        frame: whether the model is asked in the world's coordinates or in its own.
        clock: seconds, only differences matter.

    Raises:
        InputError: `max_retries` is negative, `prompts` ask for another form of answers, or exchanges are to be kept
            whose questions are each in a frame of its own.
    """

    def __init__(
        self,
        robot: int,
        model: LanguageModel,
        prompts: PromptSet,
        *,
        max_retries: int = 2,
        history: History | None = None,
        answers: Answers = "text",
        on_attempt: AttemptSink | None = None,
        check_plan: CheckPlan | None = None,
        check_step: CheckStep | None = None,
        frame: FrameName = "world",
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        if max_retries < 0:
            raise InputError("max_retries", max_retries, "at least 0")
        if prompts.json != (answers == "json"):
            raise InputError("answers", answers, f"'{'json' if prompts.json else 'text'}', as the prompts ask for")
        self._robot = robot
        self._model = model
        self._prompts = prompts
        self._max_retries = max_retries
        self._kept = (history or History()).exchanges
        if frame == "own" and self._kept != 0:
            raise InputError("frame", frame, "world where history is kept: every question has an own frame of its own")
        self._frame: FrameName = frame
        self._json = answers == "json"
        self._on_attempt = on_attempt
        self._check_plan = check_plan
        self._check_step = check_step
        self._clock = clock
        self._history: list[ChatMessage] = []
        self._about: Mission | None = None
        self._round = -1
        self._attempt = 0

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """Ask for a plan of the whole formation and the robot's own place in it."""
        n, dim = question.mission.n_places, question.mission.dim
        asked = ask_plan(question, self._frame)

        def parse(text: str) -> PlanAnswer:
            plan, slot = read.parse_plan_json(text, n, dim) if self._json else read.parse_plan(text, n, dim)
            return PlanAnswer(plan=plan, slot=slot)

        form = AnswerForm(n=n, dim=dim, json=self._json, reasons=self._prompts.reasons)
        return await self._converse("plan", asked, self._prompts.plan(asked.told), form, parse, self._check_plan)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Ask for the next waypoint, or for a path."""
        dim, horizon = question.mission.dim, question.horizon
        asked = ask_step(question, self._frame)

        def parse(text: str) -> StepAnswer:
            if horizon > 1:
                waypoint, *path = (read.parse_path_json if self._json else read.parse_path)(text, horizon, dim)
                return StepAnswer(waypoint=waypoint, path=tuple(path))
            return StepAnswer(waypoint=(read.parse_step_json if self._json else read.parse_step)(text, dim))

        n, reasons = question.mission.n_places, self._prompts.reasons
        form = AnswerForm(n=n, dim=dim, horizon=horizon, json=self._json, reasons=reasons)
        return await self._converse("step", asked, self._prompts.step(asked.told), form, parse, self._check_step)

    async def _converse(
        self,
        kind: Kind,
        asked: Asked[Q],
        text: str,
        form: AnswerForm,
        parse: Callable[[str], A],
        check: Callable[[Q, A], str | None] | None,
    ) -> A | NoAnswer:
        """One question, and as many tries at it as are allowed."""
        mission, round_ = asked.question.mission, asked.question.round
        self._remember_only(mission)
        system = ChatMessage("system", self._prompts.system(asked.told.mission))
        question = ChatMessage("user", text)
        messages = (system, *self._history, question)
        reason, unfit = "", None
        for _ in range(1 + self._max_retries):
            call = self._call(kind, round_, messages, form)
            began = self._clock()
            try:
                reply = await self._model.ask(call)
            except ModelError as error:
                return self._give_up(call, error, self._clock() - began)
            try:
                told = parse(reply.text)
                answer = asked.meant(told)
                rejected = _objection(asked, told, answer, check)
            except AnswerError as error:
                answer, rejected = None, str(error)
            self._tell(
                Attempt(
                    call=call,
                    model=reply.model,
                    reply=reply,
                    parsed=_plain(asked.question, answer) if answer is not None and rejected is None else None,
                    rejected=rejected,
                    faults=reply.faults,
                    latency_s=reply.latency_s,
                )
            )
            said = ChatMessage("assistant", reply.text[:MAX_QUOTED] if reply.text.strip() else NO_TEXT)
            if answer is not None and rejected is None:
                self._keep(question, said)
                return answer
            reason = rejected or ""
            unfit = answer.waypoint if isinstance(answer, StepAnswer) else unfit
            messages += (said, ChatMessage("user", self._prompts.retry(reason, kind)))
        tries = 1 + self._max_retries
        story = f"no usable answer in {tries} {'try' if tries == 1 else 'tries'}; the last: {reason}"
        logger.info("robot %d, round %d, %s: %s", self._robot, round_, kind, story)
        return NoAnswer(cause="answer", reason=story, waypoint=unfit)

    def _remember_only(self, mission: Mission) -> None:
        """Forget the exchanges about another mission; a centre that travels does not make it another one."""
        if self._about is None or not _same_task(self._about, mission):
            self._history = []
        self._about = mission

    def _call(self, kind: Kind, round_: int, messages: tuple[ChatMessage, ...], form: AnswerForm) -> Call:
        """The next call of this robot; attempts are numbered through a round, over both kinds of questions."""
        if round_ != self._round:
            self._round, self._attempt = round_, 0
        call = Call(
            robot=self._robot,
            round=round_,
            kind=kind,
            attempt=self._attempt,
            messages=messages,
            schema=schemas.answer_schema(kind, form) if form.json else None,
            form=form,
        )
        self._attempt += 1
        return call

    def _give_up(self, call: Call, error: ModelError, latency_s: float) -> NoAnswer:
        """Without an answer there is nothing to correct: transport faults were already retried below the port."""
        self._tell(
            Attempt(
                call=call,
                model=error.model or self._model.name,
                error=(error.kind, error.detail),
                faults=error.faults,
                latency_s=latency_s,
            )
        )
        logger.info("robot %d, round %d, %s: no answer: %s", self._robot, call.round, call.kind, error)
        return NoAnswer(cause=error.kind, reason=str(error))

    def _tell(self, attempt: Attempt) -> None:
        if self._on_attempt is not None:
            self._on_attempt(attempt)

    def _keep(self, question: ChatMessage, answer: ChatMessage) -> None:
        """Remember an accepted exchange, and forget what is too old."""
        if self._kept == 0:
            return
        self._history += [question, answer]
        if self._kept is not None:
            del self._history[: -2 * self._kept]
