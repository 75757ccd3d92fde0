"""Serves the runs of commands to Foxglove: a plug-in of the kind `sinks`."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from llm_flock.cli.terminal import say
from llm_flock.foxglove.options import Foxglove, FoxglovePort, port_of

if TYPE_CHECKING:
    from llm_flock.foxglove.server import FoxgloveServer
    from llm_flock.runtime.config import RunConfig


@contextmanager
def serve(
    config: RunConfig, *, foxglove: Foxglove = False, foxglove_port: FoxglovePort = None
) -> Generator[FoxgloveServer]:
    """The server while a run flies.

    Raises:
        InputError: the port cannot be used, or the extra is not installed.
    """
    from llm_flock.foxglove.server import FoxgloveServer
    from llm_flock.runtime.journal import run_info

    port = port_of(foxglove, foxglove_port)
    assert port is not None, "it is opened where it was asked for"
    server = FoxgloveServer(port, config.mission.n_robots)
    try:
        say(f"Foxglove: {server.url}", error=True)
        server.write(run_info(config, simulated="simulated:" in config.model.model))
        yield server
    finally:
        server.close()
