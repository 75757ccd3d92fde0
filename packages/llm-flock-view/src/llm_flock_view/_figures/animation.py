"""Animates a record: GIF by Pillow, MP4 and WebM by ffmpeg where it is installed."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import io
import itertools
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
from llm_flock.printable import one_line
from llm_flock.record import PALETTE, RunRecord
from llm_flock_view._figures.key import columns_of, key_of
from llm_flock_view._figures.labels import size_of
from llm_flock_view._figures.panel import Panel
from llm_flock_view._figures.style import DANGER, MAX_TITLE, heading, house_style, line_colour, whole_file

STEPS_A_ROUND = 4  # most frames of a round; robots fly straight between rounds, from rest to rest
MAX_GIF_PIXELS = 2_000_000  # a GIF that would be larger has fewer frames [bytes]
FPS = 12  # frames per second

CODECS = {".mp4": ("libx264", "-movflags", "+faststart"), ".webm": ("libvpx-vp9", "-crf", "34", "-b:v", "0")}
"""ffmpeg's coder for each kind of video, and its settings."""

HOLD_S = 2.0  # time that the end is shown [s]

INCHES = 4.8
HEAD_INCHES = 0.6
KEY_INCHES, ROW_INCHES = 0.42, 0.14
"""Below the arena: for its scale, and for each row of the legend."""

WIDTH = 0.88  # share of the picture's width that the arena takes

DPI = 100

KEY_POINTS, KEY_SCALE = 6.5, 0.72  # size of the letters of the legend, and of its signs in those of figures
TITLE_POINTS = 8.0  # size of the title; a longer one is smaller, so that it keeps to one line


def animate(record: RunRecord, path: Path, *, fps: int = FPS) -> None:
    """Write a record as an animation; the file's ending decides: .gif, .mp4 or .webm. Missing folders are made.

    It shows `fps` frames per second; a round takes four. A GIF of a long run gets fewer, until it is below 2 MB or
    shows each round once.

    Raises:
        InputError: another ending, a rate below 1, no ffmpeg for videos, or a place that cannot be written to.
    """
    if fps < 1:
        raise InputError("fps", fps, "at least 1 frame per second")
    kind = path.suffix.lower()
    if kind != ".gif" and kind not in CODECS:
        raise InputError("out", str(path), f"a file that ends in {', '.join(['.gif', *CODECS])}")
    ffmpeg = shutil.which("ffmpeg") if kind in CODECS else None
    if kind in CODECS and ffmpeg is None:
        raise InputError("out", str(path), f"a .gif file, or a {kind} file once ffmpeg is installed")
    with whole_file(path) as part:
        if ffmpeg is None:
            part.write_bytes(gif(record, fps))
        else:
            _write_video(record, path, part, fps, ffmpeg)


def last_frame(record: RunRecord) -> Image.Image:
    """The team at the end of a record, without a legend: those of all records of a mission have one size."""
    return next(frames(record, last=True))


