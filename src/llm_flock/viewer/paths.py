"""Finds the records that the command line names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from llm_flock.errors import InputError

RECORD_NAME = "run.mcap"
FIRST_KEY = "1"
"""Key of a viewer's first run; the others count on from it."""


def records_in(paths: Iterable[Path]) -> list[Path]:
    """Records at the given paths: files, folders with a record, and folders with such folders.

    Raises:
        InputError: there is none.
    """
    found: list[Path] = []
    for path in paths:
        here = [path] if path.is_file() else [path / RECORD_NAME] if (path / RECORD_NAME).is_file() else []
        here = here or sorted(path.glob(f"*/{RECORD_NAME}"))
        if not here:
            raise InputError(
                "record", str(path), f"a record, a folder with {RECORD_NAME}, or a folder with such folders"
            )
        found.extend(here)
    return list(dict.fromkeys(found))


def newest_in(runs: Path) -> Path:
    """The newest record of a folder of runs.

    Raises:
        InputError: there is none.
    """
    there = sorted(runs.glob(f"*/{RECORD_NAME}"), key=lambda path: path.stat().st_mtime)
    if not there:
        raise InputError("live", str(runs), "a folder with a run in it, or a record that is named")
    return there[-1]


def title_of(path: Path) -> str:
    """Title of a record: the name of its folder, or of the file."""
    return path.resolve().parent.name if path.name == RECORD_NAME else path.stem
