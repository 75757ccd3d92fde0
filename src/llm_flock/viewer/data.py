"""What the drawn parts of a page fetch: one run's rounds and figures as JSON, by its key."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, HTTPException, Query
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response
from pydantic_core import to_json

from llm_flock.viewer.gallery import Gallery
from llm_flock.viewer.reel import Reel

MOST_FRAMES = 256

Count = Annotated[int, Query(ge=0, le=10_000_000)]


def routes(gallery: Gallery) -> APIRouter:
    """Routes under /data."""
    router = APIRouter(prefix="/data", default_response_class=Response)

    def found(key: str) -> Reel:
        reel = gallery.get(key)
        if reel is None:
            raise HTTPException(404, "no such run")
        return reel

    @router.get("/{key}/about")
    async def about(key: str) -> Response:
        reel = found(key)
        return _json({"ready": True, **reel.about()} if reel.ready else {"ready": False, "failure": reel.failure})

    @router.get("/{key}/news")
    async def news(key: str, rounds: Count = 0, plans: Count = 0, missions: Count = 0) -> Response:
        return _json(found(key).news(rounds, plans, missions))

    @router.get("/{key}/frames")
    async def frames(key: str, first: Count = 0, count: Count = 1) -> Response:
        # A thousand robots take a while: the pages of others go on meanwhile.
        reel = found(key)
        return _json(await run_in_threadpool(reel.frames, first, min(count, MOST_FRAMES)))

    return router


def _json(value: object) -> Response:
    return Response(to_json(value), media_type="application/json", headers={"cache-control": "no-store"})
