"""Plug-ins that show runs while they fly: functions that open a sink, whose first flag switches them on.

Such a function takes the configuration and its flags, and returns a context manager of a `RecordSink`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from llm_flock.cli._extensions import Extension
from llm_flock.errors import InputError

if TYPE_CHECKING:
    from llm_flock.record._schema import RecordSink
    from llm_flock.runtime._config import RunConfig
    from llm_flock.runtime._trial import Trial

PACE = 2.0
"""Rounds a second at most while a run is shown: simulated models would be over before anybody looks."""


def refuse(sinks: Sequence[Extension], where: str) -> None:
    """Refuse them, where there are any, for a command that shows nothing there."""
    for sink in sinks:
        raise InputError(next(iter(sink.flags)), None, says=f"has no effect in {where}")


@contextmanager
def showing(sinks: Sequence[Extension], config: RunConfig) -> Generator[RecordSink | None]:
    """Open them while a run flies; one sink for all, None without any."""
    from llm_flock.record import both

    with ExitStack() as stack:
        yield both(*[stack.enter_context(sink(config)) for sink in sinks])


class Pacer:
    """Holds a run to a pace [rounds/s]."""

    def __init__(self, pace: float) -> None:
        self._pace = pace
        self._due = 0.0

    async def __call__(self, trial: Trial) -> None:
        """Wait until the next round is due."""
        await asyncio.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + 1.0 / self._pace
