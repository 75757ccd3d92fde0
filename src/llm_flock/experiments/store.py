"""A directory of results: one file a trial, each there in full or not at all.

    DIR/sweep.toml         the file that was given
    DIR/plan.json          every trial of it: id, labels
    DIR/trials/ID.json     a finished trial
    DIR/records/ID.mcap    its record, where it was kept
    DIR/claims/ID          held by the process that flies this trial now; the system lets go when that one dies
    DIR/spent/OWNER.json   what a process has spent so far, trials that it never finished included
    DIR/*.parquet          tables, built from the trials

Several processes may work on one directory, also on several machines that share a file system with `flock`.
"""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from llm_flock.errors import InputError, RecordError
from llm_flock.llm.sharing import Spent

try:
    import fcntl
except ImportError:  # pragma: no cover - systems without flock: two sweeps on one directory fly some trials twice
    fcntl = None

FORMAT = 1
"""Version of the files in `trials/`."""

TRIALS, RECORDS, CLAIMS, SPENT = "trials", "records", "claims", "spent"


class Earlier(msgspec.Struct, frozen=True, kw_only=True):
    """A try of a trial that was flown again: what it had cost.

    Attributes:
        stopped: why it ended.
        model_calls: calls it made.
        tokens: tokens in and out.
        cost_usd: its cost [US dollars]; None where no price is known.
    """

    stopped: str
    model_calls: int
    tokens: int
    cost_usd: float | None


class StoredTrial(msgspec.Struct, frozen=True, kw_only=True):
    """One finished trial: `trials/ID.json`.

    Attributes:
        id: address of the trial, made of everything in `config` that can change what happens.
        cell: everything but the seed, in a few words.
        axes: value of each axis of the grid that has no column of its own, in words.
        config: the resolved configuration.
        summary: `Summary.to_dict()`; None where the trial broke off before it had any.
        rounds: a list for each column of `tables.ROUNDS` but the first, all of the same length.
        error: what broke the trial off; None where nothing did.
        cut: the sweep's budget ran out while it flew; it is flown again as soon as there is a budget.
        simulated: whether any language model was a simulated stand-in.
        code: version of this package, and revision of its checkout where it runs from one.
        record: path of its record, relative to the directory; None where none was kept.
        earlier: tries before this one.
        format: version of this file.
    """

    id: str
    cell: str
    axes: dict[str, str]
    config: dict[str, Any]
    summary: dict[str, Any] | None
    rounds: dict[str, list[float | int | None]]
    error: str | None
    cut: bool
    simulated: bool
    code: str
    record: str | None = None
    earlier: tuple[Earlier, ...] = ()
    format: int = FORMAT

    @property
    def formed(self) -> bool:
        """Whether the formation was built; a trial that broke off has built none."""
        return self.error is None and self.summary is not None and bool(self.summary["formed"])

    @property
    def stopped(self) -> str:
        """Why it ended, as in `Summary.stopped`."""
        return "failed" if self.summary is None or self.error is not None else str(self.summary["stopped"])

    @property
    def tries(self) -> int:
        """How often it was flown."""
        return len(self.earlier) + 1

    def as_earlier(self) -> tuple[Earlier, ...]:
        """This try and those before it, for the one that replaces it."""
        summary = self.summary or {}
        mine = Earlier(
            stopped=self.stopped,
            model_calls=summary.get("model_calls", 0),
            tokens=summary.get("tokens", 0),
            cost_usd=summary.get("cost_usd", 0.0),
        )
        return (*self.earlier, mine)


class Claim:
    """The right to fly one trial; a context manager. It ends with the process, however that ends."""

    def __init__(self, path: Path, handle: int) -> None:
        self._path = path
        self._handle = handle

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.release()

    def release(self) -> None:
        """Let others have it. May be called twice."""
        if self._handle >= 0:
            self._path.unlink(missing_ok=True)
            os.close(self._handle)
            self._handle = -1


