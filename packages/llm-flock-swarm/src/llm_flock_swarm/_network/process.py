"""Event loop, periods and end of a swarm's process: it stops on a signal, and with the process that started it."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import math
import os
import signal
import sys
from collections.abc import Callable, Coroutine
from types import FrameType
from typing import Any

try:  # halves the cost of a robot's many short wake-ups
    from uvloop import new_event_loop
except ImportError:
    from asyncio import new_event_loop

PR_SET_PDEATHSIG = 1


class PeriodClock:
    """Fires once per period, at `phase_s + k * period_s` of the event loop's clock; missed moments are skipped."""

    def __init__(self, period_s: float, phase_s: float = 0.0) -> None:
        self._period_s, self._phase_s = period_s, phase_s
        self._count = -math.inf

    async def next(self) -> None:
        loop = asyncio.get_running_loop()
        passed = math.floor((loop.time() - self._phase_s) / self._period_s)
        self._count = max(self._count, passed) + 1  # a timer may fire slightly early and must not count twice
        await asyncio.sleep(self._phase_s + self._count * self._period_s - loop.time())


def phase_s(robot: int, n_robots: int, period_s: float) -> float:
    """Offset of a robot's periods [s], or all robots of a machine would wake, send and wait in one millisecond."""
    return robot / n_robots * period_s


def run(work: Coroutine[Any, Any, None]) -> None:
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        runner.run(work)


def end_with_parent(parent: int | None = None) -> None:
    """End together with the parent (by its id), even while stopped (on Linux); leave Ctrl-C to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if parent is not None and os.getppid() != parent:
        os._exit(1)


def _sets(loop: asyncio.AbstractEventLoop, stop: asyncio.Event) -> Callable[[int, FrameType | None], None]:
    """A signal handler, for systems whose event loops have none."""

    def handle(number: int, frame: FrameType | None) -> None:
        loop.call_soon_threadsafe(stop.set)

    return handle


async def until_stopped(work: Coroutine[None, None, None]) -> None:
    """Do the work until it is done or raises its own exception, or until SIGTERM or SIGINT."""
    gc.freeze()  # spares later collections tens of milliseconds each: these objects stay
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        if signal.getsignal(number) is not signal.SIG_IGN:
            try:
                loop.add_signal_handler(number, stop.set)
            except NotImplementedError:  # Windows
                signal.signal(number, _sets(loop, stop))
    tasks: list[asyncio.Task[Any]] = [asyncio.create_task(work), asyncio.create_task(stop.wait())]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
