"""Puts a viewer together: its runs, its pages, and what goes on beside them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from llm_flock.viewer.gallery import Gallery, play
from llm_flock.viewer.named import title_of
from llm_flock.viewer.reel import Reel
from llm_flock.viewer.server import Address, serve
from llm_flock.viewer.told import told

if TYPE_CHECKING:
    from fastapi import FastAPI

    from llm_flock.runtime.network.config import SwarmConfig
    from llm_flock.viewer.launch import Cockpit


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
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


def show(address: Address, shown: Shown) -> None:
    """Serve the viewer until the process is told to end.

    Args:
        address: where.
        shown: what.

    Raises:
        InputError: a model cannot be asked, or NiceGUI is missing.
    """
    gallery = Gallery()
    found = [(path, gallery.add(title_of(path), path, live=shown.live)) for path in shown.records]
    threading.Thread(target=_read, args=(found,), kwargs={"live": shown.live}, daemon=True).start()
    address.greeter.tell(partial(told, gallery))

    def build(app: FastAPI) -> Callable[[], None]:
        from llm_flock.viewer.data import routes
        from llm_flock.viewer.pages import Pages

        work: list[Callable[[], None]] = []
        swarm = None
        if shown.swarm is not None:
            from llm_flock.viewer.connect import Swarm

            swarm = Swarm(shown.swarm, gallery.add(f"swarm {shown.swarm.network.swarm}"))
            work.append(swarm.watch)
        app.include_router(routes(gallery))
        Pages(gallery, _cockpit(gallery, shown), swarm).register()
        return lambda: _all(work)

    serve(address, build)


def _cockpit(gallery: Gallery, shown: Shown) -> Cockpit:
    from llm_flock.viewer.launch import Cockpit

    reader = None
    if shown.models:
        from llm_flock.viewer.plain import Reader

        reader = Reader(shown.models[0], shown.base_url)
    return Cockpit(gallery, shown.runs, shown.models, shown.base_url, reader)


def _all(work: Sequence[Callable[[], None]]) -> None:
    for part in work:
        threading.Thread(target=part, daemon=True).start()


def _read(found: Sequence[tuple[Path, Reel]], *, live: bool) -> None:
    """Read records one after another, growing ones at the same time."""
    if live:
        _all([lambda path=path, reel=reel: play(path, reel, live=True) for path, reel in found])
        return
    for path, reel in found:
        play(path, reel, live=False)
