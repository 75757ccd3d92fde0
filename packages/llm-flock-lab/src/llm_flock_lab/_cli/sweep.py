"""`llm-flock sweep`: every trial of a grid, each once."""

from __future__ import annotations

import json
import os
from collections import Counter, defaultdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from llm_flock.cli import EXIT_FAILED, EXIT_INTERRUPTED, Screen, say, with_config_flags
from llm_flock.errors import InputError
from llm_flock.extras import require


# Without axes of a grid and files of a single run.
@with_config_flags(shown=("model", "base_url"), without=("protocol", "shape", "n_robots", "seed", "out", "record_llm"))
def sweep(
    file: Annotated[Path, typer.Argument(help="The sweep (TOML)", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(help="Directory of results; an unfinished sweep there goes on [runs/NAME]")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print trials and expected calls, tokens and cost; ask no model")
    ] = False,
    variables: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Value of a variable of the file, or value to keep of an axis; repeat it for a list",
            metavar="NAME=VALUE",
        ),
    ] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="Seeds for each cell [as the file says]")] = None,
    executor: Annotated[
        Literal["auto", "one", "pool"],
        typer.Option(help="one process (trials that wait), a pool (trials that compute), or auto: chosen for each"),
    ] = "auto",
    cluster: Annotated[
        str | None, typer.Option(help="Fly on this Ray cluster: HOST:PORT, auto or ray://HOST:PORT")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes of the pool, or workers [one for each core]")
    ] = None,
    at_once: Annotated[int, typer.Option(min=1, help="Trials in flight at once that wait for answers")] = 256,
    keep_records: Annotated[
        Literal["all", "failed", "none"] | None,
        typer.Option(help="Trials whose record is kept: all, failed or none [as the file says]"),
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Fly trials again that broke off; the tables say so")] = False,
    budget_calls: Annotated[int | None, typer.Option(min=1, help="Budget of the sweep: model calls")] = None,
    budget_tokens: Annotated[int | None, typer.Option(min=1, help="Budget of the sweep: tokens in and out")] = None,
    budget_cost: Annotated[float | None, typer.Option(help="Budget of the sweep: cost [US dollars]")] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress")] = False,
    **flags: Any,
) -> None:
    """Fly all trials of a grid, each once, on one machine or a cluster, and resume where the last run stopped.

    Flags of the configuration hold for all trials and replace an axis of the same name. After Ctrl-C or a crash, the
    same command goes on. Exit codes: 0 when all trials are finished, 1 when some are left or broke off.
    """
    require("sweep", "sweep")
    from llm_flock_lab._experiments.sweep_file import load_sweep

    budget = {"max_calls": budget_calls, "max_tokens": budget_tokens, "max_cost": budget_cost}
    given = _variables(variables or [])
    found = load_sweep(file, variables=given, seeds=seeds, budget=budget, **flags)
    from llm_flock_lab._cli.sweep_display import show_expected, show_status, sweep_line
    from llm_flock_lab._experiments.store import Store
    from llm_flock_lab._experiments.sweep import fly_sweep, load_flown
    from llm_flock_lab._experiments.tally import expect_cells

    folder = out or Path("runs") / found.file.sweep.name
    show = not quiet and not json_output
    if dry_run:
        if folder.exists() and not folder.is_dir():
            raise InputError("out", str(folder), "a folder")
        flown = load_flown(found, Store(folder)) if (folder / "trials").is_dir() else {}
        left = Counter(spec.cell for spec in found.trials if spec.id not in flown or flown[spec.id].cut)
        cells: defaultdict[str, list[Any]] = defaultdict(list)
        for trial in flown.values():
            cells[trial.cell].append(trial)
        console = Screen(stderr=True)

        def note(cell: str) -> None:
            if show and console.is_terminal:
                console.print(f"rehearsing {cell} with a stand-in", style="dim", markup=False, highlight=False)

        show_expected(found, expect_cells(found, flown=cells, on_cell=note), dict(left), as_json=json_output)
        return
    try:
        with sweep_line(found.file.sweep.name, enabled=show) as tally:
            status = fly_sweep(
                found,
                folder,
                executor=executor,
                cluster=cluster,
                jobs=jobs or (1 if cluster else os.cpu_count() or 1),
                at_once=at_once,
                keep=keep_records,
                again=again,
                display=tally,
            )
    except KeyboardInterrupt:
        say(f"interrupted; finished trials are in {folder}, and the same command goes on", error=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    show_status(status, folder, as_json=json_output)
    if status.broken or not status.complete:
        raise typer.Exit(EXIT_FAILED)


def _variables(given: list[str]) -> dict[str, list[Any]]:
    """`NAME=VALUE`, repeated; a value that is a JSON number or true or false is one."""
    found: dict[str, list[Any]] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError("set", text, "NAME=VALUE")
        try:
            parsed = json.loads(value)
        except ValueError:
            parsed = value
        found.setdefault(name.strip(), []).append(parsed if isinstance(parsed, int | float) else value)
    return found
