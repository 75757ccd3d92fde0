"""A record as a moving picture: GIF by Pillow, MP4 by ffmpeg where it is installed."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from llm_flock.errors import InputError
from llm_flock.record.reader import RunRecord
from llm_flock.viz.panel import Panel
from llm_flock.viz.style import heading, house_style

STEPS_A_ROUND = 2
"""Frames of each round: robots fly straight, so what lies between two rounds is known."""

HOLD_S = 2.0
"""How long the end is shown [s]."""

INCHES = 4.8
DPI = 100
COLOURS = 64


def animate(record: RunRecord, path: Path, *, fps: int = 6) -> None:
    """Write a record as an animation; the file's ending decides: .gif or .mp4. Missing folders are made.

    Args:
        record: the run.
        path: file to write.
        fps: frames per second; a round takes two frames.

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
    with house_style():
        figure = Figure(figsize=(INCHES, INCHES + 0.6), dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.07, 0.06, 0.89, 0.82))
        figure.suptitle(heading(record), y=0.985, fontsize=8)
    panel = Panel(record, width=0.86 * INCHES * 72)
    for k in range(record.rounds + 1):
        steps = 1 if k == 0 else STEPS_A_ROUND
        for step in range(1, steps + 1):
            with house_style():
                axes.clear()
                panel.draw(axes, k, step / steps)
                axes.set_title(_caption(record, k))
                canvas.draw()
            yield Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba()).convert("RGB")


def _caption(record: RunRecord, k: int) -> str:
    row = record.metrics[k]
    n = record.positions.shape[1]
    plans = "1 plan" if row.plans_in_use == 1 else f"{row.plans_in_use} plans"
    error = "" if row.procrustes_mean is None else f" · error {row.procrustes_mean:.2f}"
    return f"round {k} of {record.rounds} · {plans} · {row.robots_at_goal} of {n} at their goal{error}"


def _write_gif(record: RunRecord, path: Path, fps: int) -> None:
    pictures = list(frames(record))
    # One palette for all frames, made from the one with the most colours, so that colours do not flicker.
    busiest = max(pictures, key=lambda picture: len(picture.getcolors(1 << 24) or ()))
    palette = busiest.quantize(COLOURS)
    indexed = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    shown_ms = [round(1000 / fps)] * (len(indexed) - 1) + [round(1000 * HOLD_S)]
    indexed[0].save(path, save_all=True, append_images=indexed[1:], duration=shown_ms, loop=0, optimize=False)


def _write_mp4(record: RunRecord, path: Path, fps: int, ffmpeg: str) -> None:
    size = f"{round(INCHES * DPI)}x{round((INCHES + 0.6) * DPI)}"
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"]
    target = ["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    command = [ffmpeg, "-y", "-loglevel", "error", *source, *target]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        data = b""
        try:
            for picture in frames(record):
                data = picture.tobytes()
                process.stdin.write(data)
            for _ in range(round(HOLD_S * fps)):
                process.stdin.write(data)
        except BrokenPipeError:
            pass  # ffmpeg gave up; it says why below
        _, said = process.communicate()
    if process.returncode:
        reason = said.decode(errors="replace").strip()
        raise InputError("out", str(path), f"what ffmpeg can write ({reason})")
