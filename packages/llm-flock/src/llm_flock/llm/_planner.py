"""A robot's conversation with its language model: ask, read, ask again with the reason, give up after some attempts.

Each robot has its own planner, which holds only this robot's conversation. Every question carries its mission, which
may differ from the one before.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeAlias

from llm_flock.errors import AnswerError, InputError, ModelError
from llm_flock.llm._answer_forms import answer_schema
from llm_flock.llm._answers import read_plan, read_waypoints
from llm_flock.llm._choices import read_choice
from llm_flock.llm._frame import A, FramedQuestion, Q, frame_plan, frame_step
from llm_flock.llm._letters import read_way, ways_of
from llm_flock.llm._port import AnswerForm, Attempt, AttemptSink, Call, ChatMessage, FrameName, Kind, LanguageModel
from llm_flock.llm._prompting import NOT_FLOWN, PromptSet
from llm_flock.llm._thoughts import quote, whole_answer
from llm_flock.message import Choice
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
from llm_flock.protocol._geometry import plan_by_geometry, straight_path
from llm_flock.protocol._verification.steps import Verdict

logger = logging.getLogger(__name__)

CheckPlan: TypeAlias = Callable[[PlanQuestion, PlanAnswer], str | None]
"""A reason to reject an answer, as a sentence for the model, or None."""

Asked: TypeAlias = PlanQuestion | StepQuestion | JudgementQuestion
Given: TypeAlias = PlanAnswer | StepAnswer | JudgementAnswer

CheckStep: TypeAlias = Callable[[StepQuestion, StepAnswer], Verdict]


def _same_task(one: Mission, other: Mission) -> bool:
    """Whether two missions are the same apart from the position of a moving centre."""
    if one.digest == other.digest:
        return True
    if one.velocity is None or one.velocity != other.velocity:
        return False
    moving = {"center", "since"}
    return one.model_dump(exclude=moving) == other.model_dump(exclude=moving)


def _rejection_reason(
    asked: FramedQuestion[Q], framed: A, answer: A, check: Callable[[Q, A], str | None] | None
) -> str | None:
    """The reason why a check rejects an answer, in the coordinates of the prompt; None if it passes."""
    rejected = None if check is None else check(asked.question, answer)
    if check is None or rejected is None or asked.frame is None:
        return rejected
    # The check in the world decides. Rounding may let the same answer pass in the model's own numbers.
    return check(asked.framed, framed) or f"in the team's coordinates, which are not yours, {rejected}"


def _plain(question: Asked, answer: Given) -> dict[str, Any]:
    """An answer as it is recorded, in the world frame."""
    if isinstance(answer, JudgementAnswer):
        return {"choice": answer.choice, "reason": answer.reason}
    if isinstance(answer, PlanAnswer):
        return {"plan": [list(point) for point in answer.plan.points], "slot": answer.slot}
    plain: dict[str, Any] = {"waypoint": list(answer.waypoint)}
    if isinstance(question, StepQuestion) and question.horizon > 1:
        plain["path"] = [list(point) for point in answer.path]
    return plain


@dataclass(frozen=True, slots=True)
class _Exchange(Generic[Q, A]):
    """A question as a prompt, the form of its answer, and how an answer is read and checked."""

    kind: Kind
    asked: FramedQuestion[Q]
    text: str
    form: AnswerForm
    read: Callable[[str], A]
    check: Callable[[Q, A], str | None] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Outcome(Generic[A]):
    """The result of one attempt: the reply as a message, and the answer in it; None if it cannot be read.

    `fixed`: the model always takes the likeliest word.
    """

    message: ChatMessage
    answer: A | None
    rejected: str | None
    fixed: bool = False

    @property
    def accepted(self) -> A | None:
        """The answer, if it was not rejected."""
        return self.answer if self.rejected is None else None


class LanguagePlanner:
    """A `Planner` that asks a language model.

    An answer that cannot be read, or that a check rejects, goes back to the model with the reason. Rejected attempts
    stay in the conversation of their question only: later questions see the accepted exchange.

    `history` is the number of earlier exchanges that the model sees, None for all. With `clips`, the planner accepts an
    unsafe step that the shield can clip, instead of asking again.

    With the prompts `letters`, the model chooses among open ways by its letter. Geometry makes the plans. It also makes
    a step if fewer than two ways are open or the straight way reaches the goal; such answers have `by="geometry"`.
    Without the second case, a robot told to go slowly would halve its last step again and again and never arrive.
    """

    def __init__(
        self,
        robot: int,
        model: LanguageModel,
        prompts: PromptSet,
        *,
        max_retries: int = 2,
        history: int | None = 0,
        on_attempt: AttemptSink = lambda _: None,
        check_plan: CheckPlan | None = None,
        judge: CheckStep | None = None,
        clips: bool = False,
        frame: FrameName = "world",
    ) -> None:
        if frame == "own" and history != 0:
            allowed = "world while history is kept, because with own each question has a different frame"
            raise InputError("frame", frame, allowed)
        self._robot = robot
        self._model = model
        self._prompts = prompts
        self._max_retries = max_retries
        self._max_exchanges = history
        self._frame: FrameName = frame
        self._on_attempt = on_attempt
        self._check_plan = check_plan
        self._judge = judge
        self._clips = clips
        self._history: list[ChatMessage] = []
        self._mission: Mission | None = None
        self._round: int = -1
        self._attempt = 0

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """Ask for a plan of the whole formation and the robot's own place in it."""
        if self._prompts.letters:
            return plan_by_geometry(question)

        asked, form = frame_plan(question, self._frame), self._form(question.mission, program=self._prompts.programs)

        def read(text: str) -> PlanAnswer:
            if form.program:
                from llm_flock.llm._program_answers import read_program

                plan, slot = read_program(text, asked.framed.mission)
            else:
                plan, slot = read_plan(text, form)
            return PlanAnswer(plan=plan, slot=slot)

        text = self._prompts.plan(asked.framed)
        return await self._converse(_Exchange("plan", asked, text, form, read, self._check_plan))

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Ask for the next waypoint, or for a path."""
        if self._prompts.letters:
            return await self._choose(question)

        asked, form = frame_step(question, self._frame), self._form(question.mission, horizon=question.horizon)

        def read(text: str) -> StepAnswer:
            waypoint, *path = read_waypoints(text, form, asked.framed.position)
            return StepAnswer(waypoint=waypoint, path=tuple(path))

        text = self._prompts.step(asked.framed)
        if question.objection:
            text += f"\n\n{NOT_FLOWN} {question.objection}"
        return await self._converse(_Exchange("step", asked, text, form, read, self._check_step))

    async def judge(self, question: JudgementQuestion) -> JudgementAnswer | NoAnswer:
        """Ask which of some options to take. The prompts `letters` have no such question."""
        if self._prompts.letters:
            return NoAnswer(cause="answer", reason="the prompts 'letters' ask for no judgement")
        asked = FramedQuestion(question=question, framed=question)
        names: list[Choice] = [option.choice for option in question.options]
        form = replace(self._form(question.mission), choices=tuple(names))
        text = self._prompts.judgement(question)
        exchange = _Exchange("judgement", asked, text, form, lambda answer: read_choice(answer, names), None)
        return await self._converse(exchange)

    async def _choose(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Ask which way to go; its end is the waypoint. A path has one position."""
        ways = ways_of(question)
        if len(ways) < 2 or ways[0].waypoint == question.goal:
            only = ways[0].waypoint if ways else straight_path(question).waypoint
            return StepAnswer(waypoint=only, by="geometry")

        asked, text = FramedQuestion(question=question, framed=question), self._prompts.step(question)
        form = self._form(question.mission, letters="".join(way.letter for way in ways))
        exchange = _Exchange(
            "step",
            asked,
            text,
            form,
            lambda answer: StepAnswer(waypoint=read_way(answer, ways).waypoint),
            self._check_step,
        )
        return await self._converse(exchange)

    def _check_step(self, question: StepQuestion, answer: StepAnswer) -> str | None:
        return None if self._judge is None else self._judge(question, answer).reason

    def _form(self, mission: Mission, *, horizon: int = 1, letters: str = "", program: bool = False) -> AnswerForm:
        return AnswerForm(
            n=mission.n_places,
            dim=mission.dim,
            horizon=horizon,
            json=self._prompts.json or program,
            reasons=self._prompts.reasons,
            letters=letters,
            program=program,
        )

    async def _converse(self, exchange: _Exchange[Q, A]) -> A | NoAnswer:
        """Ask one question up to `1 + max_retries` times; a probe once."""
        call, question = self._first_call(exchange), exchange.asked.question
        reason, last_waypoint, last_text = "", None, ""
        attempts = 1 if question.probe else 1 + self._max_retries
        for attempt in range(1, attempts + 1):
            try:
                outcome = await self._ask(call, exchange)
            except ModelError as error:  # it is not repeated here: `limits` has retried transport faults already
                return NoAnswer(cause=error.kind, reason=str(error))
            if outcome.accepted is not None:
                self._keep(ChatMessage("user", exchange.text), outcome.message)
                return outcome.accepted
            reason = outcome.rejected or ""
            if outcome.message.text == last_text and attempt < attempts:
                reason = f"you gave the same answer before, word for word; {reason}"
                if outcome.fixed:  # no recorded model ever got out of this; later attempts keep their numbers
                    self._attempt += attempts - attempt
                    attempts = attempt
                    break
            last_text = outcome.message.text
            if isinstance(outcome.answer, StepAnswer):
                last_waypoint = outcome.answer.waypoint
            retry = ChatMessage("user", self._prompts.retry(reason, exchange.asked.framed))
            call = replace(call, attempt=self._attempt, messages=(*call.messages, outcome.message, retry))
        story = f"no usable answer in {attempts} {'try' if attempts == 1 else 'tries'}; the last: {reason}"
        logger.info("robot %d, round %d, %s: %s", self._robot, call.round, call.kind, story)
        return NoAnswer(cause="answer", reason=story, waypoint=last_waypoint)

    def _first_call(self, exchange: _Exchange[Q, A]) -> Call:
        """The question after the history that is about the same task."""
        question, mission, form = exchange.asked.question, exchange.asked.question.mission, exchange.form
        if self._mission is None or not _same_task(self._mission, mission):
            self._history = []
        self._mission = mission
        if question.round != self._round:  # attempts are numbered within a round, over both kinds of questions
            self._round, self._attempt = question.round, 0
        system = ChatMessage("system", self._prompts.system(exchange.asked.framed.mission))
        return Call(
            robot=self._robot,
            round=question.round,
            kind=exchange.kind,
            attempt=self._attempt,
            messages=(system, *self._history, ChatMessage("user", exchange.text)),
            # Strict servers refuse the schema of a program, which is recursive; it is in the question.
            schema=answer_schema(exchange.kind, exchange.form) if form.json and not form.program else None,
            form=exchange.form,
            probe=question.probe,
        )

    async def _ask(self, call: Call, exchange: _Exchange[Q, A]) -> _Outcome[A]:
        """Make one attempt: ask, read, check and report; ModelError without a reply."""
        self._attempt, asked, start = call.attempt + 1, exchange.asked, time.perf_counter()
        try:
            reply = await self._model.ask(call)
        except ModelError as error:
            self._on_attempt(Attempt.failed(call, error, self._model.name, time.perf_counter() - start))
            logger.info("robot %d, round %d, %s: no answer: %s", self._robot, call.round, call.kind, error)
            raise
        answer, clipped = None, None
        try:
            framed = exchange.read(whole_answer(reply, exchange.text))
            answer = asked.to_world(framed)
            rejected = _rejection_reason(asked, framed, answer, exchange.check)
        except AnswerError as error:
            answer, rejected = None, str(error)
        if rejected is not None and self._will_be_clipped(asked.question, answer):
            clipped, rejected = rejected, None
        message, fixed = ChatMessage("assistant", quote(reply)), reply.settings.get("temperature") == 0
        outcome = _Outcome(message=message, answer=answer, rejected=rejected, fixed=fixed)
        parsed = None if outcome.accepted is None else _plain(asked.question, outcome.accepted)
        self._on_attempt(Attempt(call=call, reply=reply, parsed=parsed, rejected=rejected, clipped=clipped))
        return outcome

    def _will_be_clipped(self, question: Asked, answer: Given | None) -> bool:
        if self._judge is None or not isinstance(question, StepQuestion) or not isinstance(answer, StepAnswer):
            return False
        return self._clips and self._judge(question, answer).fit is not None

    def _keep(self, question: ChatMessage, answer: ChatMessage) -> None:
        """Add an accepted exchange to the history, and drop the oldest ones."""
        self._history += [question, answer]
        if self._max_exchanges is not None:
            del self._history[: max(0, len(self._history) - 2 * self._max_exchanges)]
