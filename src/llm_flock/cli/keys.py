"""`llm-flock keys`: make the keys by which a team's processes trust each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from llm_flock.errors import InputError


def keys(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder", show_default=False)],
    robots: Annotated[int, typer.Option(min=1, help="Number of robots", show_default=False)],
    days: Annotated[int, typer.Option(min=1, help="Validity of the certificates [days]")] = 365,
) -> None:
    """Make the keys and certificates of a team whose robots are separate processes.

    No file is overwritten. Each robot gets a folder: its machine needs that folder, team.json and ca.pem.
    """
    try:
        from llm_flock.trust.keys import make_keys
    except ImportError:
        raise InputError("command", "keys", "possible once installed: pip install 'llm-flock[network]'") from None
    make_keys(folder, robots, days=days)
    print(f"keys of {robots} robots, operator, world and watcher in {folder}; keep {folder / 'authority'} offline")
