"""Puts a viewer together: its runs, its pages, and the threads that feed them."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import uvicorn
from starlette.applications import Starlette

from llm_flock_view._viewer.connections import PatientConnection
from llm_flock_view._viewer.guard import RequestGuard
from llm_flock_view._viewer.launcher import Launcher
from llm_flock_view._viewer.library import Library
from llm_flock_view._viewer.orders import PageOrders
from llm_flock_view._viewer.paths import title_of
from llm_flock_view._viewer.routes import Routes
from llm_flock_view._viewer.server import Address
from llm_flock_view._viewer.swarm import SwarmSource

if TYPE_CHECKING:
    from llm_flock.llm import MissionReader
    from llm_flock_view._foxglove.server import FoxgloveServer
    from llm_flock_view._viewer.swarm import WatchedTeam


def run_viewer(
    address: Address,
    *,
    records: Sequence[Path],
    folders: Sequence[Path] = (),
    live: bool,
    swarm: WatchedTeam | None,
    runs: Path,
    models: Sequence[str],
    base_url: str | None,
    reader: MissionReader | None = None,
    foxglove: FoxgloveServer | None = None,
) -> None:
    """Serve the viewer until the process is stopped.

    Args:
        address: where.
        records: files.
        folders: their new records are shown as well.
        live: whether the records are still being written.
        swarm: a swarm to watch.
        runs: folder for the records of runs that are started from the page.
        models: models, other than simulated ones, that runs started from the page may ask.
        base_url: address that replaces the provider's own.
        reader: reads missions as text; without one the page takes none.
        foxglove: takes the newest run as well.
    """
    library = Library(runs)
    found = [library.add(title_of(path), path, live=live) for path in records]
    threading.Thread(target=library.read, args=(found,), daemon=True).start()
    threading.Thread(target=library.watch, args=(folders,), daemon=True).start()
    source = None if swarm is None else SwarmSource(swarm, library.add(swarm.name))
    launcher = Launcher(library, runs, models, base_url, reader)
    if foxglove is not None:
        from llm_flock_view._viewer.foxglove_feed import Feed

        if source is not None:
            source.also = foxglove
        threading.Thread(target=Feed(library, foxglove).run, daemon=True).start()
    app = Starlette(routes=Routes(library, launcher, PageOrders(library, launcher, source)).routes())
    guarded = RequestGuard(app, address.token)
    # Pages open no WebSocket.
    settings = uvicorn.Config(
        guarded, http=PatientConnection, ws="none", log_level="error", access_log=False, timeout_graceful_shutdown=1
    )
    server = uvicorn.Server(settings)
    if source is not None:
        threading.Thread(target=source.watch, daemon=True).start()
    server.run(sockets=[address.sock])
