"""What can be taken away from a page: the record itself, a figure, an animation."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from nicegui import run, ui

from llm_flock.errors import FlockError
from llm_flock.viewer.gallery import Gallery


def export_menu(gallery: Gallery, key: str) -> None:
    """A button with everything that can be saved of a run; nothing for a run without a record."""
    path = gallery.paths.get(key)
    if path is None:
        return
    kinds: list[tuple[str, str, Callable[[Path], bytes]]] = [
        ("Record (MCAP)", "run.mcap", Path.read_bytes),
        ("Figure (PNG)", "snapshots.png", _figure),
        ("Animation (GIF)", "animation.gif", lambda record: _animation(record, ".gif")),
    ]
    if shutil.which("ffmpeg"):
        kinds.append(("Animation (MP4)", "animation.mp4", lambda record: _animation(record, ".mp4")))
    with ui.button("Export", icon="download").props("flat dense no-caps").mark("export"), ui.menu():
        for words, name, make in kinds:
            ui.menu_item(words, partial(_save, path, name, make))


async def _save(path: Path, name: str, make: Callable[[Path], bytes]) -> None:
    note = ui.notification("drawing …", spinner=True, timeout=None) if make is not Path.read_bytes else None
    try:
        content = await run.io_bound(make, path)
    except (FlockError, OSError) as error:
        ui.notify(f"error: {error}", type="negative")
        return
    finally:
        if note is not None:
            note.dismiss()
    if content is not None:  # None where the viewer ends meanwhile
        ui.download.content(content, name)


def _figure(record: Path) -> bytes:
    from llm_flock.record.reader import read_record
    from llm_flock.viz import figures

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "figure.png"
        figures.save(figures.snapshots(read_record(record), None), target)
        return target.read_bytes()


def _animation(record: Path, ending: str) -> bytes:
    from llm_flock.record.reader import read_record
    from llm_flock.viz.animation import animate

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / f"animation{ending}"
        animate(read_record(record), target)
        return target.read_bytes()
