"""`llm-flock view`: look at runs in a browser."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from llm_flock.errors import InputError

DEFAULT_PORT = 8765
RUNS = Path("runs")


def view(
    records: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[RECORD]...",
            help="Records (run.mcap), folders that hold one, or folders of such folders",
            show_default=False,
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Follow records that are still written [the newest one under runs/]")
    ] = False,
    host: Annotated[str, typer.Option(help="Address to listen at; another than this machine's own needs a token")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at; 0 takes a free one")] = DEFAULT_PORT,
    token: Annotated[
        str | None, typer.Option(help="What a browser has to show [made anew for another address]", show_default=False)
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser")] = True,
) -> None:
    """Watch runs in a browser: replay records, or follow one that is being flown."""
    from llm_flock.viewer.server import listen
    from llm_flock.viewer.show import show

    found = list(records or [])
    if live:
        found = [path / "run.mcap" if path.is_dir() or not path.suffix else path for path in found] or [_newest()]
    address = listen(host, port, token)
    print(address.url, flush=True)
    print("Ctrl-C ends the viewer", file=sys.stderr)
    show(address, found, live=live, browser=browser)


def _newest() -> Path:
    """The newest record under runs/."""
    there = sorted(RUNS.glob("*/run.mcap"), key=lambda path: path.stat().st_mtime)
    if not there:
        raise InputError("live", str(RUNS), "a run under runs/, or a record that is named")
    return there[-1]
