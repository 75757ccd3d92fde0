"""Reads a file that a user named: as a whole, but not one without an end."""

from __future__ import annotations

import errno
import os
from pathlib import Path

MOST_CHARACTERS = 1 << 26
"""Longest text file; devices such as `/dev/zero` have no end."""


def read_text(path: Path, encoding: str = "utf-8") -> str:
    """The text of a file.

    Raises:
        OSError: it cannot be read, or has more than `MOST_CHARACTERS`.
        UnicodeDecodeError: it is not of this encoding.
    """
    with path.open(encoding=encoding) as file:
        text = file.read(MOST_CHARACTERS + 1)
    if len(text) > MOST_CHARACTERS:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return text