def frames(record: RunRecord, *, steps: int = STEPS_A_ROUND, last: bool = False) -> Iterator[Image.Image]:
    """The run in pictures of one size: the start, then this many `steps` of each round; or only the last of them."""
    panel = Panel(record, width=WIDTH * INCHES * 72)
    key = [] if last else key_of([(panel, range(record.rounds + 1))])
    columns = min(2, columns_of(key, INCHES, KEY_POINTS))
    below = KEY_INCHES + ROW_INCHES * -(-len(key) // columns)
    tall = round((HEAD_INCHES + WIDTH * INCHES + below) * DPI / 2) * 2 / DPI  # video coders want even sizes
    with house_style():
        figure = Figure(figsize=(INCHES, tall), dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.09, below / tall, WIDTH, WIDTH * INCHES / tall))
        title = one_line(heading(record, MAX_TITLE), 120)
        fits = 0.96 * INCHES * 72 / size_of(title, TITLE_POINTS)[0]
        figure.suptitle(title, y=1 - 0.09 / tall, va="top", fontsize=TITLE_POINTS * min(1.0, fits))
        figure.legend(
            handles=key,
            loc="lower center",
            ncols=columns,
            fontsize=KEY_POINTS,
            borderaxespad=0.2,
            labelspacing=0.3,
            markerscale=KEY_SCALE,
        )
        panel.frame(axes)
        axes.set_xlabel("x and y [units]", fontsize=7.0, labelpad=1.0)
        canvas.draw()
        # The background is drawn once; each frame starts from a copy of it.
        background: Any = canvas.copy_from_bbox(figure.bbox)  # pyright: ignore[reportUnknownVariableType]
        caption = figure.text(0.5, 1 - 0.48 / tall, "", ha="center", fontsize=8.5)
    for k in range(record.rounds if last else 0, record.rounds + 1):
        count = 1 if k == 0 else steps
        for step in range(count if last else 1, count + 1):
            with house_style():
                panel.draw_team(axes, k, ease(step / count))
                caption.set_text(_caption(record, k))
                canvas.restore_region(background)
                drawn = sorted([*axes.collections, *axes.texts], key=Artist.get_zorder)
                for artist in (*drawn, caption):
                    figure.draw_artist(artist)
                for artist in drawn:
                    artist.remove()
            yield Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3])


def ease(part: float) -> float:
    """Share of the way after a part of the time, from rest to rest."""
    return part * part * (3.0 - 2.0 * part)


def _caption(record: RunRecord, k: int) -> str:
    row = record.metrics[k]
    n = record.positions.shape[1]
    plans = "1 plan" if row.plans_in_use == 1 else f"{row.plans_in_use} plans"
    error = "" if row.procrustes_mean is None else f" · error {row.procrustes_mean:.2f}"
    return f"round {k} of {record.rounds} · {plans} · {row.robots_at_goal} of {n} at their goal{error}"


def gif(record: RunRecord, fps: int = FPS) -> bytes:
    """A record as an animated GIF, with as many frames a round as MAX_GIF_PIXELS has room for."""
    for steps in (STEPS_A_ROUND, 2, 1):
        data = _gif(record, fps * steps / STEPS_A_ROUND, steps)
        if len(data) <= MAX_GIF_PIXELS:
            break
    return data


def _gif(record: RunRecord, fps: float, steps: int) -> bytes:
    indexed = _same_palette(list(frames(record, steps=steps)))
    shown_ms = [round(1000 / fps)] * (len(indexed) - 1) + [round(1000 * HOLD_S)]
    file = io.BytesIO()
    indexed[0].save(
        file, format="GIF", save_all=True, append_images=indexed[1:], duration=shown_ms, loop=0, optimize=False
    )
    return file.getvalue()


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
    plain = dict.fromkeys([*PALETTE, DANGER, *(line_colour(fill) for fill in PALETTE)])
    colours = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in plain])
    paler = [255 + share * (colours - 255) for share in (1.0, 0.8, 0.6, 0.4, 0.2)]
    darker = [share * colours for share in (0.75, 0.5)]
    greys = np.repeat(np.linspace(0, 255, 16)[:, None], 3, axis=1)
    return np.round(np.concatenate([greys, *paler, *darker]))


def _write_video(record: RunRecord, path: Path, part: Path, fps: int, ffmpeg: str) -> None:
    shown = frames(record)
    first = next(shown)
    size = f"{first.width}x{first.height}"
    coder, *settings = CODECS[path.suffix.lower()]
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"]
    target = ["-an", "-c:v", coder, "-pix_fmt", "yuv420p", *settings, str(part)]
    command = [ffmpeg, "-y", "-loglevel", "error", *source, *target]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        pipe = process.stdin
        assert pipe is not None
        data = b""
        try:
            for picture in itertools.chain([first], shown):
                data = picture.tobytes()
                pipe.write(data)
            for _ in range(round(HOLD_S * fps)):
                pipe.write(data)
        except BrokenPipeError:
            pass  # ffmpeg gave up; it says why below
        _, output = process.communicate()
    if process.returncode:
        reason = output.decode(errors="replace").strip()
        raise InputError("out", str(path), f"what ffmpeg can write ({reason})")
