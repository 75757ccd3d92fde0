"""The flight's side of the deadman: starts it, and tells it again and again that the flight is alive."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Collection
from types import TracebackType
from typing import Self

from llm_flock.errors import FlockError
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.deadman import BEATS, Beat

READY_S = 60.0
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
        self._process: subprocess.Popen[bytes] | None = None
        self._beating: asyncio.Task[None] | None = None

    @property
    def pid(self) -> int | None:
        """Process id of the deadman; None without one."""
        return None if self._process is None else self._process.pid

    async def __aenter__(self) -> Self:
        if self._config.fleet.watched:
            process = self._process = self._open()
            try:
                line = await asyncio.wait_for(asyncio.to_thread(_first_line, process), READY_S)
            except TimeoutError:
                line = b""
            if line.strip() != b"ready":
                process.kill()
                await asyncio.to_thread(_gone, process, None)
                raise NoDeadman("the deadman process did not start; nothing has taken off")
            self.tell()
            self._beating = asyncio.create_task(self._beat())
        return self

    def _open(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "-m", "llm_flock.runtime.flight.deadman"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # the terminal's Ctrl-C and its end are not for the deadman
        )
        assert process.stdin is not None
        settings = self._config.model_dump(mode="json", exclude_none=True)
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(json.dumps(settings).encode() + b"\n")
            process.stdin.flush()
        # From here on a beat that does not fit is left out: the flight waits for nobody.
        os.set_blocking(process.stdin.fileno(), False)
        return process

    async def _beat(self) -> None:
        while True:
            self.tell()
            await asyncio.sleep(self._config.fleet.deadman_s / BEATS)

    def tell(self) -> None:
        """Tell the deadman now who is in the air; what is written it reads, even if this process dies at once."""
        if self._process is not None:
            self.say(Beat(aloft=tuple(sorted(self._aloft()))))

    def say(self, beat: Beat) -> None:
        """Send a beat; nothing where the deadman is gone."""
        process = self._process
        assert process is not None and process.stdin is not None
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            os.write(process.stdin.fileno(), beat.model_dump_json().encode() + b"\n")

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
        await asyncio.to_thread(_gone, process, None if left else FAREWELL_S)


def _first_line(process: subprocess.Popen[bytes]) -> bytes:
    assert process.stdout is not None
    return process.stdout.readline()


def _gone(process: subprocess.Popen[bytes], longest_s: float | None) -> None:
    """Close the pipes and wait for the process to end."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(longest_s)
    process.stdout.close()
