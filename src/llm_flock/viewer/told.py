"""What the drawn parts of a page are told of a run: JSON by its key, whoever answers the request."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic_core import to_json

from llm_flock.viewer.gallery import Gallery
from llm_flock.viewer.reel import Reel

MOST_FRAMES = 256
MOST = 10_000_000
"""Largest round that can be asked for."""


def about(reel: Reel) -> bytes:
    """What a page needs before the first round; before there is one, why there is none."""
    return to_json({"ready": True, **reel.about()} if reel.ready else {"ready": False, "failure": reel.failure})


def news(reel: Reel, rounds: int, plans: int, missions: int) -> bytes:
    """What came after so many rounds, plans and missions."""
    return to_json(reel.news(rounds, plans, missions))


def frames(reel: Reel, first: int, count: int) -> bytes:
    """The robots in some rounds, at most MOST_FRAMES of them."""
    return to_json(reel.frames(first, min(count, MOST_FRAMES)))


def told(gallery: Gallery, path: str, asked: Mapping[str, str]) -> bytes | None:
    """The answer to a request before there is a server that knows routes; None for one that has none.

    Args:
        gallery: the runs.
        path: such as /data/1/news.
        asked: the query.
    """
    parts = path.strip("/").split("/")
    reel = gallery.get(parts[1]) if len(parts) == 3 and parts[0] == "data" else None
    if reel is None:
        return None
    match parts[2]:
        case "about":
            return about(reel)
        case "news":
            return news(reel, _count(asked, "rounds"), _count(asked, "plans"), _count(asked, "missions"))
        case "frames":
            return frames(reel, _count(asked, "first"), _count(asked, "count", 1))
        case _:
            return None


def _count(asked: Mapping[str, str], name: str, usual: int = 0) -> int:
    given = asked.get(name, "")
    return min(int(given), MOST) if given.isascii() and given.isdigit() and len(given) < 20 else usual
