"""A directory of results: one file for each trial, complete or absent.

    DIR/sweep.toml         the file that describes the sweep
    DIR/plan.json          every trial of it: id, labels
    DIR/trials/ID.json     a finished trial
    DIR/records/ID.mcap    its record, where it was kept
    DIR/claims/ID          locked by the process that flies this trial now; the system unlocks it when that process ends
    DIR/spent/OWNER.json   what a process has spent so far, unfinished trials included
    DIR/*.parquet          tables, built from the trials

Several processes may work on one directory, also on several machines that share a file system with `flock`. Without
it, two sweeps on one directory fly some trials twice.
"""

from __future__ import annotations

import os
import shutil
import time
import uuid
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from llm_flock.errors import InputError, RecordError
from llm_flock.file_lock import lock_file
from llm_flock.llm import Spent
from llm_flock_lab._experiments.trial import FORMAT, TrialResult

TRIALS, RECORDS, CLAIMS, SPENT = "trials", "records", "claims", "spent"


class Store:
    """The directory of one sweep, created if it is missing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            for name in (TRIALS, RECORDS, CLAIMS, SPENT):
                (folder / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError("out", str(folder), f"a folder that can be written to ({error.strerror})") from None

    def trial_path(self, trial: str) -> Path:
        """The file of a finished trial."""
        return self.folder / TRIALS / f"{trial}.json"

    def load(self, trial: str) -> TrialResult | None:
        """A finished trial; None where it is not finished."""
        path = self.trial_path(trial)
        return read_trial(path) if path.exists() else None

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

    def clear_scratch(self, trial: str) -> None:
        """Delete what a trial left in its scratch folder: a record that is not kept."""
        with suppress(FileNotFoundError):
            shutil.rmtree(self.scratch(trial))

    @contextmanager
    def lease(self, trial: str) -> Generator[bool]:
        """Hold the right to fly a trial. Yields whether this process got it; it ends with the process at the latest."""
        handle = self._lock(self.folder / CLAIMS / trial)
        try:
            yield handle is not None
        finally:
            if handle is not None:
                (self.folder / CLAIMS / trial).unlink(missing_ok=True)
                os.close(handle)

    @contextmanager
    def wait_for(self, name: str) -> Generator[None]:
        """Hold a lease, as soon as no other process has it."""
        while True:
            with self.lease(name) as mine:
                if mine:
                    yield
                    return
            time.sleep(0.02)

    def _lock(self, path: Path) -> int | None:
        """The handle of a locked file; None while another process has locked it."""
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
            if not lock_file(handle):
                os.close(handle)
                return None
            with suppress(FileNotFoundError):
                if os.fstat(handle).st_ino == path.stat().st_ino:
                    return handle
            os.close(handle)  # the last owner deleted the file in between, so this lock holds nothing


class SpendingLog:
    """Tells other processes on the same directory what this one has spent, and reads what they have."""

    def __init__(self, store: Store) -> None:
        self._folder = store.folder / SPENT
        self._own = self._folder / f"{uuid.uuid4().hex}.json"
        self._written = Spent()

    def write(self, spent: Spent) -> None:
        """Set the total that this process has spent so far."""
        if spent != self._written:
            write_whole(self._own, msgspec.json.encode(spent))
            self._written = spent

    def others(self) -> Spent:
        """Sum over all other processes, earlier sessions included."""
        paths = [path for path in self._folder.glob("[!.]*.json") if path != self._own]
        return sum(map(_read_spent, paths), Spent())


def _read_spent(path: Path) -> Spent:
    try:
        return msgspec.json.decode(path.read_bytes(), type=Spent)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from None
    except (msgspec.MsgspecError, RecursionError) as error:
        raise RecordError(f"{path}: not what a process has spent ({error})") from None


def trial_files(folder: Path) -> Iterator[Path]:
    """The files of all finished trials, in no order; incomplete files are skipped."""
    for entry in os.scandir(folder / TRIALS):
        if entry.name.endswith(".json") and not entry.name.startswith("."):
            yield Path(entry.path)


def read_trial(path: Path) -> TrialResult:
    """Read one finished trial."""
    try:
        found = msgspec.json.decode(path.read_bytes(), type=TrialResult)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from None
    except (msgspec.MsgspecError, RecursionError) as error:
        raise RecordError(f"{path}: not a trial ({error})") from None
    if found.id != path.stem:  # names of figures and records are made of it
        raise RecordError(f"{path}: the trial of another file, {found.id}")
    if found.format != FORMAT:
        raise RecordError(f"{path}: format {found.format}; this release reads format {FORMAT}")
    return found


def write_whole(path: Path, data: bytes, *, dated_ns: int | None = None) -> None:
    """Write a file so that it holds all of `data` or, after a crash, what it held before; `dated_ns` since 1970."""
    # A unique name, because other processes may write the same file at the same time.
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}.partial")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if dated_ns is not None:
            os.utime(partial, ns=(dated_ns, dated_ns))
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
