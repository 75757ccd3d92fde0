"""Blocking calls beside an event loop, in threads that may hang without anybody hanging with them."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def new_thread(work: Callable[[], None]) -> None:
    """Have a new thread do something; nobody waits for it."""
    threading.Thread(target=work, name="crazyflie", daemon=True).start()


class Worker:
    """A thread that does one thing after the other: starting one for each command takes longer than sending it."""

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        new_thread(self._run)

    def do(self, job: Callable[[], None] | None) -> None:
        """Do this next; None ends the thread."""
        self._jobs.put(job)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()


async def in_thread(
    call: Callable[[], T], timeout_s: float, start: Callable[[Callable[[], None]], None] = new_thread
) -> T:
    """Run a blocking call in a thread that nobody waits for when it hangs.

    Args:
        call: what to run.
        timeout_s: how long to wait for it.
        start: has it run by some thread.

    Raises:
        TimeoutError: not done in time; the thread is left to itself.
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
        except Exception as error:  # noqa: BLE001  # handed to the one who waits
            failure = error
        if not loop.is_closed():
            loop.call_soon_threadsafe(settle, result, failure)

    start(work)
    return await asyncio.wait_for(future, timeout_s)
