"""The exam as a task of Inspect (`inspect eval llm_flock/exam`): its models, logs and viewer, our questions and scores.

A solver asks each question through the planner of a robot, with the reason after a wrong answer; the scorer only reads
the outcome. Importing this module registers the task, and our models as `flock/MODEL`.
"""

from __future__ import annotations

from dataclasses import asdict
from importlib import import_module
from typing import Any, cast, get_args

from llm_flock.errors import InputError, ModelError
from llm_flock.llm import FrameName, PromptSet, habits_of
from llm_flock.runtime import versions
from llm_flock_lab._exam.ask import Examiner, Outcome, round_of
from llm_flock_lab._exam.inspect_model import AskedByInspect, FlockModel
from llm_flock_lab._exam.questions import Question, digest, from_lines, to_lines
from llm_flock_lab._exam.splits import VERSION, paper

# By name, because the library is not installed where types are checked.
_inspect: Any = import_module("inspect_ai")
task: Any = _inspect.task  # Inspect finds the tasks of a file by this name
_dataset: Any = import_module("inspect_ai.dataset")
_model: Any = import_module("inspect_ai.model")
_scorer: Any = import_module("inspect_ai.scorer")
_solver: Any = import_module("inspect_ai.solver")

OUTCOME = "outcome"
QUESTION = "question"


@task
def exam(
    split: str = "public",
    seed: int | None = None,
    sections: str | None = None,
    limit: int | None = None,
    prompts: str | None = None,
    frame: str | None = None,
    answers: str = "text",
    max_retries: int = 2,
) -> Any:
    """The exam, as `llm-flock exam` takes it; epochs of Inspect are repeats.

    Prompts and frame that are None are those of the model that is evaluated, as in `llm-flock run`.
    """
    api = _api()
    name = api.model_name if api is not None else ""
    habits = habits_of(name)
    settings: dict[str, Any] = {
        "prompts": prompts or (habits.prompts if habits.prompts != "letters" else "brief"),
        "frame": frame or habits.frame,
        "answers": answers,
        "max_retries": max_retries,
    }
    examiner = _examiner(**settings)
    if api is not None and api.kind == "simulated" and settings["prompts"] != "full":
        raise InputError("prompts", prompts, "full: simulated models understand no others")
    questions = paper(split, seed, sections, limit)
    # The first question determines how much an engine on board reserves for each.
    ordered = sorted(questions, key=lambda question: (not question.asks_plan, -question.n))
    return _inspect.Task(
        dataset=_dataset.MemoryDataset([_sample(q, examiner) for q in ordered], name="llm_flock_exam"),
        solver=ask_as_robots(**settings),
        scorer=by_our_checks(),
        version=VERSION,
        metadata={
            "questions": digest(questions),
            "prompts": examiner.prompts_digest(questions),
            "simulated": api is not None and api.simulated,
            "versions": {k: v for k, v in versions().items() if v != "not installed"}
            | ({} if api is None else dict(api.files)),
        },
    )


def _api() -> FlockModel | None:
    """The model that is evaluated, if it is one of ours; None too where the task is made before it is known."""
    try:
        api = _model.get_model().api
    except ValueError:  # no model is active
        return None
    return api if isinstance(api, FlockModel) else None


def _examiner(prompts: str, frame: str, answers: str, max_retries: int) -> Examiner:
    if answers not in ("text", "json"):
        raise InputError("answers", answers, "text or json")
    if frame not in get_args(FrameName):
        raise InputError("frame", frame, "world or own")
    if max_retries < 0:
        raise InputError("max_retries", max_retries, "at least 0")
    if prompts == "letters":
        raise InputError("prompts", prompts, "full, brief or a folder: nothing else than a run asks for a letter")
    templates = PromptSet.load(prompts, json=answers == "json")
    return Examiner(templates, cast(FrameName, frame), max_retries=max_retries)


def _sample(question: Question, examiner: Examiner) -> Any:
    """A question as Inspect shows it: its first prompt, and the whole question as metadata."""
    messages = next(examiner.first_messages(question))
    metadata = {QUESTION: to_lines([question]), "section": question.section, "tags": list(question.tags)}
    return _dataset.Sample(id=question.id, input=messages[-1].text, metadata=metadata)


@_solver.solver
def ask_as_robots(prompts: str = "full", frame: str = "world", answers: str = "text", max_retries: int = 2) -> Any:
    """Ask through the planner of a robot: its prompts, parsers and checks, and the reason after a wrong answer."""
    examiner = _examiner(prompts, frame, answers, max_retries)

    async def solve(state: Any, generate: Any) -> Any:
        (question,) = from_lines(state.metadata[QUESTION], "sample")
        repeat, api = state.epoch - 1, _api()
        model = AskedByInspect(_model.get_model(), question.robots[0], round_of(question, repeat))
        geometry = api is not None and api.kind == "geometry"
        outcome = await examiner.ask(question, None if geometry else model, repeat)
        if outcome.cause is not None:
            # An error of the sample: Inspect asks it again when the evaluation is retried.
            raise ModelError(outcome.cause, (outcome.reason or "no answer came").removeprefix(f"{outcome.cause}: "))
        state.store.set(OUTCOME, asdict(outcome))
        return state

    return solve


@_scorer.scorer(metrics=[_scorer.grouped(_scorer.accuracy(), "section", all="groups"), _scorer.stderr()])
def by_our_checks() -> Any:
    """1 for a question that is right at first ask, else 0; the whole outcome stands in the score's metadata."""

    async def score(state: Any, target: Any) -> Any:
        outcome = Outcome(**state.store.get(OUTCOME))
        right = 1 if outcome.tries == 0 else 0
        return _scorer.Score(value=right, explanation=outcome.reason, metadata=asdict(outcome))

    return score
