"""A robot's conversation with its language model: ask, read, ask again with the reason, give up after some tries.

Each robot has its own planner, which holds only this robot's conversation. Every question carries its mission, which
may differ from the one before.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any, TypeAlias

from llm_flock.errors import AnswerError, InputError, ModelError
from llm_flock.llm._answer_forms import answer_schema
from llm_flock.llm._answers import read_plan, read_waypoints
from llm_flock.llm._frame import A, FramedQuestion, Q, frame_plan, frame_step
from llm_flock.llm._letters import read_way, ways_of
from llm_flock.llm._port import AnswerForm, Attempt, AttemptSink, Call, ChatMessage, FrameName, Kind, LanguageModel
from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._thoughts import quoted, whole_answer
from llm_flock.mission import Mission
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._geometry import plan_by_geometry, straight_path
from llm_flock.protocol._verification.steps import Verdict

logger = logging.getLogger(__name__)

CheckPlan: TypeAlias = Callable[[PlanQuestion, PlanAnswer], str | None]
"""A reason to reject an answer, as a sentence for the model, or None."""

Judge: TypeAlias = Callable[[StepQuestion, StepAnswer], Verdict]


def _same_task(one: Mission, other: Mission) -> bool:
    """Whether two missions are the same apart from the position of a moving centre."""
    if one.digest == other.digest:
        return True
    if one.velocity is None or one.velocity != other.velocity:
        return False
    moving = {"center", "since"}
    return one.model_dump(exclude=moving) == other.model_dump(exclude=moving)


def _objection(
    asked: FramedQuestion[Q], framed: A, answer: A, check: Callable[[Q, A], str | None] | None
) -> str | None:
    """Why a check rejects an answer, in the numbers that the model was given and has answered with."""
    rejected = None if check is None else check(asked.question, answer)
    if check is None or rejected is None or asked.frame is None:
        return rejected
    # The check in the world decides. Rounding may let the same answer pass in the model's own numbers.
    return check(asked.framed, framed) or f"in the team's coordinates, which are not yours, {rejected}"


def _plain(question: PlanQuestion | StepQuestion, answer: PlanAnswer | StepAnswer) -> dict[str, Any]:
    """An answer as it is recorded, in the world frame."""
    if isinstance(answer, PlanAnswer):
        return {"plan": [list(point) for point in answer.plan.points], "slot": answer.slot}
    plain: dict[str, Any] = {"waypoint": list(answer.waypoint)}
    if isinstance(question, StepQuestion) and question.horizon > 1:
        plain["path"] = [list(point) for point in answer.path]
    return plain


class LanguagePlanner:
    """A `Planner` that asks a language model.

    An answer that cannot be read, or that a check rejects, goes back to the model with the reason. Rejected tries stay
    in the conversation of their question only: later questions see the accepted exchange.

    `history` is the number of earlier exchanges that the model sees, None for all. A planner that `clips` accepts an
    answer that does not fit if it can be flown clipped, which is quicker than asking again.

    With the prompts `letters`, the model chooses among open ways by its letter. Plans come from geometry, and say so;
    so do steps where there is nothing to choose: fewer than two ways are open, or the straight one reaches the goal.
    Otherwise a robot that is to go slowly would halve its last step for ever.
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
        judge: Judge | None = None,
        clips: bool = False,
        frame: FrameName = "world",
    ) -> None:
        if frame == "own" and history != 0:
            raise InputError(
                "frame", frame, "world while history is kept, because with own each question has a different frame"
            )
        self._robot = robot
        self._model = model
        self._prompts = prompts
        self._max_retries = max_retries
        self._kept = history
        self._frame: FrameName = frame
        self._report = on_attempt
        self._check_plan = check_plan
        self._judge = judge
        self._clips = clips
        self._history: list[ChatMessage] = []
        self._about: Mission | None = None
        self._round = -1
        self._attempt = 0

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """Ask for a plan of the whole formation and the robot's own place in it."""
        if self._prompts.letters:
            return plan_by_geometry(question)

        def read(text: str, form: AnswerForm) -> PlanAnswer:
            plan, slot = read_plan(text, form)
            return PlanAnswer(plan=plan, slot=slot)

        asked = frame_plan(question, self._frame)
        return await self._converse("plan", asked, self._prompts.plan(asked.framed), 1, read, self._check_plan)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Ask for the next waypoint, or for a path."""
        if self._prompts.letters:
            return await self._choose(question)

        def read(text: str, form: AnswerForm) -> StepAnswer:
            waypoint, *path = read_waypoints(text, form)
            return StepAnswer(waypoint=waypoint, path=tuple(path))

        asked, horizon = frame_step(question, self._frame), question.horizon
        return await self._converse("step", asked, self._prompts.step(asked.framed), horizon, read, self._check_step)

    async def _choose(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Ask which way to go; its end is the waypoint. A path has one position."""
        ways = ways_of(question)
        if len(ways) < 2 or ways[0].waypoint == question.goal:
            only = ways[0].waypoint if ways else straight_path(question).waypoint
            return StepAnswer(waypoint=only, by="geometry")

        def read(text: str, _: AnswerForm) -> StepAnswer:
            return StepAnswer(waypoint=read_way(text, ways).waypoint)

        asked, letters = FramedQuestion(question=question, framed=question), "".join(way.letter for way in ways)
        return await self._converse("step", asked, self._prompts.step(question), 1, read, self._check_step, letters)

    def _check_step(self, question: StepQuestion, answer: StepAnswer) -> str | None:
        return None if self._judge is None else self._judge(question, answer).reason

    async def _converse(
        self,
        kind: Kind,
        asked: FramedQuestion[Q],
        text: str,
        horizon: int,
        read: Callable[[str, AnswerForm], A],
        check: Callable[[Q, A], str | None] | None,
        letters: str = "",
    ) -> A | NoAnswer:
        """Ask one question up to `1 + max_retries` times; a probe once."""
        mission, round_, probe = asked.question.mission, asked.question.round, asked.question.probe
        json, reasons = self._prompts.json, self._prompts.reasons
        form = AnswerForm(
            n=mission.n_places, dim=mission.dim, horizon=horizon, json=json, reasons=reasons, letters=letters
        )
        if self._about is None or not _same_task(self._about, mission):
            self._history = []
        self._about = mission
        if round_ != self._round:  # attempts are numbered within a round, over both kinds of questions
            self._round, self._attempt = round_, 0
        question = ChatMessage("user", text)
        messages = (ChatMessage("system", self._prompts.system(asked.framed.mission)), *self._history, question)
        schema = answer_schema(kind, form) if json else None
        reason, unfit = "", None
        tries = 1 if probe else 1 + self._max_retries
        for _ in range(tries):
            call = Call(
                robot=self._robot,
                round=round_,
                kind=kind,
                attempt=self._attempt,
                messages=messages,
                schema=schema,
                form=form,
                probe=probe,
            )
            self._attempt += 1
            began = time.perf_counter()
            try:
                reply = await self._model.ask(call)
            except ModelError as error:  # it is not repeated here: `limits` has retried transport faults already
                self._report(Attempt.failed(call, error, self._model.name, time.perf_counter() - began))
                logger.info("robot %d, round %d, %s: no answer: %s", self._robot, round_, kind, error)
                return NoAnswer(cause=error.kind, reason=str(error))
            try:
                framed = read(whole_answer(reply), form)
                answer = asked.to_world(framed)
                rejected = _objection(asked, framed, answer, check)
            except AnswerError as error:
                answer, rejected = None, str(error)
            clipped = None
            if rejected is not None and self._will_be_clipped(asked.question, answer):
                clipped, rejected = rejected, None
            parsed = _plain(asked.question, answer) if answer is not None and rejected is None else None
            self._report(Attempt(call=call, reply=reply, parsed=parsed, rejected=rejected, clipped=clipped))
            said = ChatMessage("assistant", quoted(reply))
            if answer is not None and rejected is None:
                self._keep(question, said)
                return answer
            reason = rejected or ""
            unfit = answer.waypoint if isinstance(answer, StepAnswer) else unfit
            messages += (said, ChatMessage("user", self._prompts.retry(reason, asked.framed)))
        story = f"no usable answer in {tries} {'try' if tries == 1 else 'tries'}; the last: {reason}"
        logger.info("robot %d, round %d, %s: %s", self._robot, round_, kind, story)
        return NoAnswer(cause="answer", reason=story, waypoint=unfit)

    def _will_be_clipped(self, question: PlanQuestion | StepQuestion, answer: PlanAnswer | StepAnswer | None) -> bool:
        if self._judge is None or not isinstance(question, StepQuestion) or not isinstance(answer, StepAnswer):
            return False
        return self._clips and self._judge(question, answer).fit is not None

    def _keep(self, question: ChatMessage, answer: ChatMessage) -> None:
        """Add an accepted exchange to the history, and drop the oldest ones."""
        self._history += [question, answer]
        if self._kept is not None:
            del self._history[: max(0, len(self._history) - 2 * self._kept)]
