"""Finds the records that the command line names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.printable import one_line
from llm_flock.record import MAGIC, RECORD_NAME


def records_in(paths: Iterable[Path]) -> list[Path]:
    """Records at the given paths: files, folders with a record, and folders with such folders."""
    found: list[Path] = []
    for path in paths:
        if path.is_file():
            _check_record(path)
        here = [path] if path.is_file() else [path / RECORD_NAME] if (path / RECORD_NAME).is_file() else []
        here = here or sorted(path.glob(f"*/{RECORD_NAME}"))
        if not here:
            raise InputError(
                "record", str(path), f"a record, a folder with {RECORD_NAME}, or a folder with such folders"
            )
        found.extend(here)
    once: dict[Path, Path] = {}
    for path in found:
        once.setdefault(path.resolve(), path)  # two names of one record, such as a link to its folder, are one run
    return list(once.values())


def growing_in(paths: Iterable[Path]) -> list[Path]:
    """Records at the given paths that are being written, or will be: files, and folders that hold one."""
    found = [path if path.suffix == ".mcap" or path.is_file() else path / RECORD_NAME for path in paths]
    for path in found:
        if path.is_file():
            _check_record(path)
    return found


def _check_record(path: Path) -> None:
    """Refuse a file that begins like no record. One that was cut off while it was written may be empty."""
    try:
        with path.open("rb") as file:
            begins = MAGIC.startswith(file.read(len(MAGIC)))
    except OSError as error:
        raise InputError("record", str(path), f"a record that can be read ({error.strerror})") from None
    if not begins:
        raise InputError("record", str(path), "a record of a run (MCAP); this file does not begin like one")


def newest_in(runs: Path) -> Path:
    """The newest record of a folder of runs."""
    there = sorted(runs.glob(f"*/{RECORD_NAME}"), key=lambda path: path.stat().st_mtime)
    if not there:
        raise InputError("runs", str(runs), "a folder with a run in it, or a record that is named")
    return there[-1]


def title_of(path: Path) -> str:
    """Title of a record, in one line: the name of its folder, or of the file."""
    return one_line(path.resolve().parent.name if path.name == RECORD_NAME else path.stem)
