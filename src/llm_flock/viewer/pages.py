"""Addresses of the viewer, and the frame around every page."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING

from fastapi import HTTPException
from nicegui import ui

from llm_flock.viewer.exports import export_menu
from llm_flock.viewer.gallery import Gallery
from llm_flock.viewer.reel import Reel
from llm_flock.viewer.sketch import css, sketch
from llm_flock.viewer.stage import Stage

if TYPE_CHECKING:
    from llm_flock.viewer.connect import Swarm
    from llm_flock.viewer.launch import Cockpit

SHELL = """
<style>
#flock-shell {{ position: fixed; inset: 0; background: #f6f7f9; color: #1d232a; padding: 12px;
  font: 700 16px system-ui, 'DejaVu Sans', sans-serif; }}
@media (prefers-color-scheme: dark) {{ #flock-shell {{ background: #12161b; color: #e8eaed; }} }}
body:has(#app > *) #flock-shell {{ display: none; }}
</style>
<div id="flock-shell">LLM-Flock <span style="font-weight: 600; font-size: 14px">{title} …</span></div>
"""
"""What is painted first of a page without a run, while its scripts are loaded."""


@contextmanager
def framed(title: str, first: str | None = None) -> Generator[None]:
    """The header of a page, with room for buttons that belong to the page.

    Args:
        title: what people read.
        first: what is painted while the page's scripts are loaded; the title where None.
    """
    ui.add_css(css())
    ui.page_title(f"{title} · LLM-Flock")
    ui.add_body_html(SHELL.format(title=escape(title)) if first is None else first)
    dark = ui.dark_mode(None)
    with ui.element("header").classes("flock-header"):
        ui.link("LLM-Flock", "/").classes("flock-brand")
        ui.label(title).classes("flock-title").mark("title")
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
        cockpit: starts runs.
        swarm: the swarm that is watched, None without one.
    """

    def __init__(self, gallery: Gallery, cockpit: Cockpit, swarm: Swarm | None = None) -> None:
        self.gallery = gallery
        self.cockpit = cockpit
        self.swarm = swarm

    def register(self) -> None:
        """Give every page its address."""
        ui.page("/")(self.home)
        ui.page("/runs")(self.runs)
        ui.page("/run/{key}")(self.run)
        ui.page("/pair/{first}/{second}")(self.pair)
        ui.page("/cockpit")(self.fly)

    def home(self) -> None:
        """What was asked for on the command line: its only run, the list of its runs, or the cockpit."""
        reels = list(self.gallery.reels.values())
        if not reels:
            self.fly()
        elif len(reels) == 1 and reels[0].key not in self.cockpit.flights:
            self._stage(reels)
        else:
            self.runs()

    def runs(self) -> None:
        """A list of all runs."""
        with framed("Runs"):
            ui.link("Cockpit", "/cockpit")
        with ui.element("main").classes("flock-page"), ui.element("section").classes("flock-card"):
            ui.label("Runs").classes("flock-subtitle")
            if not self.gallery.reels:
                ui.label("None yet: the cockpit starts them.").classes("flock-hint")
            with ui.element("div").classes("flock-runs"):
                for reel in self.gallery.reels.values():
                    ui.link(reel.title, f"/run/{reel.key}")
                    ui.label(reel.in_words.replace(",", ", ")).classes("flock-hint")

    def run(self, key: str) -> None:
        """One run."""
        self._stage([self._found(key)])

    def pair(self, first: str, second: str) -> None:
        """Two runs side by side, with one clock."""
        self._stage([self._found(first), self._found(second)])

    def fly(self) -> None:
        """The form that starts runs."""
        from llm_flock.viewer.cockpit import Form

        with framed("Cockpit"):
            ui.link("Runs", "/runs")
        with ui.element("main").classes("flock-page"):
            Form(self.cockpit).build()

    def _found(self, key: str) -> Reel:
        reel = self.gallery.get(key)
        if reel is None:
            raise HTTPException(404, "no such run")
        return reel

    def _stage(self, reels: Sequence[Reel]) -> None:
        first = sketch([(reel.key, reel.title) for reel in reels])
        with framed(" and ".join(reel.title for reel in reels), first):
            ui.link("Runs", "/runs")
            ui.link("Cockpit", "/cockpit")
            if len(reels) == 1:
                export_menu(self.gallery, reels[0].key)
        flights = [self.cockpit.flights[reel.key] for reel in reels if reel.key in self.cockpit.flights]
        steer = None
        if flights or (self.swarm is not None and self.swarm.reel in reels):
            from llm_flock.viewer.steering import Controls, SwarmControls

            steer = Controls(flights).build if flights else SwarmControls(self.swarm).build if self.swarm else None
        Stage(reels, steer).build()
