"""Records for other programs, as `llm-flock export` writes them: a page, Foxglove's and Rerun's."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from llm_flock.cli import needed

PAGE, LAYOUT, INDEXED, RERUN = "replay.html", "foxglove-layout.json", "foxglove.mcap", "run.rrd"  # names of the files


def export_html(
    record: Path | None,
    folder: Path,
    *,
    html: Annotated[
        bool, typer.Option("--html", help="Write the replay of a record as one page that needs nothing else")
    ] = False,
) -> Iterator[Path]:
    """Write a record as a page; gives the path of each file once it is written."""
    from llm_flock_view._viewer.replay_page import write_page

    write_page(needed(record), folder / PAGE)
    yield folder / PAGE


def export_foxglove(
    record: Path | None,
    folder: Path,
    *,
    foxglove: Annotated[
        bool,
        typer.Option("--foxglove", help="Write a record for Foxglove, and the layout; without PATH the layout alone"),
    ] = False,
) -> Iterator[Path]:
    """Write a record as Foxglove reads it, and a layout whose camera sees that record's arena."""
    from llm_flock.record import MissionInfo, RecordStream
    from llm_flock_view._figures.style import whole_file
    from llm_flock_view._foxglove.file import write_file
    from llm_flock_view._foxglove.layout import layout_text

    arena = None
    if record is not None:
        write_file(record, folder / INDEXED)
        yield folder / INDEXED
        found = (entry for entry in RecordStream(record).entries() if isinstance(entry, MissionInfo))
        low, high = next(found).mission["arena"]
        arena = (tuple(low), tuple(high))
    target = folder / LAYOUT
    with whole_file(target) as part:
        part.write_text(layout_text(arena), encoding="utf-8")
    yield target


def export_rerun(
    record: Path | None,
    folder: Path,
    *,
    rerun: Annotated[bool, typer.Option("--rerun", help="Write a record for the Rerun viewer")] = False,
) -> Iterator[Path]:
    """Write a record as Rerun reads it."""
    from llm_flock.record import read_record
    from llm_flock_view._figures.rerun_file import write_rerun

    write_rerun(read_record(needed(record)), folder / RERUN)
    yield folder / RERUN
