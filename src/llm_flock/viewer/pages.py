"""Addresses of the viewer, and the frame around every page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fastapi import HTTPException
from nicegui import ui

from llm_flock.viewer.gallery import Gallery
from llm_flock.viewer.reel import Reel
from llm_flock.viewer.stage import Stage

CSS = Path(__file__).parent / "static" / "viewer.css"


@contextmanager
def framed(title: str, *, simulated: bool = False) -> Iterator[None]:
    """The header of a page, and room in it for what belongs to the page."""
    ui.add_css(CSS.read_text(encoding="utf-8"))
    ui.page_title(f"{title} · LLM-Flock")
    dark = ui.dark_mode(None)
    ui.context.client.content.classes("flock-content")
    with ui.element("header").classes("flock-header"):
        ui.link("LLM-Flock", "/").classes("flock-brand")
        ui.label(title).classes("flock-title")
        if simulated:
            ui.badge("simulated language models", color="grey-8").mark("simulated")
        ui.element("span").classes("flock-grow")
        yield

        button = ui.button(icon="contrast").props('flat dense round aria-label="Light or dark"')
        button.tooltip("Light or dark").on(
            "click",
            lambda event: dark.set_value(not event.args),
            js_handler="() => emit(document.body.classList.contains('body--dark'))",
        )


class Pages:
    """Registers the pages.

    Args:
        gallery: the runs.
    """

    def __init__(self, gallery: Gallery) -> None:
        self.gallery = gallery

    def register(self) -> None:
        """Give every page its address."""
        ui.page("/")(self.home)
        ui.page("/run/{key}")(self.run)
        ui.page("/pair/{first}/{second}")(self.pair)

    def home(self) -> None:
        """The only run, or a list of them."""
        reels = list(self.gallery.reels.values())
        if len(reels) == 1:
            self._stage(reels)
            return
        with framed("Runs"):
            pass
        with ui.element("main").classes("flock-page"), ui.element("section").classes("flock-card"):
            ui.label("Runs").classes("flock-subtitle")
            with ui.element("div").classes("flock-runs"):
                for reel in reels:
                    ui.link(reel.title, f"/run/{reel.key}")

    def run(self, key: str) -> None:
        """One run."""
        self._stage([self._found(key)])

    def pair(self, first: str, second: str) -> None:
        """Two runs side by side, with one clock."""
        self._stage([self._found(first), self._found(second)])

    def _found(self, key: str) -> Reel:
        reel = self.gallery.get(key)
        if reel is None:
            raise HTTPException(404, "no such run")
        return reel

    def _stage(self, reels: Sequence[Reel]) -> None:
        with framed(" and ".join(reel.title for reel in reels), simulated=any(reel.simulated for reel in reels)):
            pass
        Stage(reels).build()
