"""Runs blocking calls in threads beside an event loop, which never waits for one that hangs."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def new_thread(work: Callable[[], None]) -> None:
    """Run something in a new thread, without waiting for it."""
    threading.Thread(target=work, name="crazyflie", daemon=True).start()


class Worker:
    """A thread that runs one job after another: starting a thread takes longer than sending a command."""

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        new_thread(self._run)

    def do(self, job: Callable[[], None] | None) -> None:
        """Queue a job; None ends the thread."""
        self._jobs.put(job)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()


async def in_thread(
    call: Callable[[], T], timeout_s: float, start: Callable[[Callable[[], None]], None] = new_thread
) -> T:
    """Run a blocking call in a thread, and wait for it with a time limit.

    Args:
        call: to run.
        timeout_s: longest wait [s].
        start: runs a function in some thread.

    Raises:
        TimeoutError: not done in time; the thread is abandoned.
    """
    loop = asyncio.get_running_loop()
    future: asyncio.Future[T] = loop.create_future()

    def settle(result: T | None, error: Exception | None) -> None:
        if future.done():
            return
        if error is not None:
            future.set_exception(error)
        else:
            future.set_result(result)  # pyright: ignore[reportArgumentType]

    def work() -> None:
        result: T | None = None
        failure: Exception | None = None
        try:
            result = call()
        except Exception as error:  # noqa: BLE001  # raised where the result is awaited
            failure = error
        if not loop.is_closed():
            loop.call_soon_threadsafe(settle, result, failure)

    start(work)
    return await asyncio.wait_for(future, timeout_s)
