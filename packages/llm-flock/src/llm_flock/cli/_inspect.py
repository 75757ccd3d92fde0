"""`llm-flock inspect`: shows a record in the terminal."""

from __future__ import annotations

from typing import Annotated

import typer

from llm_flock.cli._display import RecordPath, record_file, show_conversation, show_overview
from llm_flock.cli._extensions import Extension, extended


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

    found = read_record(record_file(record))
    if robot is None and round_number is None:
        show_overview(found)
        for extension in extensions:
            extension(found)
    else:
        show_conversation(found, robot, round_number)
