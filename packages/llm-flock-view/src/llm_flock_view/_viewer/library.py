"""The runs that a viewer shows, each under its own key. Pages name keys, never files.

A key is made of how a record begins: its address is the same after a restart, and wherever a copy of it is shown.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from hashlib import sha256
from pathlib import Path

from llm_flock.errors import FlockError
from llm_flock.file_lock import is_written
from llm_flock.record import RECORD_NAME, RecordStream
from llm_flock_view._viewer.paths import title_of
from llm_flock_view._viewer.recording import Recording, version_of

POLL_S = 0.1  # time between two reads of a record that grows [s]
WATCH_S = 1.0  # time between two looks for new records [s]


def identity(path: Path) -> str | None:
    """The key of a record, from its first message: seed, configuration and start. None while it has not begun."""
    try:
        first = next(iter(RecordStream(path).messages()), None)
    except FlockError:
        return None
    return None if first is None else _key(first.data)


def _key(data: bytes) -> str:
    return sha256(data).hexdigest()[:12]


class Library:
    """Runs by key, in the order in which they were added.

    Records that are written to a folder while it is watched join them. `runs` is the folder of the runs that pages
    start: its records are found by their keys, so that links to them outlive the viewer.
    """

    def __init__(self, runs: Path | None = None) -> None:
        self.runs: dict[str, Recording] = {}
        self.changes = 0  # counts runs that came, ended or went
        self._folder = runs
        self._known: set[Path] = set()
        self._lock = threading.Lock()
        self.closed = threading.Event()  # ends `watch`

    def add(self, title: str, path: Path | None = None, *, live: bool = True) -> Recording:
        """Add an empty run under its key; without a record at `path`, it cannot be exported."""
        return self.put(Recording("", title, path, live=live))

    def put(self, run: Recording) -> Recording:
        """Add a run, and give it its key: that of its record, or one of its path until that has begun."""
        found = None if run.path is None else identity(run.path)
        key = found or _key(str(run.path.resolve() if run.path else run.title).encode())
        with self._lock:
            while key in self.runs:  # a copy of a record that is shown as well
                key = _key(f"{key} {run.title}".encode())
            run.key = key
            self.runs[key] = run
            self.changes += 1
            if run.path is not None:
                self._known.add(run.path.resolve())
        return run

    def expect(self, path: Path) -> None:
        """A record that is put here by the one who writes it: it is not to be found a second time."""
        self._known.add(path.resolve())

    def find(self, key: str) -> Recording | None:
        """The run of a key, also one of an earlier viewer whose record lies in the folder of runs."""
        if key not in self.runs and self._folder is not None:
            for path in sorted(self._folder.glob(f"*/{RECORD_NAME}")):
                if identity(path) == key and key not in self.runs:
                    self.read([self.add(title_of(path), path, live=False)])
        return self.runs.get(key)

    def read(self, runs: Iterable[Recording]) -> None:
        """Read records one after another; those that are being written are followed, each in a thread of its own."""
        for run in runs:
            if run.live or (run.path is not None and is_written(run.path)):
                threading.Thread(target=self._follow, args=(run,), daemon=True).start()
            else:
                load(run)
                self.changes += 1

    def _follow(self, run: Recording) -> None:
        path, named = run.path, run.live
        run.live = True
        load(run, lambda: not named and path is not None and not is_written(path))
        self.changes += 1

    def watch(self, folders: Sequence[Path]) -> None:
        """Add the records that are written to these folders, and to that of runs, from now on. Call it in a thread."""
        if self._folder is not None and self._folder not in folders:
            self._known.update(path.resolve() for path in self._folder.glob(f"*/{RECORD_NAME}"))
        watched = {*folders, *([] if self._folder is None else [self._folder])}
        while not self.closed.wait(WATCH_S):
            for path in sorted(path for folder in watched for path in folder.glob(f"*/{RECORD_NAME}")):
                if path.resolve() not in self._known and identity(path) is not None:
                    self.read([self.add(title_of(path), path, live=False)])

    @property
    def newest(self) -> Recording | None:
        """The run that was added last; ask it from any thread."""
        return next(iter(list(self.runs.values())[::-1]), None)

    def remove(self, key: str) -> None:
        """Take a run out; its key names no other one later."""
        run = self.runs.pop(key, None)
        self.changes += 1
        if run is not None and run.path is not None:
            self._known.discard(run.path.resolve())


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
