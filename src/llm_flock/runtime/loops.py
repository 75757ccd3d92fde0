"""Waits for a coroutine from anywhere: in a script, and where an event loop is running already, as in a notebook."""

from __future__ import annotations

import asyncio
import contextvars
import threading
from collections.abc import Coroutine
from concurrent.futures import Future
from typing import Any, TypeVar

T = TypeVar("T")


def wait_for(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end, and return its result or raise its error.

    Where an event loop runs in this thread, which cannot run another one, the coroutine gets a thread of its own. The
    caller waits all the same, so that loop stands still until the end.

    Raises:
        KeyboardInterrupt: Ctrl-C, after the coroutine was cancelled and has ended.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(main)
    done: Future[T] = Future()
    begun = threading.Event()
    running: list[tuple[asyncio.AbstractEventLoop, asyncio.Task[T]]] = []

    async def outer() -> T:
        task = asyncio.ensure_future(main)
        running.append((asyncio.get_running_loop(), task))
        begun.set()
        return await task

    def work() -> None:
        try:
            done.set_result(asyncio.run(outer()))
        except BaseException as error:  # noqa: BLE001 - it is raised in the thread that waits
            done.set_exception(error)

    thread = threading.Thread(target=contextvars.copy_context().run, args=(work,), name="llm-flock run")
    thread.start()
    try:
        return done.result()
    except BaseException:
        if not done.done():  # Ctrl-C: end the run as it would end in a script
            begun.wait()
            loop, task = running[0]
            if not loop.is_closed():
                loop.call_soon_threadsafe(task.cancel)
        raise
    finally:
        thread.join()
