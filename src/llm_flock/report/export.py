"""The two tables as CSV."""

from __future__ import annotations

from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.experiments import tables


def export_csv(folder: Path, out: Path) -> list[Path]:
    """Write `trials.csv` and `rounds.csv`; older ones in the same place are replaced.

    Numbers are written with full precision; an unknown value is an empty field.

    Args:
        folder: the directory of results.
        out: folder for the files.

    Returns:
        both files.

    Raises:
        InputError: there are no results, or the files cannot be written.
        RecordError: a trial is damaged.
    """
    frames = {"trials.csv": tables.read_trials(folder), "rounds.csv": tables.read_rounds(folder)}
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, frame in frames.items():
            frame.write_csv(out / name)
    except OSError as error:
        raise InputError("out", str(out), f"a place that can be written to ({error.strerror})") from None
    return [out / name for name in frames]
