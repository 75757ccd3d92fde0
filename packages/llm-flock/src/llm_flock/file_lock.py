"""Marks an open file as in use, so that no other process deletes or continues it."""

from __future__ import annotations

from pathlib import Path

try:
    import fcntl
except ImportError:  # pragma: no cover - systems without flock cannot tell that a file is in use
    fcntl = None


def lock_file(handle: int, *, wait: bool = False) -> bool:
    """Lock an open file until it is closed; the system unlocks it when the process ends.

    Call it with the number of a file that is written for long, and before a file is deleted or continued. File systems
    that know no locks count as unlocked. With `wait`, it returns once the lock is free.

    Returns:
        whether the lock is held now; False while another open file, in this process or another one, has it.
    """
    if fcntl is None:  # pragma: no cover
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError:  # this file system has no locks
        return True
    return True


def is_written(path: Path) -> bool:
    """Whether a process writes this file now, and holds its lock."""
    try:
        with path.open("rb") as file:
            return not lock_file(file.fileno())
    except OSError:
        return False
