"""A clock that skips the time in which an event loop would only wait.

For tests in which everything happens in one event loop: they see the same clock readings as in real time, and take
only the time that their work takes. Work counts by the processor's time, so that a busy machine delays nothing: what
else runs there is not seen. Not for code that waits for a thread, a process or another machine.
"""

from __future__ import annotations

import selectors
import time
from typing import Any

import pytest


def skip_waits(patch: pytest.MonkeyPatch) -> None:
    """Let new event loops jump to their next timer when nothing else is ready, and `time.monotonic` with them."""
    worked, skipped = time.process_time, 0.0
    began_s = time.monotonic() - worked()

    class Skipping(selectors.DefaultSelector):
        def select(self, timeout: float | None = None) -> list[Any]:
            nonlocal skipped
            if timeout is None or timeout <= 0:
                return super().select(timeout)
            events = super().select(0)
            if not events:
                skipped += timeout
            return events

    patch.setattr(selectors, "DefaultSelector", Skipping)
    patch.setattr(time, "monotonic", lambda: began_s + worked() + skipped)
