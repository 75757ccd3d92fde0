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
from llm_flock.llm.port import AnswerForm, Attempt, AttemptSink, Call, ChatMessage, Kind, LanguageModel
from llm_flock.llm.prompting import PromptSet
from llm_flock.mission import Mission
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion

logger = logging.getLogger(__name__)

A = TypeVar("A", PlanAnswer, StepAnswer)

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
        clock: seconds, only differences matter.

    Raises:
        InputError: `max_retries` is negative, or `prompts` ask for another form of answers.
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

        def parse(text: str) -> tuple[PlanAnswer, dict[str, Any]]:
            plan, slot = read.parse_plan_json(text, n, dim) if self._json else read.parse_plan(text, n, dim)
            return PlanAnswer(plan=plan, slot=slot), {"plan": [list(point) for point in plan.points], "slot": slot}

        def objection(answer: PlanAnswer) -> str | None:
            return None if self._check_plan is None else self._check_plan(question, answer)

        schema = schemas.plan_schema(n, dim) if self._json else None
        form = AnswerForm(n=n, dim=dim, json=self._json)
        return await self._converse("plan", question, self._prompts.plan(question), schema, form, parse, objection)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Ask for the next waypoint, or for a path."""
        dim, horizon = question.mission.dim, question.horizon

        def parse(text: str) -> tuple[StepAnswer, dict[str, Any]]:
            if horizon > 1:
                reader = read.parse_path_json if self._json else read.parse_path
                waypoint, *path = reader(text, horizon, dim)
                parsed = {"waypoint": list(waypoint), "path": [list(point) for point in path]}
                return StepAnswer(waypoint=waypoint, path=tuple(path)), parsed
            waypoint = read.parse_step_json(text, dim) if self._json else read.parse_step(text, dim)
            return StepAnswer(waypoint=waypoint), {"waypoint": list(waypoint)}

        def objection(answer: StepAnswer) -> str | None:
            return None if self._check_step is None else self._check_step(question, answer)

        schema = None
        if self._json:
            schema = schemas.step_schema(dim) if horizon == 1 else schemas.path_schema(horizon, dim)
        form = AnswerForm(n=question.mission.n_places, dim=dim, horizon=horizon, json=self._json)
        return await self._converse("step", question, self._prompts.step(question), schema, form, parse, objection)

    async def _converse(
        self,
        kind: Kind,
        asked: PlanQuestion | StepQuestion,
        text: str,
        schema: dict[str, Any] | None,
        form: AnswerForm,
        parse: Callable[[str], tuple[A, dict[str, Any]]],
        objection: Callable[[A], str | None],
    ) -> A | NoAnswer:
        """One question, and as many tries at it as are allowed."""
        self._remember_only(asked.mission)
        system, question = ChatMessage("system", self._prompts.system(asked.mission)), ChatMessage("user", text)
        messages = (system, *self._history, question)
        reason, unfit = "", None
        for _ in range(1 + self._max_retries):
            call = self._call(kind, asked.round, messages, schema, form)
            began = self._clock()
            try:
                reply = await self._model.ask(call)
            except ModelError as error:
                return self._give_up(call, error, self._clock() - began)
            try:
                answer, parsed = parse(reply.text)
                rejected = objection(answer)
            except AnswerError as error:
                answer, parsed, rejected = None, None, str(error)
            self._tell(
                Attempt(
                    call=call,
                    model=reply.model,
                    reply=reply,
                    parsed=parsed if rejected is None else None,
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
        logger.info("robot %d, round %d, %s: %s", self._robot, asked.round, kind, story)
        return NoAnswer(cause="answer", reason=story, waypoint=unfit)

    def _remember_only(self, mission: Mission) -> None:
        """Forget the exchanges about another mission; a centre that travels does not make it another one."""
        if self._about is None or not _same_task(self._about, mission):
            self._history = []
        self._about = mission

    def _call(
        self,
        kind: Kind,
        round_: int,
        messages: tuple[ChatMessage, ...],
        schema: dict[str, Any] | None,
        form: AnswerForm,
    ) -> Call:
        """The next call of this robot; attempts are numbered through a round, over both kinds of questions."""
        if round_ != self._round:
            self._round, self._attempt = round_, 0
        call = Call(
            robot=self._robot,
            round=round_,
            kind=kind,
            attempt=self._attempt,
            messages=messages,
            schema=schema,
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
