"""`llm-flock export`: writes a record for other programs, and the tables of a sweep as CSV, by plug-ins."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from llm_flock import plugins
from llm_flock.cli._display import note_broken
from llm_flock.cli._extensions import Extension, chosen, extended
from llm_flock.cli._terminal import say
from llm_flock.errors import FieldError, InputError
from llm_flock.extras import EXTRAS


@extended("exports")
def export(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar="[PATH]",
            help="Record (run.mcap) or its folder; or a directory of results, as `llm-flock sweep` writes it",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write to [PATH]", show_default=False)] = None,
    *,
    extensions: list[Extension],
) -> None:
    """Write a record for other programs, or the two tables of a sweep as CSV. Older exports but bags are replaced.

    Without a format, PATH is a directory of results, whose tables go to trials.csv and rounds.csv.
    """
    from llm_flock.record._stream import record_file

    formats = [extension for extension in extensions if extension.flags]
    on = chosen(formats)
    record = None if path is None else record_file(path)
    if on:
        if record is not None:
            from llm_flock.record._reader import read_record

            note_broken([read_record(record)], "exported")
        for extension in on:
            for written in extension(record, out or (Path() if record is None else record.parent)):
                say(written)
        return
    if path is None:
        raise FieldError("path", says=NEEDS_PATH)
    if record is not None and record.is_file():
        flags = [f"--{extension.name}" for extension in formats]
        listed = " and ".join(filter(None, (", ".join(flags[:-1]), *flags[-1:])))
        raise FieldError("format", says=f"a record is exported with at least one of {listed}")
    if "tables" not in plugins.entries("exports"):
        says = f"export of a sweep needs the extra sweep: {EXTRAS['sweep'].install}"
        raise FieldError("extra", "sweep", says=says)
    if not path.is_dir():
        raise InputError("path", str(path), "a record, or a directory of results as `llm-flock sweep` makes it")
    for written in plugins.load("exports", "tables")(path, out or path):
        say(written)


NEEDS_PATH = "export needs the path of a record or of a directory of results; only --foxglove works without"


def needed(record: Path | None) -> Path:
    """The record to export. FieldError if there is none."""
    if record is None:
        raise FieldError("path", says=NEEDS_PATH)
    return record
