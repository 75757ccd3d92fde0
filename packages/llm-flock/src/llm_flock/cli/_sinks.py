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


def chosen(extensions: Sequence[Extension]) -> list[Extension]:
    """The plug-ins that are switched on.

    Raises:
        InputError: one has other flags, and is not.
    """
    for extension in extensions:
        extension.refuse_idle_flags()
    return [extension for extension in extensions if extension.on]


def refuse(sinks: Sequence[Extension], where: str) -> None:
    """Refuse them for a command that shows nothing there.

    Raises:
        InputError: there is one.
    """
    for sink in sinks:
        raise InputError(next(iter(sink.flags)), None, says=f"has no effect in {where}")


@contextmanager
def showing(sinks: Sequence[Extension], config: RunConfig) -> Generator[RecordSink | None]:
    """Open them while a run flies; one sink for all, None without any.

    Raises:
        InputError: one cannot be opened.
    """
    with ExitStack() as stack:
        found: RecordSink | None = None
        for sink in sinks:
            from llm_flock.record._writer import both

            found = both(found, stack.enter_context(sink(config)))
        yield found


class Pacer:
    """Holds a run to a pace [rounds/s]."""

    def __init__(self, pace: float) -> None:
        self._pace = pace
        self._due = 0.0

    async def __call__(self, trial: Trial) -> None:
        """Wait until the next round is due."""
        await asyncio.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + 1.0 / self._pace
