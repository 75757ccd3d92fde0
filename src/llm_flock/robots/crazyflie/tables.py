"""Where the tables of log variables and parameters are kept: fetching them takes most of a connection."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any


def default_folder() -> Path:
    """A folder in this user's cache (XDG base directories)."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    base = Path(given) if given.startswith("/") else Path.home() / ".cache"
    return base / "llm-flock" / "crazyflie"


def keep_whole(cf: Any, folder: Path) -> None:
    """Let a `Crazyflie` of cflib write each table whole: others read the file while drones that connect write it."""
    cache = cf._toc_cache  # noqa: SLF001

    def insert(checksum: int, table: object) -> None:
        with tempfile.TemporaryDirectory(dir=folder) as draft:
            type(cache)(rw_cache=draft).insert(checksum, table)
            file = f"{checksum:08X}.json"
            (Path(draft) / file).replace(folder / file)

    cache.insert = insert
