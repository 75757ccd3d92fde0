"""The viewer's addresses: pages, data, orders and exports."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import BaseRoute, Route

from llm_flock.errors import FlockError
from llm_flock.printable import printable
from llm_flock_view._viewer import form
from llm_flock_view._viewer.canvases import player_options
from llm_flock_view._viewer.data import answer
from llm_flock_view._viewer.export import export
from llm_flock_view._viewer.library import Library
from llm_flock_view._viewer.page import html
from llm_flock_view._viewer.run_rows import FIGURES

if TYPE_CHECKING:
    from llm_flock_view._viewer.launcher import Launcher
    from llm_flock_view._viewer.orders import PageOrders
    from llm_flock_view._viewer.recording import Recording

UNCACHED = {"cache-control": "no-store"}
LONGEST = 100_000
"""Most bytes of an order."""


class Routes:
    """Answers what pages ask for. Pages name runs by keys, never by files."""

    def __init__(self, library: Library, launcher: Launcher, orders: PageOrders) -> None:
        self.library = library
        self.launcher = launcher
        self.orders = orders

    def routes(self) -> Sequence[BaseRoute]:
        return [
            Route("/", self.home),
            Route("/runs", self.runs),
            Route("/run/{key}", self.run),
            Route("/pair/{first}/{second}", self.pair),
            Route("/cockpit", self.cockpit),
            Route("/export/{key}/{name}", self.export),
            Route("/data/shapes", self.shapes),
            Route("/data/runs", self.data),
            Route("/data/{key}/{what}", self.data),
            Route("/order", self.order, methods=["POST"]),
        ]

    # Functions that are no coroutines run in threads: a thousand robots take a while, and other pages go on meanwhile.
    def home(self, request: Request) -> Response:
        """The only run of the command line, the list of runs, or the cockpit."""
        runs = list(self.library.runs.values())
        if not runs:
            return self.cockpit(request)
        if len(runs) == 1 and runs[0].key not in self.launcher.runs:
            return _player(runs)
        return self.runs(request)

    def runs(self, request: Request) -> Response:
        return HTMLResponse(html("Runs", {"page": "runs", "figures": [label for _, label in FIGURES]}))

    def run(self, request: Request) -> Response:
        return self._play(request.path_params["key"])

    def pair(self, request: Request) -> Response:
        """Two runs side by side, with one clock."""
        return self._play(request.path_params["first"], request.path_params["second"])

    def cockpit(self, request: Request) -> Response:
        self.launcher.warm()
        return HTMLResponse(html("Cockpit", {"page": "cockpit", **form.options(self.launcher)}))

    def shapes(self, request: Request) -> Response:
        return Response(to_json(form.shape_pictures()), media_type="application/json", headers=UNCACHED)

    def data(self, request: Request) -> Response:
        text = answer(self.library, request.url.path, request.query_params)
        if text is None:
            return Response("no such run", status_code=404)
        return Response(text, media_type="application/json", headers=UNCACHED)

    def export(self, request: Request) -> Response:
        """A file that is made of a record."""
        run = self.library.runs.get(request.path_params["key"])
        if run is None or run.path is None:
            return Response("no such record", status_code=404)
        name = request.path_params["name"]
        try:
            content = export(run.path, name)
        except (FlockError, OSError) as error:
            return Response(printable(str(error)), status_code=400, media_type="text/plain")
        heads = {**UNCACHED, "content-disposition": f'attachment; filename="{name}"'}
        return Response(content, media_type="application/octet-stream", headers=heads)

    async def order(self, request: Request) -> Response:
        if request.headers.get("content-type", "").split(";")[0] != "application/json":
            return Response("an order is JSON", status_code=415)
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > LONGEST:
                return Response("too long", status_code=413)
        try:
            asked: Any = json.loads(body)
        except (ValueError, RecursionError):
            return Response("an order is JSON", status_code=400)
        try:
            reply = await self.orders.carry_out(asked)
        except asyncio.CancelledError:  # the viewer ends while a slow order waits
            return Response("the viewer ends", status_code=503)
        content = await run_in_threadpool(partial(to_json, reply))
        return Response(content, headers=UNCACHED, media_type="application/json")

    def _play(self, *keys: str) -> Response:
        runs = [self.library.find(key) for key in keys]
        if None in runs:
            return HTMLResponse(html("No such run", {"page": "lost"}), status_code=404)
        return _player([run for run in runs if run is not None])


def _player(runs: Sequence[Recording]) -> Response:
    title = " and ".join(run.title for run in runs)
    return HTMLResponse(html(title, player_options([(run.key, run.title) for run in runs])))
