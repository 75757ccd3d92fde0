"""Show a sweep in the terminal: its forecast, its progress and its result."""

from __future__ import annotations

import json
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from datetime import timedelta
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table

from llm_flock.cli import Screen, budget_text, cost_text, say, short
from llm_flock.runtime import Expected
from llm_flock_lab._experiments.sweep import SweepStatus
from llm_flock_lab._experiments.sweep_file import Sweep
from llm_flock_lab._experiments.tally import Tally


@contextmanager
def sweep_line(name: str, *, enabled: bool) -> Generator[Tally]:
    """One line on stderr that shows a tally: trials, ETA, and calls, tokens and money, spent and expected."""
    console = Screen(stderr=True)
    redraw = enabled and console.is_terminal
    shown = 0.0

    def show(force: bool) -> None:
        nonlocal shown
        now = time.monotonic()
        if not force and now - shown < (0.2 if redraw else 10.0):
            return
        shown = now
        text = progress_text(tally)
        bar.update(task, description=text, completed=tally.over, total=max(1, tally.trials))
        if enabled and not redraw:
            console.print(text, highlight=False, soft_wrap=True, markup=False)

    tally = Tally(on_change=show)
    bar = Bar(
        SpinnerColumn(),
        TextColumn("{task.fields[label]}", style="bold", markup=False),
        BarColumn(bar_width=20),
        TextColumn("{task.description}", markup=False),
        console=console,
        disable=not redraw,
    )
    task = bar.add_task("", total=None, label=name)
    with bar:
        try:
            yield tally
        finally:
            show(True)


def progress_text(tally: Tally) -> str:
    """The line, without its bar."""
    spent, forecast, eta = tally.used, tally.forecast, tally.eta_s
    parts = [f"{tally.over}/{tally.trials} trials", f"{tally.formed} formed"]
    parts += [f"{tally.broken} broken off"] if tally.broken else []
    parts += [f"{tally.cut} cut by the budget"] if tally.cut else []
    if tally.over < tally.trials:
        parts += [f"ETA {'?' if eta is None else timedelta(seconds=round(eta))}"]
    parts += [f"calls {spent.calls:,} of ~{forecast.calls:,}", f"tokens {spent.tokens:,} of ~{forecast.tokens:,}"]
    if forecast.cost_usd:
        parts += [f"{spent.cost_usd:.2f} of ~{forecast.cost_usd:.2f} USD"]
    return " · ".join(parts)


def show_expected(sweep: Sweep, expected: Mapping[str, Expected], left: Mapping[str, int], *, as_json: bool) -> None:
    """Print the expected use of the trials that are left, cell by cell and in total."""
    total = sum((expected[cell].times(count) for cell, count in left.items()), Expected())
    if as_json:
        cells = {cell: {"trials": count, **asdict(expected[cell].times(count))} for cell, count in left.items()}
        found = {"name": sweep.file.sweep.name, "trials": len(sweep.trials), "left": sum(left.values())}
        say(json.dumps({**found, "expected": asdict(total), "cells": cells}, allow_nan=False))
        return
    table = Table(title=escape(sweep.file.sweep.name), title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("cell")
    for name in ("trials\nleft", "calls", "at most", "tokens\nin", "tokens\nout", "cost\n(USD)"):
        table.add_column(name, justify="right", no_wrap=True)
    for cell, count in left.items():
        table.add_row(escape(cell), *_figures(count, expected[cell].times(count)))
    table.add_section()
    table.add_row(f"all {len(left)} cells", *_figures(sum(left.values()), total))
    console = Screen()
    console.show(table)
    console.print(
        f"{len(sweep.trials)} trials, {len(sweep.trials) - sum(left.values())} of them flown.", highlight=False
    )
    if any(spec.waits for spec in sweep.trials):
        console.print(
            f"Assumed: {sweep.file.expect.output_tokens} tokens an answer, and answers as useful as those of "
            f"simulated:{sweep.file.expect.profile}; cells with flown trials go on as these did. Prices are list "
            "prices. Nothing was asked of any model.",
            highlight=False,
        )
    budget = sweep.file.budget
    console.print(budget_text(budget.max_calls, budget.max_tokens, budget.max_cost), highlight=False)


def _figures(count: int, found: Expected) -> list[str]:
    plain = (count, found.calls, found.at_most, found.tokens_input, found.tokens_output)
    return [*map(short, plain), cost_text(found.cost_usd)]


def show_status(status: SweepStatus, folder: Path, *, as_json: bool) -> None:
    """Print how a sweep ended."""
    if as_json:
        say(json.dumps({"dir": str(folder), **asdict(status), "complete": status.complete}))
        return
    left = status.trials - status.finished
    say(f"{status.finished} of {status.trials} trials: {status.formed} formed, {status.broken} broken off")
    say(folder)
    if status.other_code:
        say(f"{status.other_code} of them were flown by other code (column `code`)", error=True)
    if status.reason is not None:
        say(f"{status.reason}; {left} trials are left ({status.cut} were cut short)", error=True)
