"""Options of commands that show a run in Foxglove while it flies, and the server behind them. Loads nothing heavy."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from llm_flock.errors import InputError

if TYPE_CHECKING:
    from llm_flock.foxglove.server import FoxgloveServer
    from llm_flock.runtime.config import RunConfig

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
        rich_help_panel=PANEL,
    ),
]


def port_of(foxglove: bool, foxglove_port: int | None) -> int | None:
    """The port at which a command serves its run to Foxglove; None where it was not asked to.

    Raises:
        InputError: a port was given without --foxglove.
    """
    if foxglove:
        return PORT if foxglove_port is None else foxglove_port
    if foxglove_port is not None:
        raise InputError("foxglove_port", foxglove_port, says="has no effect without --foxglove")
    return None


def refuse_foxglove(port: int | None, where: str) -> None:
    """Refuse --foxglove for a command that shows nothing there.

    Raises:
        InputError: it was given.
    """
    if port is not None:
        raise InputError("foxglove", None, says=f"has no effect in {where}")


@contextmanager
def showing_run(port: int | None, config: RunConfig) -> Generator[FoxgloveServer | None]:
    """The server while a run flies; None where Foxglove was not asked for.

    Raises:
        InputError: the port cannot be used, or the extra is not installed.
    """
    if port is None:
        yield None
        return
    from llm_flock.cli.terminal import say
    from llm_flock.foxglove.server import FoxgloveServer
    from llm_flock.runtime.entries import run_info

    server = FoxgloveServer(port, config.mission.n_robots)
    try:
        say(f"Foxglove: {server.url}", error=True)
        server.write(run_info(config, simulated="simulated:" in config.model.model))
        yield server
    finally:
        server.close()
