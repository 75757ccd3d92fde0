"""The clock of tests that mostly wait."""

from __future__ import annotations

import asyncio
import threading
import time

import pytest
from clock import running_at


def test_every_wait_is_shorter_and_measured_as_it_was_asked_for() -> None:
    async def nothing() -> None:
        await asyncio.sleep(2.0)

    began = time.perf_counter()
    with running_at(20.0):
        for wait in (lambda: time.sleep(2.0), lambda: threading.Event().wait(2.0), lambda: asyncio.run(nothing())):
            asked = time.monotonic()
            wait()
            assert time.monotonic() - asked >= 1.99
    assert time.perf_counter() - began < 3.0


def test_kept_reference_to_the_clock_is_real_time_afterwards() -> None:
    with running_at(20.0):
        kept = time.monotonic
    assert kept() == pytest.approx(time.monotonic(), abs=0.1) and not hasattr(time.monotonic, "rate")


@pytest.mark.clock(50)
def test_the_marker_sets_the_rate() -> None:
    assert getattr(time.monotonic, "rate", None) == 50
