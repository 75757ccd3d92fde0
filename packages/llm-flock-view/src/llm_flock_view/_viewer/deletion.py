"""Deletes the record of a run from the disk, by order of a page."""

from __future__ import annotations

import os
from contextlib import suppress

from llm_flock.errors import FieldError
from llm_flock.file_lock import lock_file
from llm_flock_view._viewer.paths import RECORD_NAME
from llm_flock_view._viewer.recording import Recording, version_of


def delete_record(run: Recording) -> None:
    """Delete a run's file if it is complete and still the one that was read, and its folder if that is empty."""
    if run.path is None:
        raise _error("there is no such record")
    if run.open:
        raise _error("the run is not over: end it first")
    if run.path.is_symlink():
        raise _error("the record is a symbolic link: delete the file that it points to by hand")
    try:
        with run.path.open("rb") as file:
            if not lock_file(file.fileno()):
                raise _error("another program still writes this record: end that run first")
            if run.version not in (None, version_of(os.fstat(file.fileno()))):
                raise _error("the file has changed since it was read: start the viewer again to see what it holds")
        run.path.unlink()
    except FileNotFoundError:
        return
    except OSError as error:
        raise _error(f"the record cannot be deleted: {error.strerror}") from None
    if run.path.name == RECORD_NAME:
        with suppress(OSError):  # it holds other files, is a link, or is where the viewer was started
            run.path.parent.rmdir()


def _error(says: str) -> FieldError:
    return FieldError("run", None, says=says)
