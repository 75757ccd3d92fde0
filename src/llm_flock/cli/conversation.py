"""Shows a record in the terminal: its overview, or the conversation of a robot with its model."""

from __future__ import annotations

from rich.console import Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from llm_flock.errors import InputError
from llm_flock.record.reader import RunRecord
from llm_flock.record.words import verdict


def show_overview(record: RunRecord) -> None:
    """Print the mission, and its progress round by round."""
    console = Console()
    mission = record.mission.mission
    simulated = " · simulated language models" if record.run.simulated else ""
    state = "complete" if record.complete else "ends early (the run was stopped)"
    # Text(...) keeps brackets in names, answers and templates from being read as markup.
    console.print(
        Text(f"{mission['shape']}, {mission['n_robots']} robots, seed {record.run.seed}{simulated} · {state}")
    )
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
    console.print(table)


def show_conversation(record: RunRecord, robot: int | None, round_number: int | None) -> None:
    """Print every call of one robot, of one round, or both.

    Raises:
        InputError: the record holds no such call.
    """
    found = [
        entry
        for entry in record.llm
        if (robot is None or entry.robot == robot) and (round_number is None or entry.round == round_number)
    ]
    if not found:
        raise InputError("robot/round", f"{robot}/{round_number}", "a robot and round with model calls in this record")
    console = Console()
    for entry in found:
        title = f"robot {entry.robot} · round {entry.round} · {entry.kind} · attempt {entry.attempt} · {entry.model}"
        for message in entry.messages:
            console.print(Panel(Text(message.text), title=Text(f"{title} · {message.role}"), title_align="left"))
        if entry.text is not None:
            answer = Text(f"{title} · answer")
            console.print(Panel(Text(entry.text), title=answer, title_align="left", border_style="green"))
        faults = f" · faults: {', '.join(entry.faults)}" if entry.faults else ""
        tokens = f"{entry.usage.input} tokens in, {entry.usage.output} out"
        console.print(Text(f"{verdict(entry)} · {tokens} · {entry.latency_s:.3f} s{faults}"))
