"""What the drawn parts of a page fetch: one run's rounds and figures as JSON, by its key."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, HTTPException, Query
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from llm_flock.viewer import told
from llm_flock.viewer.gallery import Gallery
from llm_flock.viewer.reel import Reel

Count = Annotated[int, Query(ge=0, le=told.MOST)]


def routes(gallery: Gallery) -> APIRouter:
    """Routes under /data."""
    router = APIRouter(prefix="/data", default_response_class=Response)

    def found(key: str) -> Reel:
        reel = gallery.get(key)
        if reel is None:
            raise HTTPException(404, "no such run")
        return reel

    @router.get("/open")
    async def is_open() -> Response:
        # Asked by a page that was painted before there was a server; see greeter.py.
        return Response(status_code=204, headers={"cache-control": "no-store"})

    @router.get("/{key}/about")
    async def about(key: str) -> Response:
        return _json(told.about(found(key)))

    @router.get("/{key}/news")
    async def news(key: str, rounds: Count = 0, plans: Count = 0, missions: Count = 0) -> Response:
        return _json(told.news(found(key), rounds, plans, missions))

    @router.get("/{key}/frames")
    async def frames(key: str, first: Count = 0, count: Count = 1) -> Response:
        # A thousand robots take a while: the pages of others go on meanwhile.
        return _json(await run_in_threadpool(told.frames, found(key), first, count))

    return router


def _json(text: bytes) -> Response:
    return Response(text, media_type="application/json", headers={"cache-control": "no-store"})
