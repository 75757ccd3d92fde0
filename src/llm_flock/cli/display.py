"""Shows a run in the terminal: a live line while it flies, a table when it is over."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table

if TYPE_CHECKING:
    from llm_flock.runtime.result import Summary
    from llm_flock.runtime.trial import TrialProgress


class LiveLine:
    """Round, formed robots, plans, calls, tokens and cost, on stderr so that stdout stays clean.

    A terminal redraws one line; a log or a pipe gets a line per round.
    """

    def __init__(self, label: str, *, enabled: bool) -> None:
        self._console = Console(stderr=True)
        self._redraw = enabled and self._console.is_terminal
        self._plain = enabled and not self._redraw
        self._bar = Bar(
            SpinnerColumn(),
            # A field without markup: the user's label may hold brackets and braces.
            TextColumn("{task.fields[label]}", style="bold", markup=False),
            BarColumn(bar_width=20),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            console=self._console,
            disable=not self._redraw,
        )
        self._task = self._bar.add_task("asking every model for a plan ...", total=None, label=label)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, now: TrialProgress) -> None:
        """Show the state after a round."""
        error = "" if now.error is None else f" · error {now.error:.2f}"
        cost = "" if not now.cost_usd else f" · {now.cost_usd:.4f} USD"
        text = (
            f"round {now.round} · at goal {now.at_goal}/{now.n_robots} · plans {now.plans_in_use} · "
            f"goals {now.distinct_goals}{error} · calls {now.model_calls} · tokens {now.tokens:,}{cost}"
        )
        self._bar.update(self._task, description=text, completed=now.at_goal, total=now.n_robots)
        if self._plain:
            self._console.print(text, highlight=False, soft_wrap=True)


def summary_table(summary: Summary, safe_distance: float) -> Table:
    """The result of a run, in words and numbers."""
    simulated = " (simulated language models)" if summary.simulated else ""
    title = escape(f"{summary.shape}, {summary.n_robots} robots, {', '.join(summary.models)}{simulated}")
    table = Table(title=title, show_header=False, title_justify="left")
    table.add_column(style="dim")
    table.add_column()
    rows: list[tuple[str, str]] = [
        ("protocol", f"{summary.consensus} + {summary.assignment}, shield {'on' if summary.shield else 'off'}"),
        ("formed", _formed(summary)),
        ("stopped", f"{summary.stopped}, after {summary.rounds} rounds"),
        ("plans in use", str(summary.plans_in_use)),
        ("distinct goals", f"{summary.distinct_goals} of {summary.n_robots}"),
        ("error", _number(summary.procrustes_mean, "mean distance to the ideal shape {:.3f}")),
        ("smallest separation", _number(summary.min_separation, "{:.3f}") + f" (safe distance {safe_distance:g})"),
        ("waypoints", ", ".join(f"{n} {who}" for who, n in summary.waypoints.items()) or "none"),
        ("model calls", f"{summary.model_calls} ({summary.calls_rejected} rejected, {summary.calls_failed} failed)"),
        ("tokens", f"{summary.tokens_input:,} in, {summary.tokens_output:,} out"),
        ("cost", _number(summary.cost_usd, "{:.4f} USD") if not summary.simulated else "none (simulated)"),
        ("time", f"{summary.wall_s:.2f} s"),
    ]
    rows += _in_flight(summary)
    if summary.faults:
        rows.append(("provider faults", ", ".join(f"{n} {kind}" for kind, n in summary.faults.items())))
    if summary.robots_without_plan:
        rows.append(("without a plan", f"{summary.robots_without_plan} robots"))
    if summary.record:
        rows.append(("record", escape(summary.record)))
    for row in rows:
        table.add_row(*row)
    return table


def _in_flight(summary: Summary) -> list[tuple[str, str]]:
    """Events in flight, and places or robots left over."""
    given = [
        f"{m.shape} {'not formed' if m.formed is None else f'formed in round {m.formed}'}"
        + (f" (given in round {m.round})" if m.round else "")
        for m in summary.missions
    ]
    rows = [
        ("missions", escape(", ".join(given)) if len(given) > 1 else ""),
        ("died", ", ".join(summary.killed)),
        ("joined", ", ".join(summary.joined)),
        ("empty places", str(summary.gaps or "")),
        ("spare robots", str(summary.spares or "")),
    ]
    return [row for row in rows if row[1]]


def _formed(summary: Summary) -> str:
    bound = "" if summary.lower_bound_rounds is None else f" (lower bound {summary.lower_bound_rounds})"
    last = " of the last mission" if len(summary.missions) > 1 else ""
    if summary.formed:
        return f"[bold green]yes[/], in round {summary.rounds_to_formed}{bound}{last}"
    if summary.rounds_to_formed is not None:
        return f"[bold red]too late[/], in round {summary.rounds_to_formed}{bound}{last}"
    return f"[bold red]no[/]{bound}"


def _number(value: float | None, form: str) -> str:
    return "not known" if value is None else form.format(value)
