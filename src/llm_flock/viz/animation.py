"""Animates a record: GIF by Pillow, MP4 by ffmpeg where it is installed."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree

from llm_flock.errors import InputError
from llm_flock.record.palette import PALETTE
from llm_flock.record.reader import RunRecord
from llm_flock.viz.panel import Panel
from llm_flock.viz.style import heading, house_style, line_colour

STEPS_A_ROUND = 2
"""Frames of each round; robots fly straight between rounds."""

HOLD_S = 2.0
"""Time that the end is shown [s]."""

INCHES = 4.8
HEAD_INCHES = 0.5
WIDTH = 0.88
"""Share of the picture's width that the arena takes."""

DPI = 100


def animate(record: RunRecord, path: Path, *, fps: int = 6) -> None:
    """Write a record as an animation; the file's ending decides: .gif or .mp4. Missing folders are made.

    It shows `fps` frames per second; a round takes two.

    Raises:
        InputError: another ending, a rate below 1, no ffmpeg for .mp4, or a place that cannot be written to.
    """
    if fps < 1:
        raise InputError("fps", fps, "at least 1 frame per second")
    kind = path.suffix.lower()
    if kind not in (".gif", ".mp4"):
        raise InputError("out", str(path), "a file that ends in .gif or .mp4")
    ffmpeg = shutil.which("ffmpeg") if kind == ".mp4" else None
    if kind == ".mp4" and ffmpeg is None:
        raise InputError("out", str(path), "a .gif file, or an .mp4 file once ffmpeg is installed")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if ffmpeg is None:
            _write_gif(record, path, fps)
        else:
            _write_mp4(record, path, fps, ffmpeg)
    except OSError as error:
        raise InputError("out", str(path), f"a place that can be written to ({error.strerror})") from None


def frames(record: RunRecord) -> Iterator[Image.Image]:
    """The run in pictures of one size: the start, then `STEPS_A_ROUND` of each round."""
    panel = Panel(record, width=WIDTH * INCHES * 72)
    with house_style():
        figure = Figure(figsize=(INCHES, INCHES + HEAD_INCHES), dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.09, 0.05, WIDTH, WIDTH * INCHES / (INCHES + HEAD_INCHES)))
        figure.suptitle(heading(record, INCHES), y=0.965, fontsize=8)
        panel.frame(axes)
        canvas.draw()
        # The background is drawn once; each frame starts from a copy of it.
        background: Any = canvas.copy_from_bbox(figure.bbox)  # pyright: ignore[reportUnknownVariableType]
        caption = figure.text(0.5, 0.875, "", ha="center", fontsize=8.5)
    for k in range(record.rounds + 1):
        steps = 1 if k == 0 else STEPS_A_ROUND
        for step in range(1, steps + 1):
            with house_style():
                panel.draw_team(axes, k, step / steps)
                caption.set_text(_caption(record, k))
                canvas.restore_region(background)
                drawn = sorted([*axes.collections, *axes.texts], key=Artist.get_zorder)
                for artist in (*drawn, caption):
                    figure.draw_artist(artist)
                for artist in drawn:
                    artist.remove()
            yield Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3])


def _caption(record: RunRecord, k: int) -> str:
    row = record.metrics[k]
    n = record.positions.shape[1]
    plans = "1 plan" if row.plans_in_use == 1 else f"{row.plans_in_use} plans"
    error = "" if row.procrustes_mean is None else f" · error {row.procrustes_mean:.2f}"
    return f"round {k} of {record.rounds} · {plans} · {row.robots_at_goal} of {n} at their goal{error}"


def _write_gif(record: RunRecord, path: Path, fps: int) -> None:
    pictures = list(frames(record))
    indexed = _same_palette(pictures)
    shown_ms = [round(1000 / fps)] * (len(indexed) - 1) + [round(1000 * HOLD_S)]
    indexed[0].save(path, save_all=True, append_images=indexed[1:], duration=shown_ms, loop=0, optimize=False)


def _same_palette(pictures: Sequence[Image.Image]) -> list[Image.Image]:
    """All pictures in the colours of the house and their shades: no colour flickers, no plan loses its own."""
    palette = _shades()
    # Every colour of 5 bits a channel, and the nearest of the palette: a table is much quicker than a search.
    levels = np.arange(32) * (255 / 31)
    cube = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
    _, nearest = KDTree(palette).query(cube)
    table = np.asarray(nearest, dtype=np.uint8)
    indexed: list[Image.Image] = []
    for picture in pictures:
        bits = np.asarray(picture).astype(np.intp) >> 3
        flat = Image.fromarray(table.take(bits @ (1 << 10, 1 << 5, 1)))
        flat.putpalette(palette.astype(np.uint8).tobytes())
        indexed.append(flat)
    return indexed


def _shades() -> NDArray[np.float64]:
    """Greys, and each colour of plans and paths mixed with paper and with ink, as soft edges mix them; shape (k, 3)."""
    plain = dict.fromkeys([*PALETTE, *(line_colour(fill) for fill in PALETTE)])
    colours = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in plain])
    paler = [255 + share * (colours - 255) for share in (1.0, 0.8, 0.6, 0.4, 0.2)]
    darker = [share * colours for share in (0.75, 0.5)]
    greys = np.repeat(np.linspace(0, 255, 16)[:, None], 3, axis=1)
    return np.round(np.concatenate([greys, *paler, *darker]))


def _write_mp4(record: RunRecord, path: Path, fps: int, ffmpeg: str) -> None:
    size = f"{round(INCHES * DPI)}x{round((INCHES + HEAD_INCHES) * DPI)}"
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"]
    target = ["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    command = [ffmpeg, "-y", "-loglevel", "error", *source, *target]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        pipe = process.stdin
        assert pipe is not None
        data = b""
        try:
            for picture in frames(record):
                data = picture.tobytes()
                pipe.write(data)
            for _ in range(round(HOLD_S * fps)):
                pipe.write(data)
        except BrokenPipeError:
            pass  # ffmpeg gave up; it says why below
        _, said = process.communicate()
    if process.returncode:
        reason = said.decode(errors="replace").strip()
        raise InputError("out", str(path), f"what ffmpeg can write ({reason})")
