"""Serves the runs of commands to Foxglove: a plug-in of the kind `sinks`."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from llm_flock.cli import say
from llm_flock_view._foxglove.options import Foxglove, FoxglovePort, port_of

if TYPE_CHECKING:
    from llm_flock.runtime import RunConfig
    from llm_flock_view._foxglove.server import FoxgloveServer


@contextmanager
def serve(
    config: RunConfig, *, foxglove: Foxglove = False, foxglove_port: FoxglovePort = None
) -> Generator[FoxgloveServer]:
    """The server while a run flies."""
    from llm_flock.llm import parse_models, says_simulated
    from llm_flock.runtime import run_info
    from llm_flock_view._foxglove.server import FoxgloveServer

    port = port_of(foxglove, foxglove_port)
    assert port is not None, "it is opened where it was asked for"
    server = FoxgloveServer(port, config.mission.n_robots)
    try:
        say(f"Foxglove: {server.url}", error=True)
        models = parse_models(config.model.model, config.mission.n_robots)
        server.write(run_info(config, simulated=any(map(says_simulated, models))))
        yield server
    finally:
        server.close()
