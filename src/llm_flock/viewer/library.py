"""The runs that a viewer shows, each under its own key. Pages name keys, never files."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from llm_flock.errors import FlockError
from llm_flock.record.stream import RecordStream
from llm_flock.viewer.paths import FIRST_KEY
from llm_flock.viewer.recording import Recording

logger = logging.getLogger(__name__)

POLL_S = 0.1
"""Time between two reads of a record that grows [s]."""


class Library:
    """Runs by key, in the order in which they were added."""

    def __init__(self) -> None:
        self.runs: dict[str, Recording] = {}
        self.paths: dict[str, Path] = {}
        self._lock = threading.Lock()

    def add(self, title: str, path: Path | None = None, *, live: bool = True) -> Recording:
        """Add an empty run under a new key.

        Args:
            title: shown to people.
            path: its record, if it has one; only such a run can be exported.
            live: whether it goes on while it is watched.
        """
        with self._lock:
            key = str(int(FIRST_KEY) + len(self.runs))
            self.runs[key] = Recording(key, title, live=live)
            if path is not None:
                self.paths[key] = path
            return self.runs[key]

    def get(self, key: str) -> Recording | None:
        """A run; None for an unknown key."""
        return self.runs.get(key)


def load(path: Path, run: Recording, *, live: bool, stopped: Callable[[], bool] = lambda: False) -> None:
    """Read a record into a run. Call it in a thread: with `live`, it returns when the record ends or is `stopped`."""
    stream = RecordStream(path)
    pause = threading.Event()
    try:
        while True:
            last = not live or stopped()  # asked first: everything written before that is still read
            for entry in stream.entries():
                run.write(entry)
            if stream.ended or last:
                return
            pause.wait(POLL_S)
    except FlockError as error:
        run.failure = str(error)
        logger.warning("%s", error)
    finally:
        if not run.ready and run.failure is None:
            run.failure = "The run ended before its start was recorded; there is nothing to show."
        run.close()
