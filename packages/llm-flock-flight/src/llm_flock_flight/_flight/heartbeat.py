"""Starts the deadman process, and sends it heartbeats for as long as the flight process works."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Collection
from typing import Self

from pydantic import BaseModel, ConfigDict

from llm_flock.errors import FlockError
from llm_flock_flight._flight.config import FlightConfig

logger = logging.getLogger(__name__)

READY_S = 60.0  # longest start of the deadman, which first imports everything that it may need [s]
FAREWELL_S = 5.0  # longest wait for the deadman to end after the farewell [s]


class NoDeadman(FlockError):
    """The deadman process did not start."""


class Heartbeat(BaseModel):
    """A sign of life: ids of the drones in the air, for the deadman to land. With a farewell it ends instead."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    aloft: tuple[int, ...] = ()
    farewell: bool = False


class TakeOver(BaseModel):
    """The deadman's word to a flight process that lives: it lands the drones, and then how each ended, by name."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    ends: dict[str, str] | None = None


class HeartbeatSender:
    """Runs a deadman, if the flight needs one, as long as its context lasts; heartbeats stop when the event loop does.

    `aloft` returns the drones in the air. The deadman keeps the files open whose handles are `kept`. Once it has taken
    over, `taken` is set and `on_taken` called.
    """

    def __init__(self, config: FlightConfig, aloft: Callable[[], Collection[int]], kept: Collection[int] = ()) -> None:
        self._config = config
        self._kept = kept
        self._aloft = aloft
        self._process: subprocess.Popen[bytes] | None = None
        self._beating: asyncio.Task[None] | None = None
        self._missed = False
        self.taken = asyncio.Event()
        self.on_taken: Callable[[], None] = lambda: None
        self._ends: asyncio.Future[dict[str, str]] = asyncio.get_running_loop().create_future()
        self._heard = b""

    async def __aenter__(self) -> Self:
        if self._config.fleet.watched:
            process = self._process = self._open()
            assert process.stdout is not None
            try:
                async with asyncio.timeout(READY_S):
                    line = await asyncio.to_thread(process.stdout.readline)
            except TimeoutError:
                line = b""
            if line.strip() != b"ready":
                process.kill()
                await asyncio.to_thread(_wait_for_end, process, None)
                raise NoDeadman("the deadman process did not start; nothing has taken off")
            asyncio.get_running_loop().add_reader(process.stdout, self._hear, process.stdout.fileno())
            self.beat()
            self._beating = asyncio.create_task(self._beat_periodically())
        return self

    def _hear(self, handle: int) -> None:
        """Read what the deadman says; at its end, nothing more will come."""
        data = os.read(handle, 65536)
        *lines, self._heard = (self._heard + data).split(b"\n")
        for line in lines:
            word = TakeOver.model_validate_json(line)
            if not self.taken.is_set():
                self._missed = True  # it ends when all are down
                self.taken.set()
                self.on_taken()
            if word.ends is not None and not self._ends.done():
                self._ends.set_result(word.ends)
        if not data:
            asyncio.get_running_loop().remove_reader(handle)
            if not self._ends.done():
                self._ends.set_result({})

    async def ends(self) -> dict[str, str]:
        """How each drone ended that the deadman has landed, by name, as soon as all have; empty if it died."""
        return await asyncio.shield(self._ends)

    def _open(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "-m", "llm_flock_flight._flight.deadman"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=tuple(self._kept),
            start_new_session=True,  # keeps the terminal's Ctrl-C and hang-up from the deadman
        )
        assert process.stdin is not None
        settings = self._config.model_dump(mode="json", exclude_none=True)
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(json.dumps(settings).encode() + b"\n")
            process.stdin.flush()
        # From now on a heartbeat that does not fit into the pipe is dropped: the flight never waits for the deadman.
        os.set_blocking(process.stdin.fileno(), False)
        return process

    async def _beat_periodically(self) -> None:
        while True:
            self.beat()
            await asyncio.sleep(self._config.fleet.deadman_s / 5)  # several may be lost

    def beat(self) -> None:
        """Send a heartbeat now. The deadman reads it even if this process dies right after: call before a take-off."""
        if self._process is not None:
            self._send(Heartbeat(aloft=tuple(sorted(self._aloft()))))

    def _send(self, heartbeat: Heartbeat) -> None:
        process = self._process
        assert process is not None and process.stdin is not None
        try:
            with contextlib.suppress(BlockingIOError):
                os.write(process.stdin.fileno(), heartbeat.model_dump_json().encode() + b"\n")
        except BrokenPipeError:
            if not self._missed:
                logger.warning("the deadman process is gone: nothing would land the drones if this process died now")
            self._missed = True

    async def __aexit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Send the farewell; if this process fails with drones in the air, let the deadman take over instead."""
        process = self._process
        if process is None:
            return
        if self._beating is not None:
            self._beating.cancel()
        assert process.stdout is not None
        asyncio.get_running_loop().remove_reader(process.stdout)
        left = tuple(sorted(self._aloft())) if error is not None else ()
        self._send(Heartbeat(aloft=left, farewell=not left))
        await asyncio.to_thread(_wait_for_end, process, None if left else FAREWELL_S)


def _wait_for_end(process: subprocess.Popen[bytes], longest_s: float | None) -> None:
    """Close the pipes and wait for the process to end."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(longest_s)
    process.stdout.close()
