"""Tells a cancellation of the running task from one that user code raised."""

from __future__ import annotations

import asyncio


def is_cancelled() -> bool:
    """Whether the running task is being cancelled."""
    task = asyncio.current_task()
    return task is None or task.cancelling() > 0
