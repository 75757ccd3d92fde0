"""`llm-flock exam`: which model can fly?"""

from __future__ import annotations

from contextlib import nullcontext, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from llm_flock.cli import EXIT_FAILED, EXIT_INTERRUPTED, say
from llm_flock.errors import InputError

if TYPE_CHECKING:
    from llm_flock.llm import Budget, CallSettings

Text = str | None
Count = int | None


def exam(
    models: Annotated[list[str] | None, typer.Argument(metavar="MODEL...", help="As in run --model")] = None,
    split: Annotated[Text, typer.Option(help="public, or private with a --seed", show_default="public")] = None,
    seed: Annotated[Count, typer.Option(min=0, help="Seed of a private split", show_default=False)] = None,
    sections: Annotated[Text, typer.Option(help="Sections with commas between them", show_default="all")] = None,
    limit: Annotated[Count, typer.Option(min=1, help="Most questions of a section", show_default=False)] = None,
    repeats: Annotated[int, typer.Option(min=1, max=1000, help="How often each question is asked")] = 1,
    out: Annotated[Path, typer.Option(help="Folder of logs; an exam that broke off goes on there")] = Path("runs/exam"),
    page: Annotated[Path | None, typer.Option(help="Folder of the leaderboard that gets the rows and a page")] = None,
    prompts: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    frame: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    answers: Annotated[Text, typer.Option(help="Form of answers: text or json", show_default="text")] = None,
    base_url: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    temperature: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    model_seed: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    reasoning_effort: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    max_answer_tokens: Annotated[Count, typer.Option(min=1, help="As in run", show_default=False)] = None,
    max_concurrent: Annotated[int, typer.Option(min=1, help="Questions under way at once")] = 8,
    timeout_s: Annotated[float, typer.Option(min=0.1, help="Longest wait for an answer [s]")] = 120.0,
    max_calls: Annotated[Count, typer.Option(min=1, help="Budget of each model, this time", show_default=False)] = None,
    max_tokens: Annotated[Count, typer.Option(min=1, help="The same, in and out", show_default=False)] = None,
    max_cost: Annotated[float | None, typer.Option(min=0.0, help="The same [US dollars]", show_default=False)] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no results")] = False,
) -> None:
    """Ask models the questions that robots ask, and score their answers by code.

    Inspect asks them, and keeps its logs in a folder: `inspect view --log-dir runs/exam` shows every conversation.
    """
    from llm_flock.llm import Budget, parse_settings
    from llm_flock_lab._exam.leaderboard import publish
    from llm_flock_lab._exam.rows import read_log, read_rows
    from llm_flock_lab._exam.splits import paper

    paper(split or "public", seed, sections, limit)  # refuses what is not allowed
    if page is not None:
        read_rows(page)  # what is broken shows before anything is asked
    if not models:
        if page is None:
            raise InputError("models", None, "at least one model, such as simulated:ideal")
        say(publish(page, [])[-1])
        return
    (settings,) = parse_settings(
        1, temperature=temperature, seed=model_seed, reasoning=reasoning_effort, max_tokens=max_answer_tokens
    )
    budget = Budget(max_calls=max_calls, max_tokens=max_tokens, max_cost_usd=max_cost)
    asked = [
        _model(model, settings, budget, base_url=base_url, max_concurrent=max_concurrent, timeout_s=timeout_s)
        for model in models
    ]
    task_args = {"split": split, "seed": seed, "sections": sections, "limit": limit}
    task_args |= {"prompts": prompts, "frame": frame, "answers": answers}
    task_args = {name: value for name, value in task_args.items() if value is not None}
    logs = _evaluate(asked, task_args, repeats, out, quiet=quiet)
    complete = [log for log in logs if log.status == "success"]
    if page is not None and complete:
        for path in publish(page, [read_log(log.location) for log in complete]):
            say(path)
    for log in logs:
        if log.status != "success":
            _say_missing(log, out)
    if len(complete) < len(logs):
        raise typer.Exit(EXIT_FAILED)


def _model(
    name: str,
    settings: CallSettings,
    budget: Budget,
    *,
    base_url: str | None,
    max_concurrent: int,
    timeout_s: float,
) -> Any:
    """One of our models as Inspect takes it."""
    from llm_flock_lab._exam.inspect_model import PREFIX

    inspect_model: Any = import_module("inspect_ai.model")
    config = inspect_model.GenerateConfig(
        max_connections=max_concurrent,
        temperature=settings.temperature,
        seed=settings.seed,
        reasoning_effort=settings.reasoning,
        max_tokens=settings.max_tokens,
    )
    # A model that was kept would belong to the event loop of an earlier evaluation.
    model: Any = inspect_model.get_model(f"{PREFIX}/{name}", base_url=base_url, config=config, memoize=False)
    model.api.prepare(settings, budget, max_concurrent=max_concurrent, timeout_s=timeout_s)
    return model


def _evaluate(models: list[Any], task_args: dict[str, Any], repeats: int, out: Path, *, quiet: bool) -> list[Any]:
    """Inspect's logs of all models, asked one after the other; what has an answer in `out` is not asked again."""
    from llm_flock_lab._exam.inspect_task import exam as task

    names = [str(model) for model in models]
    if len(set(names)) < len(names):
        raise InputError("models", ",".join(names), "each model once")
    inspect: Any = import_module("inspect_ai")
    try:
        with redirect_stdout(StringIO()) if quiet else nullcontext():
            _, logs = inspect.eval_set(
                task,
                task_args=task_args,
                model=models,
                epochs=repeats,
                log_dir=str(out),
                log_dir_allow_dirty=True,
                fail_on_error=True,
                continue_on_fail=True,
                retry_attempts=1,
                retry_immediate=False,
                max_tasks=1,
                log_level="error",  # it warns of each question without an answer
                display="none" if quiet else None,
            )
    except KeyboardInterrupt:
        say(f"interrupted; the answers so far are in {out}", error=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    return logs


def _say_missing(log: Any, out: Path) -> None:
    """Why some questions have no answer."""
    read: Any = import_module("inspect_ai.log").read_eval_log_sample_summaries
    faults = dict.fromkeys(sample.error for sample in read(log.location) if sample.error is not None)
    why = next(iter(faults), "it was broken off")
    says = f"not all questions have an answer ({why}); the same command goes on in {out}"
    say(f"error: {log.eval.model.partition('/')[2]}: {says}", error=True)
