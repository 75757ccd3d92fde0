"""`llm-flock report`: turns a directory of results into a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from llm_flock.cli import say
from llm_flock.errors import InputError
from llm_flock.extras import require
from llm_flock.record import RECORD_NAME


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Directory of results, as `llm-flock sweep` writes it")],
    out: Annotated[Path | None, typer.Option(help="Folder to write [DIR/report]", show_default=False)] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            help="Protocol, or AXIS=VALUE, that the others are compared with [AXIS=default, or baseline]",
            show_default=False,
        ),
    ] = None,
    gallery: Annotated[int, typer.Option(min=0, help="Trials in the gallery of failures")] = 6,
    formats: Annotated[str, typer.Option(help="Files of each figure: some of svg, pdf, png")] = "svg,pdf,png",
    fly_again: Annotated[
        bool,
        typer.Option(
            "--fly-again/--no-fly-again",
            help="Fly failed trials of simulated models again where no record was kept, to show what happened",
        ),
    ] = True,
    flights: Annotated[
        Path | None,
        typer.Option(
            help="Folder of records of flights, one folder for each, for the paper's figures", show_default=False
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress")] = False,
) -> None:
    """Write the report of a sweep: one HTML page that needs nothing else, the same in Markdown, and all figures.

    `draft.md` and `draft.tex` are a draft of an experimental section, with figures for a page of two columns, and
    `tables.tex` has all tables. The command can be called while the sweep runs, and then shows the finished trials. An
    older report is replaced.
    """
    require("sweep", "report")
    if not folder.is_dir():  # at once, before anything heavy is loaded
        raise InputError("dir", str(folder), "a directory of results, as `llm-flock sweep` makes it")
    records = [] if flights is None else sorted(flights.glob(f"*/{RECORD_NAME}"))
    if flights is not None and not records:
        raise InputError("flights", str(flights), f"a folder with folders in which there is a {RECORD_NAME}")
    if out is None and (folder / "report").is_symlink():  # what comes from a stranger leads nowhere else
        raise InputError("dir", str(folder / "report"), "a folder, not a link")
    from llm_flock_lab._report.page import write_report

    written = write_report(
        folder,
        out or folder / "report",
        reference=reference,
        most=gallery,
        formats=[ending.strip() for ending in formats.split(",")],
        fly_again=fly_again,
        flights=records,
        on_step=lambda step: None if quiet else say(step, error=True),
    )
    for path in written:
        if path.suffix in (".html", ".md", ".tex"):
            say(path)


def export_tables(folder: Path, out: Path) -> list[Path]:
    """Write the tables of a sweep as CSV files, for `llm-flock export`; returns their paths."""
    require("sweep", "export")
    from llm_flock_lab._experiments.tables import export_csv

    return export_csv(folder, out)