class Store:
    """The directory of one sweep.

    Args:
        folder: is made where it is missing.

    Raises:
        InputError: it cannot be made or written to.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            for name in (TRIALS, RECORDS, CLAIMS, SPENT):
                (folder / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError("out", str(folder), f"a folder that can be written to ({error.strerror})") from None

    def trial_path(self, trial: str) -> Path:
        """Where a finished trial is."""
        return self.folder / TRIALS / f"{trial}.json"

    def load(self, trial: str) -> StoredTrial | None:
        """A finished trial; None where it is not finished.

        Raises:
            RecordError: the file is damaged, or of a newer format.
        """
        path = self.trial_path(trial)
        return read_trial(path) if path.exists() else None

    def save(self, trial: StoredTrial) -> None:
        """Keep a finished trial. After this returns, no crash of process or machine loses it."""
        write_whole(self.trial_path(trial.id), msgspec.json.encode(trial))

    def keep_record(self, trial: str, record: Path | bytes) -> None:
        """Put a record, a file in `scratch` or its bytes, where it belongs; before its trial is saved."""
        target = self.folder / RECORDS / f"{trial}.mcap"
        if isinstance(record, bytes):
            write_whole(target, record)
        else:
            record.replace(target)
            sync_folder(target.parent)

    def scratch(self, trial: str) -> Path:
        """A folder for the record of a trial that is being flown."""
        return self.folder / RECORDS / f".{trial}"

    def claim(self, trial: str) -> Claim | None:
        """The right to fly a trial; None while another process has it."""
        path = self.folder / CLAIMS / trial
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            if fcntl is None:  # pragma: no cover
                return Claim(path, handle)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(handle)
                return None
            try:
                if os.fstat(handle).st_ino == path.stat().st_ino:
                    return Claim(path, handle)
            except FileNotFoundError:
                pass
            os.close(handle)  # the one who had it took the file away in between: this lock is on nothing

    def wait_for(self, name: str) -> Claim:
        """`claim`, as soon as nobody else has it."""
        while (claim := self.claim(name)) is None:
            time.sleep(0.02)
        return claim


class Ledger:
    """What this process has spent, where others on the same directory see it, and what they have."""

    def __init__(self, store: Store) -> None:
        self._folder = store.folder / SPENT
        self._own = self._folder / f"{uuid.uuid4().hex}.json"
        self._written = Spent()

    def write(self, spent: Spent) -> None:
        """All that this process has spent so far."""
        if spent != self._written:
            write_whole(self._own, msgspec.json.encode(spent))
            self._written = spent

    def others(self) -> Spent:
        """All that others have spent, now or in earlier sessions."""
        paths = [path for path in self._folder.glob("[!.]*.json") if path != self._own]
        return sum((msgspec.json.decode(path.read_bytes(), type=Spent) for path in paths), Spent())


def trial_files(folder: Path) -> Iterator[Path]:
    """The files of all finished trials, in no order; files that were never completed are passed over."""
    for entry in os.scandir(folder / TRIALS):
        if entry.name.endswith(".json") and not entry.name.startswith("."):
            yield Path(entry.path)


def read_trial(path: Path) -> StoredTrial:
    """One finished trial.

    Raises:
        RecordError: the file cannot be read, is damaged, or of a newer format.
    """
    try:
        found = msgspec.json.decode(path.read_bytes(), type=StoredTrial)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from None
    except msgspec.MsgspecError as error:
        raise RecordError(f"{path}: not a trial ({error})") from None
    if found.format != FORMAT:
        raise RecordError(f"{path}: format {found.format}; this release reads format {FORMAT}")
    return found


def write_whole(path: Path, data: bytes, *, dated_ns: int | None = None) -> None:
    """Write a file so that it is there in full or, whatever happens, as it was before.

    Args:
        path: where to.
        data: what it shall hold.
        dated_ns: time of change to give it, in nanoseconds since 1970; otherwise now.

    Raises:
        RecordError: the disk does not take it.
    """
    # A name of its own: another process may write the same file at the same time.
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}.partial")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if dated_ns is not None:
            os.utime(partial, ns=(dated_ns, dated_ns))
        partial.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise RecordError(f"{path}: cannot be written ({error.strerror})") from error


def sync_folder(folder: Path) -> None:
    """Let a name that was just put into a folder survive a loss of power, where the system can do that."""
    if os.name != "posix":  # pragma: no cover
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
