"""Shows a run in the terminal: a live line while it flies, a table at its end, and its record."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.panel import Panel
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from llm_flock.cli._extensions import Extension, extended
from llm_flock.cli._terminal import Screen, say
from llm_flock.errors import FieldError, InputError
from llm_flock.file_lock import is_written
from llm_flock.printable import one_line, printable, shape_title
from llm_flock.record._words import begun, caveats, counted, formed_text, help_text, rules_text, verdict, work_text

if TYPE_CHECKING:
    from llm_flock.record._reader import RunRecord
    from llm_flock.runtime._result import RunResult, Summary
    from llm_flock.runtime._trial import TrialProgress


RecordPath = Annotated[Path, typer.Argument(help="Record of a run (run.mcap), or the folder that holds it")]

MAX_MESSAGE = 100_000  # characters shown of a message of a conversation; the record has all of it


def live_line(
    label: str, *, enabled: bool, waiting: str = ""
) -> tuple[AbstractContextManager[None], Callable[[TrialProgress], None]]:
    """A context manager that shows a run on stderr while it is open, and a function to call after each round.

    A terminal redraws one line; a log or a pipe gets a line per round. `waiting` is the text until then. Nothing is
    printed before the context is entered.
    """
    console = Screen(stderr=True)
    redraws = enabled and console.is_terminal
    bar = Progress(
        SpinnerColumn(),
        # A field without markup: the user's label may hold brackets and braces.
        TextColumn("{task.fields[label]}", style="bold", markup=False),
        BarColumn(bar_width=20),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        console=console,
        disable=not redraws,
    )
    task = bar.add_task(waiting or "asking every model for a plan ...", total=None, label=label)

    @contextmanager
    def opened() -> Generator[None]:
        if waiting and enabled and not redraws:
            console.print(waiting, highlight=False, markup=False, soft_wrap=True)
        with bar:
            yield

    def show(now: TrialProgress) -> None:
        if not now.n_robots:  # no robot is there yet
            return
        bar.update(task, description=now.text, completed=now.at_goal, total=now.n_robots)
        if enabled and not redraws:
            console.print(now.text, highlight=False, soft_wrap=True)

    return opened(), show


def summary_table(result: RunResult) -> Table:
    """The result of a run as a table."""
    summary, mission = result.summary, result.mission
    safe = f"(safe distance {mission.safe_distance:g}){mission.by_height}"
    simulated = " (simulated language models)" if summary.simulated else ""
    title = escape(f"{shape_title(summary.shape)}, {summary.n_robots} robots, {', '.join(summary.models)}{simulated}")
    table = Table(title=title, show_header=False, title_justify="left")
    table.add_column(style="dim")
    table.add_column()
    rows = [
        ("protocol", rules_text(summary.consensus, summary.assignment, shield=summary.shield)),
        ("formed", _formed_text(summary)),
        ("stopped", f"{summary.stopped}, after {summary.rounds} rounds"),
        ("plans in use", str(summary.plans_in_use)),
        ("distinct goals", f"{summary.distinct_goals} of {summary.awake}"),
        ("error", _number(summary.procrustes_mean, "mean distance to the ideal shape {:.3f}")),
        ("smallest separation", _number(summary.min_separation, "{:.3f}") + f" {safe}"),
        ("work", escape(work_text(summary.to_dict())) or "none"),
        ("model calls", f"{summary.model_calls} ({summary.calls_rejected} rejected, {summary.calls_failed} failed)"),
        ("tokens", f"{summary.tokens_input:,} in, {summary.tokens_output:,} out"),
        ("cost", _number(summary.cost_usd, "{:.4f} USD") if not summary.simulated else "none (simulated)"),
        ("time", f"{summary.wall_s:.2f} s"),
    ]
    given = [
        f"{shape_title(m.shape)} {'not formed' if m.formed is None else f'formed in round {m.formed}'}"
        + (f" (given in round {m.round})" if m.round else "")
        for m in summary.missions
    ]
    beware = caveats(summary.to_dict(), result.mission.model_dump())
    special = [
        ("missions", escape(", ".join(given)) if len(given) > 1 else ""),
        ("died", ", ".join(summary.killed)),
        ("joined", ", ".join(summary.joined)),
        ("answered by", escape(", ".join(sorted({*summary.answered_by} - {*summary.models})))),
        ("beware", "[bold red]" + escape("; ".join(beware)) + "[/]" if beware else ""),
        ("smallest clearance", _number(summary.min_clearance, "{:.3f}") if summary.min_clearance is not None else ""),
        ("nearest sensed", _number(summary.nearest_read, "{:.3f}") if summary.nearest_read is not None else ""),
        ("empty places", str(summary.gaps or "")),
        ("spare robots", str(summary.spares or "")),
        ("provider faults", ", ".join(f"{n} {kind}" for kind, n in summary.faults.items())),
        ("without a plan", f"{summary.robots_without_plan} robots" if summary.robots_without_plan else ""),
        ("record", escape(summary.record or "")),
    ]
    for name, value in rows + [row for row in special if row[1]]:
        table.add_row(name, value)
    return table


def _formed_text(summary: Summary) -> str:
    bound = "" if summary.lower_bound_rounds is None else f" (lower bound {summary.lower_bound_rounds})"
    if formed := formed_text(result := summary.to_dict()):
        # Bounds count from when the last mission was given, as do rounds to the formation.
        several = len(summary.missions) > 1
        took = f", {counted(summary.rounds_to_formed, 'round')} after the last order" if several else ""
        return f"[bold green]yes[/], {formed.removeprefix('formed ')}{took}{bound}{help_text(result)}"
    reason = f"; {summary.reason}" if summary.stopped == "rounds" and summary.reason else ""
    return f"[bold red]no[/]{bound}{reason}"


def no_success(summary: Summary, fallback: str | None) -> str:
    """Why a run ended early, as a sentence: no model answered, or none gave an acceptable plan."""
    spent = f"after {summary.rounds} rounds and {summary.model_calls} calls"
    if summary.stopped == "no_answers":
        return f"no model answered, {spent}: {summary.reason}"
    hint = "; --fallback geometry lets geometry make the plan" if fallback == "breaker" else ""
    reason = (summary.reason or "").rstrip(".")
    return f"no robot has a plan, and no model of the team gives an acceptable one, {spent}; most often, {reason}{hint}"


def _number(value: float | None, form: str) -> str:
    return "not known" if value is None else form.format(value)


def show_overview(record: RunRecord) -> None:
    """Print the mission, and its progress round by round."""
    console = Screen()
    mission = record.mission.mission
    names = "simulated language models" if record.run.simulated else ", ".join(record.models)
    models = f" · {one_line(names)}" if names else ""
    state = "complete" if record.complete else "ends early (the run was stopped)"
    if record.result is not None and record.result.get("stopped") == "interrupted":
        calls, tokens = record.result["model_calls"], record.result["tokens"]
        state = f"interrupted in round {record.rounds + 1}, after {calls} calls and {tokens:,} tokens"
    elif not record.complete and is_written(record.path):
        state = "under way"
    # Text(...) keeps brackets in names, answers and templates from being read as markup.
    shape = one_line(shape_title(mission["shape"]))
    console.print(Text(f"{shape}, {mission['n_robots']} robots, seed {record.run.seed}{models} · {state}"))
    for sentence in record.run.unrepeatable or ():
        console.print(Text(one_line(sentence)))
    if record.result is not None and (work := work_text(record.result)):
        console.print(Text(one_line(work)))
    for caveat in caveats(record.result or {}, mission):
        console.print(Text(begun(caveat), style="bold red"))
    console.print(Text(one_line(f"{record.outcome().headline}."), style="bold"))
    if why := record.diagnosis().why:
        console.print(Text(one_line(why)))
    table = Table("round", "at goal", "plans", "goals", "error", "separation", "calls", "tokens")
    for row in record.metrics:
        table.add_row(
            str(row.round),
            str(row.robots_at_goal),
            str(row.plans_in_use),
            str(row.distinct_goals),
            "-" if row.procrustes_mean is None else f"{row.procrustes_mean:.3f}",
            "-" if row.min_separation is None else f"{row.min_separation:.2f}",
            str(row.model_calls),
            str(row.tokens),
        )
    console.show(table)


def note_broken(records: Iterable[RunRecord], done: str = "drawn") -> None:
    """Warn of records that end early. Call before they are drawn, or `done` otherwise."""
    for record in records:
        if not record.complete:
            text = f"{record.path} ends early (the run was stopped): {done} up to round {record.rounds}"
            say(f"warning: {text}", error=True)


def note_replaced(path: Path) -> None:
    """Warn of a file that will be replaced. Call before it is written over."""
    if path.exists():
        say(f"warning: {path} was there and is replaced", error=True)


def _start(text: str) -> str:
    """A message of a conversation, cut at MAX_MESSAGE characters."""
    more = len(text) - MAX_MESSAGE
    return printable(text[:MAX_MESSAGE]) + (f"\n... and {more:,} more characters" if more > 0 else "")


def show_conversation(record: RunRecord, robot: int | None, round_number: int | None) -> None:
    """Print every call of one robot, of one round, or both."""
    calls = [
        entry
        for entry in record.llm
        if (robot is None or entry.robot == robot) and (round_number is None or entry.round == round_number)
    ]
    n_robots = record.mission.mission["n_robots"]
    if robot is not None and robot >= n_robots:
        raise InputError("robot", robot, says=f"there are robots 0 to {n_robots - 1}")
    if round_number is not None and round_number > record.rounds:
        raise InputError("round", round_number, says=f"there are rounds 0 to {record.rounds}")
    if not calls:
        who = "" if robot is None else f" by robot {robot}"
        rounds = sorted({entry.round for entry in record.llm if robot in (None, entry.robot)})
        if not rounds:
            raise FieldError("robot", robot, says=f"no model was asked{who} in this run")
        raise InputError(
            "round", round_number, says=f"no model was asked{who} then; calls in rounds {rounds[0]} to {rounds[-1]}"
        )
    console = Screen()
    for entry in calls:
        title = f"robot {entry.robot} · round {entry.round} · {entry.kind} · attempt {entry.attempt} · {entry.model}"
        for message in entry.messages:
            console.print(
                Panel(Text(_start(message.text)), title=Text(f"{title} · {message.role}"), title_align="left")
            )
        if entry.text is not None:
            answer = Text(f"{title} · answer")
            console.print(Panel(Text(_start(entry.text)), title=answer, title_align="left", border_style="green"))
        faults = f" · faults: {one_line(', '.join(entry.faults))}" if entry.faults else ""
        tokens = f"{entry.usage.input} tokens in, {entry.usage.output} out"
        console.print(Text(f"{one_line(verdict(entry), 20_000)} · {tokens} · {entry.latency_s:.3f} s{faults}"))


@extended("inspections")
def inspect(
    record: RecordPath,
    robot: Annotated[int | None, typer.Option(min=0, help="Show only this robot's conversation")] = None,
    round_number: Annotated[int | None, typer.Option("--round", min=0, help="Show only this round")] = None,
    *,
    extensions: list[Extension],
) -> None:
    """Show a record: its summary, or the conversation of a robot with its model."""
    from llm_flock.record._reader import read_record

    run = read_record(record)
    if robot is None and round_number is None:
        show_overview(run)
        for extension in extensions:
            extension(run)
    else:
        show_conversation(run, robot, round_number)
