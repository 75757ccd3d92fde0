"""Puts a viewer together: its runs, its pages, and the threads that feed them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from llm_flock.viewer.data import answer
from llm_flock.viewer.library import Library, load
from llm_flock.viewer.paths import title_of
from llm_flock.viewer.recording import Recording
from llm_flock.viewer.server import Address, serve
from llm_flock.viewer.startup import OPEN

if TYPE_CHECKING:
    from fastapi import FastAPI

    from llm_flock.runtime.network.config import SwarmConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewerOptions:
    """What a viewer shows and may do.

    Attributes:
        records: files.
        live: whether the records are still being written.
        swarm: a swarm to watch, None for none.
        runs: folder for the records of runs that are started from the page.
        models: models, other than simulated ones, that runs started from the page may ask.
        base_url: address that replaces the provider's own.
    """

    records: Sequence[Path] = ()
    live: bool = False
    swarm: SwarmConfig | None = None
    runs: Path = Path("runs")
    models: Sequence[str] = ()
    base_url: str | None = None


def run_viewer(address: Address, options: ViewerOptions) -> None:
    """Serve the viewer until the process is told to end.

    Args:
        address: where.
        options: what it shows and may do.

    Raises:
        InputError: a model cannot be asked, or NiceGUI is missing.
    """
    library = Library()
    found = [(path, library.add(title_of(path), path, live=options.live)) for path in options.records]
    threading.Thread(target=_load_all, args=(found,), kwargs={"live": options.live}, daemon=True).start()
    address.startup.answer_data(partial(answer, library))
    serve(address, partial(_build, library, options))


def _build(library: Library, options: ViewerOptions, app: FastAPI) -> Callable[[], None]:
    """Register data and pages; returns what runs beside the server. It loads the heavy libraries, so it comes last."""
    from llm_flock.viewer.launcher import Launcher
    from llm_flock.viewer.pages import Pages

    _serve_data(app, library)
    reader = None
    if options.models:
        from llm_flock.viewer.mission_text import MissionReader

        reader = MissionReader(options.models[0], options.base_url)
    launcher = Launcher(library, options.runs, options.models, options.base_url, reader)
    if options.swarm is None:
        Pages(library, launcher).register()
        return lambda: None
    from llm_flock.viewer.swarm import SwarmSource

    swarm = SwarmSource(options.swarm, library.add(f"swarm {options.swarm.network.swarm}"))
    Pages(library, launcher, swarm).register()
    return swarm.watch


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


def _load_all(found: Sequence[tuple[Path, Recording]], *, live: bool) -> None:
    """Read finished records one after another, growing ones at the same time."""
    for path, run in found:
        if live:
            threading.Thread(target=load, args=(path, run), kwargs={"live": True}, daemon=True).start()
        else:
            load(path, run, live=False)
