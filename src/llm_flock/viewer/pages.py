"""The viewer's pages, their addresses, and the frame around each."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from fastapi import HTTPException
from nicegui import run, ui

from llm_flock.errors import FlockError
from llm_flock.viewer.library import Library
from llm_flock.viewer.paths import RECORD_NAME
from llm_flock.viewer.player import Player
from llm_flock.viewer.preview import css, preview
from llm_flock.viewer.recording import Recording

if TYPE_CHECKING:
    from llm_flock.viewer.launcher import Launcher
    from llm_flock.viewer.swarm import SwarmSource

SHELL = """
<style>
#flock-shell {{ position: fixed; inset: 0; background: #f6f7f9; color: #1d232a; padding: 12px;
  font: 700 16px system-ui, 'DejaVu Sans', sans-serif; }}
@media (prefers-color-scheme: dark) {{ #flock-shell {{ background: #12161b; color: #e8eaed; }} }}
body:has(#app > *) #flock-shell {{ display: none; }}
</style>
<div id="flock-shell">LLM-Flock <span style="font-weight: 600; font-size: 14px">{title} …</span></div>
"""
"""First paint of a page without a run, while its scripts load."""


@contextmanager
def framed(title: str, first: str | None = None) -> Generator[None]:
    """The header of a page; elements that are made inside become buttons and links of the header.

    While the page's scripts load, `first` is painted, or the title where it is None.
    """
    ui.add_css(css())
    ui.page_title(f"{title} · LLM-Flock")
    ui.add_body_html(SHELL.format(title=escape(title)) if first is None else first)
    dark = ui.dark_mode(None)
    with ui.element("header").classes("flock-header"):
        ui.link("LLM-Flock", "/").classes("flock-brand")
        ui.label(title).classes("flock-title")
        ui.element("span").classes("flock-grow")
        yield
        button = ui.button(icon="contrast").props('flat dense round aria-label="Light or dark"')
        button.tooltip("Light or dark").on(
            "click",
            lambda event: dark.set_value(not event.args),
            js_handler="() => emit(document.body.classList.contains('body--dark'))",
        )


class Pages:
    """Builds the pages; `swarm` is the one that is watched, None without one."""

    def __init__(self, library: Library, launcher: Launcher, swarm: SwarmSource | None = None) -> None:
        self.library = library
        self.launcher = launcher
        self.swarm = swarm

    def register(self) -> None:
        """Give every page its address. Call it once, before the server starts."""
        ui.page("/")(self.home)
        ui.page("/runs")(self.runs)
        ui.page("/run/{key}")(self.run)
        ui.page("/pair/{first}/{second}")(self.pair)
        ui.page("/cockpit")(self.cockpit)

    def home(self) -> None:
        """The only run of the command line, the list of runs, or the cockpit."""
        runs = list(self.library.runs.values())
        if not runs:
            self.cockpit()
        elif len(runs) == 1 and runs[0].key not in self.launcher.runs:
            self._player(runs)
        else:
            self.runs()

    def runs(self) -> None:
        """A list of all runs."""
        with framed("Runs"):
            ui.link("Cockpit", "/cockpit")
        with ui.element("main").classes("flock-page"), ui.element("section").classes("flock-card"):
            ui.label("Runs").classes("flock-subtitle")
            if not self.library.runs:
                ui.label("None yet: the cockpit starts them.").classes("flock-hint")
            with ui.element("div").classes("flock-runs"):
                for run in self.library.runs.values():
                    ui.link(run.title, f"/run/{run.key}")
                    ui.label(run.description.replace(",", ", ")).classes("flock-hint")

    def run(self, key: str) -> None:
        """One run."""
        self._player([self._found(key)])

    def pair(self, first: str, second: str) -> None:
        """Two runs side by side, with one clock."""
        self._player([self._found(first), self._found(second)])

    def cockpit(self) -> None:
        """The form that starts runs."""
        from llm_flock.viewer.start_form import StartForm

        with framed("Cockpit"):
            ui.link("Runs", "/runs")
        with ui.element("main").classes("flock-page"):
            StartForm(self.launcher).build()

    def _found(self, key: str) -> Recording:
        run = self.library.runs.get(key)
        if run is None:
            raise HTTPException(404, "no such run")
        return run

    def _player(self, runs: Sequence[Recording]) -> None:
        with framed(" and ".join(run.title for run in runs), preview([(run.key, run.title) for run in runs])):
            ui.link("Runs", "/runs")
            ui.link("Cockpit", "/cockpit")
            if len(runs) == 1 and runs[0].path is not None:
                _export_menu(runs[0].path)
        Player(runs, self._controls(runs)).build()

    def _controls(self, runs: Sequence[Recording]) -> Callable[[], None] | None:
        """Builds the controls of runs that can be steered; None where none can."""
        steered = [self.launcher.runs[run.key] for run in runs if run.key in self.launcher.runs]
        if steered:
            from llm_flock.viewer.steering import RunControls

            return RunControls(steered).build
        if self.swarm is not None and self.swarm.recording in runs:
            from llm_flock.viewer.steering import swarm_controls

            return partial(swarm_controls, self.swarm)
        return None


def _export_menu(path: Path) -> None:
    """A button with everything that can be saved of a record."""
    kinds = [("Record (MCAP)", RECORD_NAME), ("Figure (PNG)", "snapshots.png"), ("Animation (GIF)", "animation.gif")]
    if shutil.which("ffmpeg"):
        kinds.append(("Animation (MP4)", "animation.mp4"))
    with ui.button("Export", icon="download").props("flat dense no-caps"), ui.menu():
        for label, name in kinds:
            ui.menu_item(label, partial(_save, path, name))


async def _save(path: Path, name: str) -> None:
    note = None if name == RECORD_NAME else ui.notification("drawing …", spinner=True, timeout=None)
    try:
        content = await run.io_bound(_exported, path, name)
    except (FlockError, OSError) as error:
        ui.notify(f"error: {error}", type="negative")
        return
    finally:
        if note is not None:
            note.dismiss()
    if content is not None:  # None when the viewer ends meanwhile
        ui.download.content(content, name)


def _exported(record: Path, name: str) -> bytes:
    """The record itself, or what is drawn from it."""
    if name == RECORD_NAME:
        return record.read_bytes()
    from llm_flock.record.reader import read_record
    from llm_flock.viz import figures
    from llm_flock.viz.animation import animate

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / name
        if target.suffix == ".png":
            figures.save(figures.snapshots(read_record(record)), target)
        else:
            animate(read_record(record), target)
        return target.read_bytes()
