"""Puts a viewer together: its runs, its pages, and the threads that feed them."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from llm_flock.errors import InputError
from llm_flock.viewer.data import answer
from llm_flock.viewer.library import Library, load
from llm_flock.viewer.paths import title_of
from llm_flock.viewer.recording import Recording
from llm_flock.viewer.server import Address
from llm_flock.viewer.startup import OPEN

if TYPE_CHECKING:
    from fastapi import FastAPI

    from llm_flock.runtime.network.config import SwarmConfig


def run_viewer(
    address: Address,
    *,
    records: Sequence[Path],
    live: bool,
    swarm: SwarmConfig | None,
    runs: Path,
    models: Sequence[str],
    base_url: str | None,
) -> None:
    """Serve the viewer until the process is stopped.

    Args:
        address: where.
        records: files.
        live: whether the records are still being written.
        swarm: a swarm to watch.
        runs: folder for the records of runs that are started from the page.
        models: models, other than simulated ones, that runs started from the page may ask.
        base_url: address that replaces the provider's own.

    Raises:
        InputError: a model cannot be asked, or NiceGUI is missing.
    """
    library = Library()
    found = [library.add(title_of(path), path, live=live) for path in records]
    # Growing records are read at the same time, finished ones one after another.
    for batch in [[run] for run in found] if live else [found]:
        threading.Thread(target=_load_all, args=(batch,), daemon=True).start()
    address.startup.answer_data(partial(answer, library))
    # The heavy libraries come last: the startup server answers meanwhile.
    try:
        import uvicorn
        from fastapi import FastAPI
        from nicegui import ui
    except ImportError as error:
        allowed = f'the viewer\'s libraries ({error.name} is missing): pip install "llm-flock[view]"'
        raise InputError("view", "not installed", allowed) from None
    from llm_flock.viewer.guard import RequestGuard
    from llm_flock.viewer.launcher import Launcher
    from llm_flock.viewer.pages import Pages

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.add_middleware(RequestGuard, hosts=address.hosts, token=address.token)
    _serve_data(app, library)
    reader = source = None
    if models:
        from llm_flock.viewer.mission_text import MissionReader

        reader = MissionReader(models[0], base_url)
    if swarm is not None:
        from llm_flock.viewer.swarm import SwarmSource

        source = SwarmSource(swarm, library.add(f"swarm {swarm.network.swarm}"))
    Pages(library, Launcher(library, runs, models, base_url, reader), source).register()
    ui.run_with(  # pyright: ignore[reportUnknownMemberType]
        app,
        title="LLM-Flock",
        dark=None,
        language="en-US",
        tailwind=False,
        show_welcome_message=False,
        reconnect_timeout=10.0,
        binding_refresh_interval=None,
    )
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1))
    if source is not None:
        threading.Thread(target=source.watch, daemon=True).start()
    address.startup.stop()
    server.run(sockets=[address.sock])


def _load_all(runs: Sequence[Recording]) -> None:
    for run in runs:
        load(run)


def _serve_data(app: FastAPI, library: Library) -> None:
    from starlette.requests import Request
    from starlette.responses import Response

    uncached = {"cache-control": "no-store"}

    async def is_open(request: Request) -> Response:
        return Response(status_code=204, headers=uncached)

    # Not a coroutine, so that it runs in a thread: a thousand robots take a while, and other pages go on meanwhile.
    def data(request: Request) -> Response:
        text = answer(library, request.url.path, request.query_params)
        if text is None:
            return Response("no such run", status_code=404)
        return Response(text, media_type="application/json", headers=uncached)

    app.add_route(OPEN, is_open)
    app.add_route("/data/{key}/{what}", data)
