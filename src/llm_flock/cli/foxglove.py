"""Serves the runs of commands to Foxglove, and holds a run to a pace."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from llm_flock.cli.terminal import say

if TYPE_CHECKING:
    from llm_flock.foxglove.server import FoxgloveServer
    from llm_flock.runtime.config import RunConfig
    from llm_flock.runtime.trial import Trial

PACE = 2.0
"""Rounds a second at most while Foxglove shows a run: simulated models would be over before anybody connects."""


@contextmanager
def showing_run(port: int | None, config: RunConfig) -> Generator[FoxgloveServer | None]:
    """The server while a run flies; None where Foxglove was not asked for.

    Raises:
        InputError: the port cannot be used, or the extra is not installed.
    """
    if port is None:
        yield None
        return
    from llm_flock.foxglove.server import FoxgloveServer
    from llm_flock.runtime.entries import run_info

    server = FoxgloveServer(port, config.mission.n_robots)
    try:
        say(f"Foxglove: {server.url}", error=True)
        server.write(run_info(config, simulated="simulated:" in config.model.model))
        yield server
    finally:
        server.close()


class Pacer:
    """Holds a run to a pace [rounds/s]."""

    def __init__(self, pace: float) -> None:
        self._pace = pace
        self._due = 0.0

    async def __call__(self, trial: Trial) -> None:
        """Wait until the next round is due."""
        await asyncio.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + 1.0 / self._pace
