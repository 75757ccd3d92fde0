"""A directory of results: one file for each trial, complete or absent.

DIR/sweep.toml         the file that describes the sweep
DIR/plan.json          every trial of it: id, labels
DIR/trials/ID.json     a finished trial
DIR/records/ID.mcap    its record, where it was kept
DIR/spent/OWNER.json   what a session has spent so far, unfinished trials included
DIR/lock               held by the sweep that works here now; the system lets go of it when that process ends
DIR/*.parquet          tables, built from the trials
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import msgspec

from llm_flock.errors import InputError, RecordError
from llm_flock.file_lock import lock_file
from llm_flock.llm import Spent
from llm_flock_lab._experiments.trial import FORMAT, TrialResult

T = TypeVar("T")

TRIALS, RECORDS, SPENT, LOCK = "trials", "records", "spent", "lock"


class Store:
    """The directory of one sweep, created if it is missing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            for name in (TRIALS, RECORDS, SPENT):
                (folder / name).mkdir(parents=True, exist_ok=True)
                if (folder / name).is_symlink():  # what comes from a stranger leads nowhere else
                    raise InputError("out", str(folder / name), "a folder, not a link")
        except OSError as error:
            raise InputError("out", str(folder), f"a folder that can be written to ({error.strerror})") from None

    def trial_path(self, trial: str) -> Path:
        return self.folder / TRIALS / f"{trial}.json"

    def save(self, trial: TrialResult) -> None:
        """Keep a finished trial. After this returns, no crash of process or machine loses it."""
        write_whole(self.trial_path(trial.id), msgspec.json.encode(trial))

    def keep_record(self, trial: str, record: Path | bytes) -> None:
        """Move a record, a file in `scratch` or its bytes, to its place. Call it before the trial is saved."""
        target = self.folder / RECORDS / f"{trial}.mcap"
        if isinstance(record, bytes):
            write_whole(target, record)
        else:
            record.replace(target)
            _sync(target.parent)

    def scratch(self, trial: str) -> Path:
        """Folder for the record of a trial in flight."""
        return self.folder / RECORDS / f".{trial}"

    @contextmanager
    def held(self) -> Generator[None]:
        try:  # no link, and no pipe that would wait for a reader
            lock = os.open(self.folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            raise InputError("out", str(self.folder / LOCK), f"a file of its own ({error.strerror})") from None
        with os.fdopen(lock, "wb") as file:
            if not lock_file(file.fileno()):
                raise InputError("out", str(self.folder), "a directory on which no other sweep works now")
            yield


class SpendingLog:
    """The spending of this session, saved as it goes on, and that of the sessions `before`."""

    def __init__(self, store: Store) -> None:
        folder = store.folder / SPENT
        paths = folder.glob("[!.]*.json")
        self.before = sum((read_json(path, Spent, "what a session has spent") for path in paths), Spent())
        self._own = folder / f"{uuid.uuid4().hex}.json"
        self._written = Spent()

    def write(self, spent: Spent) -> None:
        if spent != self._written:
            write_whole(self._own, msgspec.json.encode(spent))
            self._written = spent


def is_inside(path: Path, folder: Path) -> bool:
    """Whether a path is a file in a folder that may come from anywhere: no link that leads out, and no pipe."""
    return path.resolve().is_relative_to(folder.resolve()) and path.is_file()


def read_json(path: Path, kind: type[T], what: str, folder: Path | None = None) -> T:
    """The content of a JSON file in `folder`, by default its own; errors name the expected kind."""
    if not is_inside(path, folder or path.parent):
        raise RecordError(f"{path}: not a file of this folder")
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from None
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise RecordError(f"{path}: not {what} ({error})") from None


def trial_files(folder: Path) -> Iterator[Path]:
    """The files of all finished trials, in no order; incomplete files are skipped."""
    return (folder / TRIALS).glob("[!.]*.json")


def read_trial(path: Path) -> TrialResult:
    """A finished trial. It may come from anywhere: its configuration is for `RunConfig.stored` only."""
    found = read_json(path, TrialResult, "a trial", path.parent.parent)
    if found.id != path.stem:  # names of figures and records are made of it
        raise RecordError(f"{path}: the trial of another file, {found.id}")
    if found.format != FORMAT:
        raise RecordError(f"{path}: format {found.format}; this release reads format {FORMAT}")
    if found.record not in (None, f"{RECORDS}/{found.id}.mcap"):
        raise RecordError(f"{path}: its record is another file, {found.record}")
    return found


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it holds all of `data` or, after a crash, what it held before. Missing folders are made."""
    # A unique name, because other processes may write the same file at the same time.
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        _sync(path.parent)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise RecordError(f"{path}: cannot be written ({error.strerror})") from error


def _sync(folder: Path) -> None:
    """Make new names in a folder survive a loss of power, where the system can do that."""
    if os.name != "posix":  # pragma: no cover
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
