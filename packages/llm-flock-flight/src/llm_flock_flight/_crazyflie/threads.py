"""Blocking calls of cflib, in threads: a radio's queue holds one packet."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
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
    """Run a blocking call in a thread that `start` provides; it is abandoned with a TimeoutError after `timeout_s`."""
    future: Future[T] = Future()
    future.set_running_or_notify_cancel()  # so that giving up the wait leaves the call as it is

    def work() -> None:
        try:
            future.set_result(call())
        except Exception as error:  # noqa: BLE001  # raised where the result is awaited
            future.set_exception(error)

    start(work)
    async with asyncio.timeout(timeout_s):
        return await asyncio.wrap_future(future)
