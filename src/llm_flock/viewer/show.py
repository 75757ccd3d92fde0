"""Puts a viewer together: its runs, its pages, and what goes on beside them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from llm_flock.viewer.gallery import Gallery, play, records_in, title_of
from llm_flock.viewer.reel import Reel
from llm_flock.viewer.server import Address, open_browser, serve

if TYPE_CHECKING:
    from fastapi import FastAPI


def show(address: Address, records: Sequence[Path], *, live: bool = False, browser: bool = True) -> None:
    """Serve the viewer until the process is told to end.

    Args:
        address: where.
        records: records, folders with one, or folders with such folders.
        live: whether the records are still being written.
        browser: whether the user's browser is pointed to it.

    Raises:
        InputError: a record is not there, or NiceGUI is not.
    """
    gallery = Gallery()
    found = [(path, gallery.add(title_of(path), path)) for path in (records if live else records_in(records))]
    if browser:
        open_browser(address)

    def build(app: FastAPI) -> Callable[[], None]:
        from llm_flock.viewer.data import routes
        from llm_flock.viewer.pages import Pages

        app.include_router(routes(gallery))
        Pages(gallery).register()
        return lambda: _read(found, live=live)

    serve(address, build)


def _read(found: Sequence[tuple[Path, Reel]], *, live: bool) -> None:
    """Read records one after another, growing ones at the same time."""
    for path, reel in found:
        if live:
            threading.Thread(target=play, args=(path, reel), kwargs={"live": True}, daemon=True).start()
        else:
            play(path, reel, live=False)
