"""A clock that runs faster than real time, for tests in which several threads mostly wait.

Everything that waits by it is as much sooner: event loops, `time.sleep`, events and conditions. What is measured stays
the same, but work takes longer by this clock: a machine that stalls for 50 ms stalls for 0.2 s of a clock at rate 4.
Not for what waits in C by itself (queues, joined threads), nor for other processes.
"""

from __future__ import annotations

import selectors
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


class Clock:
    """Takes the place of `time.monotonic`; at rate 1 it is the real time, also for code that keeps it beyond a test."""

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._real = time.monotonic
        self._began_s = self._real()

    def __call__(self) -> float:
        return self._began_s + self.rate * (self._real() - self._began_s)


@contextmanager
def running_at(rate: float) -> Iterator[None]:
    """Let `time.monotonic` run at this rate, and all waits with it."""
    clock, sleep, wait = Clock(rate), time.sleep, threading.Condition.wait

    class Faster(selectors.DefaultSelector):
        def select(self, timeout: float | None = None) -> list[Any]:
            return super().select(None if timeout is None else timeout / clock.rate)

    def faster_wait(self: threading.Condition, timeout: float | None = None) -> bool:
        return wait(self, None if timeout is None else timeout / clock.rate)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "monotonic", clock)
        patch.setattr(time, "sleep", lambda seconds: sleep(seconds / clock.rate))
        patch.setattr(threading.Condition, "wait", faster_wait)
        patch.setattr(selectors, "DefaultSelector", Faster)
        yield
    clock.rate = 1.0
