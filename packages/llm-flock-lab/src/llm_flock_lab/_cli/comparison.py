"""`llm-flock compare`: many seeded trials of several protocols and shapes."""

from __future__ import annotations

import json
import os
import time
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from llm_flock.cli import EXIT_FAILED, EXIT_INTERRUPTED, Screen, say, with_config_flags
from llm_flock.errors import InputError, unknown

if TYPE_CHECKING:
    from llm_flock_lab._experiments.grid import Cell
    from llm_flock_lab._experiments.trial import TrialResult


WIDE = 140  # columns of a terminal that take all of the table
FIRST_S = 3.0  # time after the first trial of a comparison, after which the rest is estimated [s]


@with_config_flags(
    shown=("model", "base_url", "max_cost", "rounds", "kill_random", "loss"),
    # These differ between cells or trials, or are files of a single run.
    without=("protocol", "shape", "n_robots", "seed", "out", "record_llm"),
)
def compare(
    cells: Annotated[
        str, typer.Option(help="Shapes and team sizes: SHAPE/N with commas between them", metavar="SHAPE/N,...")
    ] = "triangle/3,triangle/6,square/8,cross/5,circle/10,circle/20",
    protocols: Annotated[str, typer.Option(help="Presets with commas between them")] = "flock,paper,baseline",
    trials: Annotated[int, typer.Option(min=1, help="Trials of each row")] = 100,
    first_seed: Annotated[int, typer.Option(min=0, help="Seed of the first trial; the others follow it")] = 0,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes [one for each core]", show_default=False)] = None,
    fit_arena: Annotated[
        bool, typer.Option("--fit-arena", help="Grow the arena of a team until its formation and its starts fit")
    ] = False,
    config: Annotated[Path | None, typer.Option(help="Configuration file (TOML); flags override it")] = None,
    out: Annotated[Path | None, typer.Option(help="CSV file to write, with a line for each trial")] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print a JSON list of rows instead of a table")] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown")] = False,
    as_latex: Annotated[bool, typer.Option("--latex", help="Print the table in LaTeX")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress")] = False,
    **flags: Any,
) -> None:
    """Fly many seeded trials of several protocols and shapes, and print a table of the results.

    Flags of the configuration hold for every trial, budgets too. Trials are not recorded; `run --seed` repeats one.
    """
    from llm_flock.runtime import PRESETS, check_planners
    from llm_flock_lab._experiments import compare as comparison
    from llm_flock_lab._experiments.grid import parse_teams

    for field, value, other in (("as_markdown", as_markdown, "--latex"), ("as_latex", as_latex, "--markdown")):
        if value and (json_output or (as_markdown and as_latex)):
            raise InputError(field, None, says=f"has no effect with {'--json' if json_output else other}")
    presets = [name.strip() for name in protocols.split(",")]
    for name in presets:
        if name not in PRESETS:
            raise InputError("protocols", name, says=unknown("protocol", name, PRESETS))
    found = comparison.build_cells(parse_teams(cells), presets, file=config, fit_arena=fit_arena, **flags)
    for cell in found:  # before the file is there: it would be in the way of the next try
        check_planners(cell.config)
    finished = formed = every = 0
    began, told = 0.0, quiet
    try:
        with ExitStack() as stack:
            add = None if out is None else stack.enter_context(comparison.trial_file(out))

            def note(cell: Cell, seed: int, result: TrialResult) -> None:
                nonlocal finished, formed, every, began, told
                every, began = every + 1, began or time.monotonic()  # workers take a while to begin
                if not told and (spent := time.monotonic() - began) > FIRST_S:
                    left, told = trials * len(found) - every, True
                    say(f"{left} more trials: about {_time_words(spent / (every - 1) * left)}", error=True)
                if add is not None:
                    add(cell, seed, result)
                finished, formed = finished + 1, formed + result.formed
                if finished == trials:
                    if not quiet:
                        text = f"{cell.protocol} {cell.shape} {cell.n_robots}: {formed} of {trials} formed"
                        say(text, error=True)
                    finished = formed = 0

            jobs = jobs or os.cpu_count() or 1
            rows = comparison.compare(found, trials=trials, first_seed=first_seed, jobs=jobs, on_result=note)
    except KeyboardInterrupt:
        say(f"interrupted{f'; finished trials are in {out}' if out else ''}", error=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if json_output:
        say(json.dumps([asdict(row) for row in rows], allow_nan=False))
    elif as_markdown or as_latex:
        say((comparison.markdown if as_markdown else comparison.latex)(rows))
    else:
        screen, columns = Screen(), comparison.COLUMNS
        # In a narrow terminal, two tables are read better than columns of a few letters.
        for part in (columns,) if screen.width >= WIDE else (columns[:7], columns[:3] + columns[7:]):
            table = Table(*(name for name, _ in part))
            for row in rows:
                table.add_row(*(escape(text(row)) for _, text in part))
            screen.show(table)
        for line in comparison.notes(rows):
            say(line)
    if any(row.broken for row in rows):
        raise typer.Exit(EXIT_FAILED)


def _time_words(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
