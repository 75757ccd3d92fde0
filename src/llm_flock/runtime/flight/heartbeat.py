"""The flight's side of the deadman: starts it, and tells it again and again that the flight is alive."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections.abc import Callable, Collection
from types import TracebackType
from typing import Self

from llm_flock.errors import FlockError
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.deadman import BEATS, Beat

READY_S = 20.0
"""Longest wait for the deadman to be ready [s]: it imports all that it may need before it says so."""

FAREWELL_S = 5.0
"""Longest wait for the deadman to go after the farewell [s]."""


class NoDeadman(FlockError):
    """The process that lands the drones where this one dies did not start."""


class Heartbeat:
    """Keeps a deadman at rest for as long as the event loop of this process turns.

    Args:
        config: the flight; nothing is started where it wants no deadman.
        aloft: tells who is in the air.
    """

    def __init__(self, config: FlightConfig, aloft: Callable[[], Collection[int]]) -> None:
        self._config = config
        self._aloft = aloft
        self._process: asyncio.subprocess.Process | None = None
        self._beating: asyncio.Task[None] | None = None

    @property
    def pid(self) -> int | None:
        """Process id of the deadman; None without one."""
        return None if self._process is None else self._process.pid

    async def __aenter__(self) -> Self:
        if self._config.fleet.watched:
            await self._start()
        return self

    async def _start(self) -> None:
        self._process = process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "llm_flock.runtime.flight.deadman",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            start_new_session=True,  # the terminal's Ctrl-C and its end are not for the deadman
        )
        assert process.stdin is not None and process.stdout is not None
        settings = self._config.model_dump(mode="json", exclude_none=True)
        process.stdin.write(json.dumps(settings).encode() + b"\n")
        try:
            line = await asyncio.wait_for(process.stdout.readline(), READY_S)
        except TimeoutError:
            line = b""
        if line.strip() != b"ready":
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            raise NoDeadman("the deadman process did not start; nothing has taken off")
        self._beating = asyncio.create_task(self._beat())

    async def _beat(self) -> None:
        while True:
            self.say(Beat(aloft=tuple(sorted(self._aloft()))))
            await asyncio.sleep(self._config.fleet.deadman_s / BEATS)

    def say(self, beat: Beat) -> None:
        """Send a beat."""
        process = self._process
        assert process is not None and process.stdin is not None
        if process.returncode is None:
            process.stdin.write(beat.model_dump_json().encode() + b"\n")

    @property
    def alive(self) -> bool:
        """Whether the deadman is there, or none was wanted."""
        return self._process is None or self._process.returncode is None

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Say farewell, unless this process fails while somebody is in the air: then the deadman takes over."""
        process = self._process
        if process is None:
            return
        if self._beating is not None:
            self._beating.cancel()
        left = tuple(sorted(self._aloft())) if error is not None else ()
        self.say(Beat(aloft=left, farewell=not left))
        assert process.stdin is not None
        process.stdin.close()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(process.wait(), None if left else FAREWELL_S)
