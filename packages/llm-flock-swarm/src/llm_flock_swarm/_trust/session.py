"""The session number of each start of a member, kept in its folder."""

from __future__ import annotations

import os
from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.file_lock import lock_file
from llm_flock.members import member_name


def next_session(folder: Path, member: int, clock_s: float) -> int:
    """The number of this start: higher than all earlier ones, even if the clock `clock_s` went back."""
    path = folder / member_name(member) / "session"
    replacement = path.with_suffix(".new")
    try:
        with path.with_suffix(".lock").open("wb") as lock:
            lock_file(lock.fileno(), wait=True)  # two starts at the same time get two numbers
            last = int(path.read_text(encoding="ascii")) if path.exists() else 0
            session = max(last + 1, int(clock_s))
            if session >= 2**62:  # more than envelopes hold
                raise ValueError(session)
            with replacement.open("w", encoding="ascii") as file:
                file.write(str(session))
                file.flush()
                os.fsync(file.fileno())  # a loss of power must not bring back an earlier session
            replacement.replace(path)
    except ValueError:
        raise InputError("keys", str(path), "one whole number") from None
    except OSError as error:
        raise InputError("keys", str(path), f"a file that can be read and replaced ({error.strerror})") from None
    return session
