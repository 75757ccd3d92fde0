"""The runs that a viewer shows, each under a key of its own. Pages name keys, never files."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from llm_flock.errors import FlockError
from llm_flock.record.stream import RecordStream
from llm_flock.viewer.named import FIRST_KEY
from llm_flock.viewer.reel import Reel

logger = logging.getLogger(__name__)

LOOK_S = 0.1
"""Time between two looks at a record that grows [s]."""


class Gallery:
    """Runs by key, in the order in which they were added."""

    def __init__(self) -> None:
        self.reels: dict[str, Reel] = {}
        self.paths: dict[str, Path] = {}
        self._lock = threading.Lock()

    def add(self, title: str, path: Path | None = None, *, live: bool = True) -> Reel:
        """Room for one more run.

        Args:
            title: what people read.
            path: its record, if it has one; only such a run can be exported.
            live: whether it goes on while it is watched.
        """
        with self._lock:
            key = str(int(FIRST_KEY) + len(self.reels))
            self.reels[key] = Reel(key, title, live=live)
            if path is not None:
                self.paths[key] = path
            return self.reels[key]

    def get(self, key: str) -> Reel | None:
        """A run, None for a key that was never given out."""
        return self.reels.get(key)


def play(path: Path, reel: Reel, *, live: bool, stopped: Callable[[], bool] = lambda: False) -> None:
    """Read a record into a reel, in a thread of its own; with `live`, until the record ends or it is stopped."""
    stream = RecordStream(path)
    pause = threading.Event()
    try:
        while True:
            last = not live or stopped()  # asked first: what was written until then is still read
            for entry in stream.entries():
                reel.write(entry)
            if stream.ended or last:
                return
            pause.wait(LOOK_S)
    except FlockError as error:
        reel.failure = str(error)
        logger.warning("%s", error)
    finally:
        if not reel.ready and reel.failure is None:
            reel.failure = "The run ended before its start was recorded; there is nothing to show."
        reel.close()
