"""What every process of a swarm does about its end: it goes when it is told to, and with whoever started it."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import gc
import os
import signal
import sys
from collections.abc import Coroutine
from typing import Any

try:  # each of a robot's many small wake-ups costs half as much there
    from uvloop import new_event_loop
except ImportError:
    from asyncio import new_event_loop

PR_SET_PDEATHSIG = 1
LOOK_S = 0.5
"""So often a process looks whether its parent is still there [s]."""


def run(work: Coroutine[Any, Any, None]) -> None:
    """Run a process's work in an event loop of its own."""
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        runner.run(work)


def end_with(parent: int | None) -> None:
    """Die with the process that started this one, a stopped one as well; Ctrl-C is the parent's to handle.

    Raises:
        SystemExit: the parent is gone already.
    """
    if parent is None:
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


async def until_stopped(*work: Coroutine[None, None, None], parent: int | None = None) -> None:
    """Do the work until it is done, fails, or the process is told to end (SIGTERM, SIGINT or a lost parent).

    Raises:
        Exception: the first one of the work.
    """
    gc.freeze()  # what is there by now stays: looking through it again and again costs tens of milliseconds each time
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        if number is signal.SIGTERM or signal.getsignal(number) is not signal.SIG_IGN:
            loop.add_signal_handler(number, stop.set)

    async def told() -> None:
        began_with = os.getppid()
        while not stop.is_set():
            if parent is not None and os.getppid() != began_with:
                return
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), LOOK_S)

    tasks = [asyncio.create_task(told()), *map(asyncio.create_task, work)]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
