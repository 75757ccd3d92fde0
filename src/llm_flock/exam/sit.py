"""Sit the exam: all questions, many at once, within the budget; an exam that broke off goes on."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path

from llm_flock.exam.ask import Invigilator, Outcome
from llm_flock.exam.examinee import Examinee
from llm_flock.exam.questions import WORDS, Question, digest
from llm_flock.exam.results import ResultFile, Sitting
from llm_flock.exam.splits import VERSION
from llm_flock.llm.frame import FrameName, frame_plan, frame_step
from llm_flock.llm.mission_words import mission_call
from llm_flock.llm.port import Attempt, ChatMessage
from llm_flock.llm.prompting import PromptSet
from llm_flock.llm.replay import CassetteWriter

ROUNDS = 1_000_000
"""Numbers of questions before the first repeat's: a call in a recording is found by `round`, which holds both."""


def round_of(question: Question, repeat: int) -> int:
    """The number under which the calls of a question are recorded; the same for every selection of questions."""
    section, _, number = question.id.rpartition("-")
    place = int.from_bytes(hashlib.blake2b(section.encode(), digest_size=1).digest()) * 1000 + int(number)
    return repeat * ROUNDS + place


def first_messages(question: Question, prompts: PromptSet, frame: FrameName) -> Iterator[tuple[ChatMessage, ...]]:
    """What a model sees at first ask of a question, for each robot that is asked, without scripted exchanges."""
    if question.section == WORDS:
        assert question.words is not None
        yield mission_call(question.words).messages
        return
    mission = question.build_mission()
    for robot in question.robots:
        if question.asks_plan:
            plan = frame_plan(question.plan_question(mission, robot, 0), frame).framed
            system, user = prompts.system(plan.mission), prompts.plan(plan)
        else:
            step = frame_step(question.step_question(mission, 0), frame).framed
            system, user = prompts.system(step.mission), prompts.step(step)
        yield ChatMessage("system", system), ChatMessage("user", user)


def prompts_digest(questions: Sequence[Question], prompts: PromptSet, frame: FrameName) -> str:
    """16 hexadecimal digits that identify all prompts of these questions."""
    found = hashlib.blake2b(digest_size=8)
    for question in questions:
        for messages in first_messages(question, prompts, frame):
            found.update("\0".join(message.text for message in messages).encode())
    return found.hexdigest()


def asked_of(examinee: Examinee, questions: Sequence[Question]) -> tuple[Question, ...]:
    """The questions that this examinee is asked: stand-ins and geometry get none in plain words."""
    return tuple(q for q in questions if examinee.reads_words or q.section != WORDS)


def sitting_of(
    examinee: Examinee, questions: Sequence[Question], *, split: str, seed: int | None, repeats: int
) -> Sitting:
    """The header of a result file for these questions."""
    return Sitting(
        version=VERSION,
        split=split,
        seed=seed,
        questions=digest(questions),
        prompts=prompts_digest(questions, examinee.prompts, examinee.frame),
        count=len(questions),
        repeats=repeats,
        setup=examinee.setup.asked(),
        simulated=examinee.simulated,
    )


async def sit(
    examinee: Examinee,
    questions: Sequence[Question],
    results: ResultFile,
    *,
    repeats: int = 1,
    record: Path | None = None,
    on_outcome: Callable[[Outcome], None] = lambda _: None,
) -> bool:
    """Ask every question that has no result yet.

    Args:
        examinee: who is asked; open, and closed by the caller.
        questions: as `asked_of` gives them.
        results: where results are read from and written to.
        repeats: how often each question is asked.
        record: a new file for all conversations, in the form of `--record-llm`.
        on_outcome: called after each result.

    Returns:
        whether all questions have an answer; False where the budget is used up, or the provider failed.

    Raises:
        ReplayDrift: a recording holds other questions.
        InputError: an engine on board cannot be loaded.
    """
    done = results.done
    open_ = [(q, r) for r in range(repeats) for q in questions if (q.id, r) not in done]
    if examinee.kind == "local":
        # The first question determines how much an engine on board reserves for each.
        open_.sort(key=lambda one: (not one[0].asks_plan, -one[0].n))
    writer = nullcontext() if record is None else CassetteWriter(record, simulated=examinee.simulated)
    queue = iter(open_)
    stopped = False

    with writer as recording:

        def note(attempt: Attempt) -> None:
            if recording is not None:
                recording(attempt)

        invigilator = Invigilator(examinee.prompts, examinee.frame, max_retries=examinee.setup.max_retries, sink=note)

        async def work() -> None:
            nonlocal stopped
            for question, repeat in queue:
                if stopped:
                    return
                round_ = round_of(question, repeat)
                model = None if examinee.kind == "geometry" else examinee.model(question.robots[0], round_)
                outcome = await invigilator.ask(question, model, round_, repeat)
                if outcome.cause == "budget":
                    stopped = True
                    return
                results.add(outcome)
                on_outcome(outcome)

        try:
            async with asyncio.TaskGroup() as group:
                for _ in range(min(len(open_), examinee.setup.max_concurrent)):
                    group.create_task(work())
        except ExceptionGroup as failed:
            # One sentence for the operator: all tasks stop with the first.
            raise failed.exceptions[0] from None
    return {(q.id, r) for r in range(repeats) for q in questions} <= results.done
