"""The runs that a viewer shows, each under its own key. Pages name keys, never files."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path

from llm_flock.errors import FlockError
from llm_flock.record import RecordStream
from llm_flock_view._viewer.recording import Recording, version_of

POLL_S = 0.1
"""Time between two reads of a record that grows [s]."""


class Library:
    """Runs by key, in the order in which they were added."""

    def __init__(self) -> None:
        self.runs: dict[str, Recording] = {}
        self._keys = itertools.count(1)

    def add(self, title: str, path: Path | None = None, *, live: bool = True) -> Recording:
        """Add an empty run under a new key; without a record at `path`, it cannot be exported."""
        key = str(next(self._keys))
        self.runs[key] = Recording(key, title, path, live=live)
        return self.runs[key]

    @property
    def newest(self) -> Recording | None:
        """The run that was added last; ask it from any thread."""
        return next(iter(list(self.runs.values())[::-1]), None)

    def remove(self, key: str) -> None:
        """Take a run out; its key names no other one later."""
        self.runs.pop(key, None)


def load(run: Recording, stopped: Callable[[], bool] = lambda: False) -> None:
    """Read a run's record. Call it in a thread: a live run is read until its record ends or it is `stopped`."""
    assert run.path is not None
    stream = RecordStream(run.path)
    try:
        while True:
            last = not run.live or stopped()  # asked first: everything written before that is still read
            run.version = _version(run.path)
            for entry in stream.entries():
                run.write(entry)
            if stream.ended:
                run.version = _version(run.path)
            if stream.ended or last:
                return
            time.sleep(POLL_S)
    except FlockError as error:
        run.fail(error)
    finally:
        if not run.ready and run.failure is None:
            run.failure = "The run ended before its start was recorded; there is nothing to show."
        run.open = False


def _version(path: Path) -> tuple[int, ...] | None:
    try:
        return version_of(path.stat())
    except OSError:
        return None
