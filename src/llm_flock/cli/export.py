"""`llm-flock export`: writes a record for other programs, and the tables of a sweep as CSV."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from llm_flock.cli.display import note_broken
from llm_flock.cli.terminal import say
from llm_flock.errors import FieldError, InputError
from llm_flock.extras import require

PAGE, LAYOUT, INDEXED, RERUN, BAG = "replay.html", "foxglove-layout.json", "foxglove.mcap", "run.rrd", "bag"
"""Names of the files."""

RECORD = "run.mcap"


def export(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar="[PATH]",
            help="Record (run.mcap) or its folder; or a directory of results, as `llm-flock sweep` writes it",
            show_default=False,
        ),
    ] = None,
    html: Annotated[
        bool, typer.Option("--html", help="Write the replay of a record as one page that needs nothing else")
    ] = False,
    foxglove: Annotated[
        bool,
        typer.Option("--foxglove", help="Write a record for Foxglove, and the layout; without PATH the layout alone"),
    ] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Write a record for the Rerun viewer")] = False,
    ros2bag: Annotated[
        bool, typer.Option("--ros2bag", help="Write a record as a bag of ROS 2 (MCAP), to a folder `bag`")
    ] = False,
    unit_m: Annotated[
        float | None,
        typer.Option(help="With --ros2bag: length of one mission unit [m] [1, or the flight's]", show_default=False),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write to [PATH]", show_default=False)] = None,
) -> None:
    """Write a record for other programs, or the two tables of a sweep as CSV. Older exports but bags are replaced.

    Without a format, PATH is a directory of results, whose tables go to trials.csv and rounds.csv.
    """
    if unit_m is not None and not ros2bag:
        raise FieldError("unit_m", unit_m, says="--unit-m is for --ros2bag")
    if path is None:
        if not foxglove or html or rerun or ros2bag:
            says = "export needs the path of a record or of a directory of results; only --foxglove works without"
            raise FieldError("path", says=says)
        _write_layout((out or Path()) / LAYOUT, None)
        return
    record = path / RECORD if path.is_dir() else path
    if not (html or foxglove or rerun or ros2bag):
        if record.is_file():
            raise FieldError(
                "format", says="a record is exported with at least one of --html, --foxglove, --rerun and --ros2bag"
            )
        _write_tables(path, out or path)
        return
    folder = out or record.parent
    from llm_flock.record.reader import read_end

    note_broken([read_end(record)], "exported")
    if foxglove:
        from llm_flock.foxglove.file import write_file

        target = folder / INDEXED
        write_file(record, target)
        say(target)
        _write_layout(folder / LAYOUT, record)
    if html:
        from llm_flock.viewer.replay_page import write_page

        write_page(record, folder / PAGE)
        say(folder / PAGE)
    if rerun:
        from llm_flock.record.reader import read_record
        from llm_flock.viz.rerun_file import write_rerun

        write_rerun(read_record(record), folder / RERUN)
        say(folder / RERUN)
    if ros2bag:
        _write_bag(record, folder / BAG, unit_m)


def _write_bag(record: Path, target: Path, unit_m: float | None) -> None:
    require("ros2", "export --ros2bag")
    from pydantic import ValidationError

    from llm_flock.ros2.bag import write_bag
    from llm_flock.runtime.ros2_config import Ros2Config
    from llm_flock.validation import input_error

    try:
        config = Ros2Config(unit_m=unit_m)
    except ValidationError as error:
        raise input_error(error, Ros2Config) from None
    say(write_bag(record, target, config))


def _write_tables(folder: Path, out: Path) -> None:
    require("sweep", "export")
    if not folder.is_dir():
        raise InputError("path", str(folder), "a record, or a directory of results as `llm-flock sweep` makes it")
    from llm_flock.experiments.tables import export_csv

    for path in export_csv(folder, out):
        say(path)


def _write_layout(target: Path, record: Path | None) -> None:
    """Write the layout; with a record, its camera sees that record's arena."""
    from llm_flock.foxglove.layout import layout_text
    from llm_flock.record.schema import MissionInfo
    from llm_flock.record.stream import RecordStream

    arena = None
    if record is not None:
        found = (entry for entry in RecordStream(record).entries() if isinstance(entry, MissionInfo))
        low, high = next(found).mission["arena"]
        arena = (tuple(low), tuple(high))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(layout_text(arena), encoding="utf-8")
    except OSError as error:
        raise InputError("out", str(target), f"a place that can be written to ({error.strerror})") from None
    say(target)
