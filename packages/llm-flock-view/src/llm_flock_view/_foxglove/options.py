"""Options of the commands that show a run in Foxglove while it flies. Imports nothing heavy."""

from __future__ import annotations

from typing import Annotated

import typer

from llm_flock.errors import InputError

PANEL = "Foxglove"
PORT = 8766
"""Port by default: one above the viewer's, so that both can be open."""

Foxglove = Annotated[
    bool, typer.Option("--foxglove", help="Serve the run to Foxglove while it flies", rich_help_panel=PANEL)
]
FoxglovePort = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=65535,
        help="Port to serve it at; 0 takes a free one",
        show_default=str(PORT),
        hidden=True,
        rich_help_panel=PANEL,
    ),
]


def port_of(foxglove: bool, foxglove_port: int | None) -> int | None:
    """The port at which a command serves its run to Foxglove; None where it was not asked to."""
    if foxglove:
        return PORT if foxglove_port is None else foxglove_port
    if foxglove_port is not None:
        raise InputError("foxglove_port", foxglove_port, says="has no effect without --foxglove")
    return None
