"""`llm-flock exam`: which model can fly?"""

from __future__ import annotations

import asyncio
import json
import os
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from llm_flock.cli.options import EXIT_FAILED, EXIT_INTERRUPTED
from llm_flock.cli.terminal import Screen, say
from llm_flock.errors import InputError

if TYPE_CHECKING:
    from llm_flock.exam.examinee import Setup
    from llm_flock.exam.figures import ExamFigures
    from llm_flock.exam.session import Finished, Paper

Text = str | None
Count = int | None


def exam(
    models: Annotated[list[str] | None, typer.Argument(metavar="MODEL...", help="As in run --model")] = None,
    split: Annotated[str, typer.Option(help="Questions: public, or private with a --seed of your own")] = "public",
    seed: Annotated[Count, typer.Option(min=0, help="Seed of a private split", show_default=False)] = None,
    sections: Annotated[Text, typer.Option(help="Sections with commas between them [all]", show_default=False)] = None,
    limit: Annotated[Count, typer.Option(min=1, help="Most questions of a section", show_default=False)] = None,
    repeats: Annotated[int, typer.Option(min=1, max=1000, help="How often each question is asked")] = 1,
    missions: Annotated[
        int, typer.Option(min=0, help="Missions to fly then with each of four teams, fallbacks off and on")
    ] = 0,
    out: Annotated[Path, typer.Option(help="Folder of results; an exam that broke off goes on there")] = Path(
        "runs/exam"
    ),
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the calls, tokens and cost to expect, and ask no model")
    ] = False,
    page: Annotated[
        Path | None, typer.Option(help="Add the rows to the leaderboard in this folder, or only write its page")
    ] = None,
    export: Annotated[
        Path | None, typer.Option(help="Write the questions to this file (JSON lines), and ask no model")
    ] = None,
    dataset: Annotated[
        Path | None,
        typer.Option(help="Write the questions to this folder as a dataset for the Hugging Face Hub; ask no model"),
    ] = None,
    prompts: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    frame: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    answers: Annotated[str, typer.Option(help="Form of answers: text or json")] = "text",
    base_url: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    temperature: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    model_seed: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    reasoning_effort: Annotated[Text, typer.Option(help="As in run", show_default=False)] = None,
    max_answer_tokens: Annotated[Count, typer.Option(min=1, help="As in run", show_default=False)] = None,
    max_concurrent: Annotated[int, typer.Option(min=1, help="Questions under way at once")] = 8,
    timeout_s: Annotated[float, typer.Option(min=0.1, help="Longest wait for an answer [s]")] = 120.0,
    max_calls: Annotated[
        Count, typer.Option(min=1, help="Budget of each model, earlier sessions included", show_default=False)
    ] = None,
    max_tokens: Annotated[Count, typer.Option(min=1, help="The same, in and out", show_default=False)] = None,
    max_cost: Annotated[float | None, typer.Option(min=0.0, help="The same [US dollars]", show_default=False)] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print a JSON list of rows instead of tables")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress")] = False,
) -> None:
    """Ask models the questions that robots ask, and score their answers by code.

    Prompts, parsers and checks are those of a run. Results and recordings are kept in a folder.
    """
    from llm_flock.exam.dataset import write_dataset
    from llm_flock.exam.examinee import Setup
    from llm_flock.exam.leaderboard import write_page
    from llm_flock.exam.questions import to_lines
    from llm_flock.exam.session import Paper
    from llm_flock.exam.splits import VERSION

    paper = Paper(split=split, seed=seed, sections=sections, limit=limit, repeats=repeats)
    if export is not None:
        _export(export, to_lines(paper.questions()))
    if dataset is not None:
        for path in write_dataset(dataset, paper.questions(), version=VERSION, split=paper.split):
            say(path)
    if export is not None or dataset is not None:
        return
    if not models:
        if page is None:
            raise InputError("models", None, "at least one model, such as simulated:ideal")
        say(write_page(page))
        return
    setups = [
        Setup(
            model=model,
            prompts=prompts,
            frame=frame,
            answers=answers,
            base_url=base_url,
            temperature=temperature,
            model_seed=model_seed,
            reasoning_effort=reasoning_effort,
            max_answer_tokens=max_answer_tokens,
            max_concurrent=max_concurrent,
            timeout_s=timeout_s,
            max_calls=max_calls,
            max_tokens=max_tokens,
            max_cost=max_cost,
        )
        for model in models
    ]
    if page is not None and any(model.startswith("replay:") for model in models):
        raise InputError(
            "page", str(page), "models that are asked now, as a recording is of a row that is there already"
        )
    if dry_run:
        _show_expected(setups, paper, as_json=json_output)
        return
    asyncio.run(_check(setups, paper, page, missions=missions > 0))
    finished = [_hold(setup, paper, out, quiet=quiet or json_output) for setup in setups]
    for setup, one in zip(setups, finished, strict=True):
        if missions and one.row is not None:
            one.row["missions"] = _fly(setup, missions)
            one.row["command"] += f" --missions {missions}"
    if json_output:
        say(json.dumps([one.row for one in finished], allow_nan=False))
    else:
        for one in finished:
            _show(one)
            _show_missions(one)
    if page is not None:
        _publish(finished, page)
    if not all(one.complete for one in finished):
        why = "the budget is used up, or the provider failed"
        say(f"error: not all questions have an answer: {why}; the same command goes on in {out}", error=True)
        raise typer.Exit(EXIT_FAILED)


