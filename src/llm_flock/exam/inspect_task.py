"""The exam as a task of Inspect (`inspect eval llm_flock/exam`): its models, logs and viewer, our questions and scores.

A solver asks each question as `llm-flock exam` does, with Inspect's model behind it; the scorer only reads the outcome.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from importlib import import_module
from typing import Any

from llm_flock.errors import InputError, ModelError
from llm_flock.exam.ask import Invigilator, Outcome
from llm_flock.exam.examinee import check_frame
from llm_flock.exam.questions import Question, from_lines, to_lines
from llm_flock.exam.session import Paper
from llm_flock.exam.sit import first_messages, round_of
from llm_flock.extras import require
from llm_flock.llm.frame import FrameName
from llm_flock.llm.port import Call, Reply, Usage
from llm_flock.llm.prompting import PromptSet

require("exam", "the exam as a task of Inspect")

# By name, because the library is not installed where types are checked.
_inspect: Any = import_module("inspect_ai")
task: Any = _inspect.task  # Inspect finds the tasks of a file by this name
_dataset: Any = import_module("inspect_ai.dataset")
_model: Any = import_module("inspect_ai.model")
_scorer: Any = import_module("inspect_ai.scorer")
_solver: Any = import_module("inspect_ai.solver")

OUTCOME = "outcome"
QUESTION = "question"


class InspectModel:
    """A `LanguageModel` on top of the model that Inspect evaluates."""

    def __init__(self, model: Any) -> None:
        self.name = str(model)
        self._model = model

    async def ask(self, call: Call) -> Reply:
        """Answer one call; a failure of Inspect's model is a ModelError, after the retries that Inspect makes."""
        made: dict[str, Any] = {
            "system": _model.ChatMessageSystem,
            "user": _model.ChatMessageUser,
            "assistant": _model.ChatMessageAssistant,
        }
        messages = [made[message.role](content=message.text) for message in call.messages]
        began = time.perf_counter()
        try:
            output: Any = await self._model.generate(messages)
        except (OSError, RuntimeError) as error:
            raise ModelError("server", f"{type(error).__name__}: {error}") from error
        if output.error is not None:
            raise ModelError("server", str(output.error))
        used = output.usage
        usage = Usage() if used is None else Usage.reported(used.input_tokens, used.output_tokens)
        latency_s = time.perf_counter() - began
        return Reply(text=str(output.completion), model=self.name, usage=usage, latency_s=latency_s)


@task
def exam(
    split: str = "public",
    seed: int | None = None,
    sections: str | None = None,
    limit: int | None = None,
    prompts: str = "full",
    frame: str = "world",
    max_retries: int = 2,
) -> Any:
    """The exam of `llm-flock exam`, with its flags of the same names; epochs of Inspect are repeats.

    Raises:
        InputError: a value is not allowed.
    """
    paper = Paper(split=split, seed=seed, sections=sections, limit=limit)
    templates, chosen = PromptSet.load(prompts), check_frame(frame)
    if max_retries < 0:
        raise InputError("max_retries", max_retries, "at least 0")
    samples = [_sample(question, templates, chosen) for question in paper.questions()]
    return _inspect.Task(
        dataset=_dataset.MemoryDataset(samples, name="llm_flock_exam"),
        solver=ask_as_robots(prompts, frame, max_retries),
        scorer=by_our_checks(),
    )


def _sample(question: Question, prompts: PromptSet, frame: FrameName) -> Any:
    """A question as Inspect shows it: its first prompt, and the whole question as metadata."""
    messages = next(iter(first_messages(question, prompts, frame)))
    metadata = {QUESTION: to_lines([question]), "section": question.section, "tags": list(question.tags)}
    return _dataset.Sample(id=question.id, input=messages[-1].text, metadata=metadata)


@_solver.solver
def ask_as_robots(prompts: str = "full", frame: str = "world", max_retries: int = 2) -> Any:
    """Ask through the planner of a robot: its prompts, parsers and checks, and the reason after a wrong answer."""
    invigilator = Invigilator(PromptSet.load(prompts), check_frame(frame), max_retries=max_retries)

    async def solve(state: Any, generate: Any) -> Any:
        (question,) = from_lines(state.metadata[QUESTION], "sample")
        repeat = state.epoch - 1
        model = InspectModel(_model.get_model())
        outcome = await invigilator.ask(question, model, round_of(question, repeat), repeat)
        state.store.set(OUTCOME, asdict(outcome))
        return state

    return solve


@_scorer.scorer(metrics=[_scorer.grouped(_scorer.accuracy(), "section", all="groups"), _scorer.stderr()])
def by_our_checks() -> Any:
    """1 for a question that is right at first ask, else 0; the whole outcome stands in the score's metadata."""

    async def score(state: Any, target: Any) -> Any:
        outcome = Outcome(**state.store.get(OUTCOME))
        right = 1 if outcome.tries == 0 else 0
        said = json.dumps({"tries": outcome.tries, "error": outcome.error, "degrees": outcome.degrees})
        return _scorer.Score(value=right, answer=said, explanation=outcome.reason, metadata=asdict(outcome))

    return score