def _export(path: Path, text: str) -> None:
    """Write the questions to a new file."""
    from llm_flock.experiments.store import write_whole

    if os.path.lexists(path):
        raise InputError("export", str(path), "a file that is not there yet: none is overwritten")
    if not path.parent.is_dir():
        raise InputError("export", str(path), "a file in a folder that is there")
    write_whole(path, text.encode())
    say(path)


async def _check(setups: list[Setup], paper: Paper, page: Path | None, *, missions: bool) -> None:
    """Refuse what cannot be asked or published before the first model is asked, which may cost money."""
    from llm_flock.exam.examinee import Examinee
    from llm_flock.exam.leaderboard import check_page, slug
    from llm_flock.exam.sit import asked_of

    names: dict[str, str] = {}
    for setup in setups:
        stem = slug(setup.model)
        if stem in names:
            same = f"its results have the file name of those of {names[stem]}: ask it with another --out"
            raise InputError("models", setup.model, says="is named twice" if names[stem] == setup.model else same)
        names[stem] = setup.model
        async with Examinee(setup) as examinee:
            examinee.check()
            questions = asked_of(examinee, paper.questions())
        if page is not None:
            check_page(page, setup.model, paper.split, paper.seed, len(questions), missions=missions)


def _hold(setup: Setup, paper: Paper, out: Path, *, quiet: bool) -> Finished:
    """One model's exam, with a line after every fifty questions."""
    from llm_flock.exam.ask import Outcome
    from llm_flock.exam.session import hold_exam

    total = done = right = 0

    def start(questions: int, known: int) -> None:
        nonlocal total, done
        total, done = questions, known
        if known and not quiet:
            say(f"{setup.model}: {known} of {questions} questions are answered already", error=True)

    def note(outcome: Outcome) -> None:
        nonlocal done, right
        done, right = done + 1, right + (outcome.tries == 0)
        if not quiet and (done % 50 == 0 or done == total):
            say(f"{setup.model}: {done} of {total} questions, {right} right at first ask just now", error=True)

    try:
        return asyncio.run(hold_exam(setup, paper, out, today=date.today(), on_start=start, on_outcome=note))
    except KeyboardInterrupt:
        say(f"interrupted; the answers so far are in {out}", error=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None


def _fly(setup: Setup, trials: int) -> list[dict[str, Any]]:
    """The second part, on all cores."""
    from llm_flock.exam.missions import fly_missions, plain_missions

    return plain_missions(fly_missions(setup, trials, jobs=os.cpu_count() or 1))


def _show_missions(one: Finished) -> None:
    """A table of the second part, if it was flown."""
    from llm_flock.exam.leaderboard import MISSION_COLUMNS

    if one.row is None or not one.row.get("missions"):
        return
    table = Table(*(name for name, _ in MISSION_COLUMNS))
    for found in one.row["missions"]:
        table.add_row(*(escape(text(found)) for _, text in MISSION_COLUMNS))
    Screen().show(table)


def _publish(finished: list[Finished], page: Path) -> None:
    from llm_flock.exam.leaderboard import publish

    for one in finished:
        if one.row is not None:
            for path in publish(page, one.row, one.recording):
                say(path)


def _show(one: Finished) -> None:
    """A table of the sections, one of sizes and distances, and what it took."""
    from llm_flock.exam.figures import exam_figures

    found = exam_figures(one.outcomes)
    simulated = " (simulated)" if one.sitting.simulated else ""
    columns = ("section", "questions", "first ask", "one reason", "two", "readable", "as flown", "apart")
    table = Table(*columns, "median error", r"off course \[deg]")
    table.title, table.title_justify = escape(f"{one.sitting.setup['model']}{simulated}"), "left"
    for name, section in found.sections.items():
        table.add_row(
            name,
            str(section.questions),
            _interval(section.first),
            *(_share(value) for value in (section.one.value, section.two.value, section.readable, section.flyable)),
            "" if section.separation is None else _share(section.separation),
            "" if section.error is None else f"{section.error:.2f}",
            "" if section.degrees is None else f"{section.degrees:.1f}",
        )
    screen = Screen()
    screen.show(table)
    screen.show(_bands(found))
    use, cost = found.use, found.use.cost_usd
    money = "cost not known" if cost is None else f"{cost:.4f} US dollars"
    total = f"total {_interval(found.total)} at first ask, {_interval(found.total_two)} after two reasons"
    screen.print(
        f"{total}; {use.calls} calls, {use.tokens_input} tokens in, {use.tokens_output} out, {money}", highlight=False
    )
    if not one.complete:
        say("These are the questions that were answered; the exam is not complete.")
    if one.row is not None and one.row["seen_in_training"] is not None:
        shares = ", ".join(f"{name} {_share(share)}" for name, share in one.row["seen_in_training"].items() if share)
        say(f"prompts that were in the training set: {shares or 'none'}")


def _bands(found: ExamFigures) -> Table:
    table = Table("section", "by", "questions", "first ask", "median error", "unsteady")
    for kind, unit in ((found.sizes, "places"), (found.distances, "step limits")):
        for section, bands in kind.items():
            for band, figures in bands.items():
                error = "" if figures.error is None else f"{figures.error:.2f}"
                count, first = str(figures.questions), _interval(figures.first)
                table.add_row(section, f"{band} {unit}", count, first, error, _share(figures.unsteady))
    return table


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"


def _interval(estimate: Any) -> str:
    return rf"{_share(estimate.value)} \[{100 * (estimate.low or 0):.0f}, {100 * (estimate.high or 0):.0f}]"


def _show_expected(setups: list[Setup], paper: Paper, *, as_json: bool) -> None:
    """What each model would be asked, and what that would cost."""
    from llm_flock.cli.sweep_display import short
    from llm_flock.exam.examinee import Examinee
    from llm_flock.exam.forecast import expected_use
    from llm_flock.exam.sit import asked_of

    table = Table("model", "questions", "calls", "at most", "tokens in", "tokens out", "US dollars")
    plain: list[dict[str, Any]] = []
    for setup in setups:
        examinee = Examinee(setup)
        questions = asked_of(examinee, paper.questions())
        found = expected_use(examinee, questions, paper.repeats)
        plain.append({"model": setup.model, "questions": len(questions) * paper.repeats, "expected": asdict(found)})
        cost = "not known" if found.cost_usd is None else f"{found.cost_usd:,.2f}"
        counts = (found.calls, found.at_most, found.tokens_input, found.tokens_output)
        table.add_row(escape(setup.model), str(len(questions) * paper.repeats), *map(short, counts), cost)
    if as_json:
        say(json.dumps(plain, allow_nan=False))
        return
    Screen().show(table)
    say("Assumed: first answers that are right, 400 tokens each, thoughts included; list prices. Nothing was asked.")
