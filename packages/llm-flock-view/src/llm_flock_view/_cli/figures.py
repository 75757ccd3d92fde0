"""`llm-flock figure` and `llm-flock animate`: draw records."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Annotated, Any

import typer

from llm_flock.cli import RecordPath, note_broken, note_replaced, say
from llm_flock.errors import InputError
from llm_flock.extras import require


def figure(
    records: Annotated[list[Path], typer.Argument(help="One or more records (run.mcap), or folders that hold one")],
    out: Annotated[Path | None, typer.Option(help="File to write; its suffix sets the format")] = None,
    kind: Annotated[
        str, typer.Option(help="snapshots, error or comparison [snapshots of one record, comparison of several]")
    ] = "",
    rounds: Annotated[str | None, typer.Option(help="Rounds of the snapshots, such as 0,4,7,12")] = None,
    label: Annotated[list[str] | None, typer.Option(help="Label of a record, in order; repeat for more")] = None,
    width: Annotated[
        str | None,
        typer.Option(
            help="Width of the figure, such as 3.5in, 7.16in or 89mm: a column and a page of two [as its panels need]",
            show_default=False,
        ),
    ] = None,
    font_size: Annotated[float, typer.Option(min=5.0, max=20.0, help="Size of its letters [points]")] = 8.0,
) -> None:
    """Draw records: snapshots of one run, the error over time of many, or runs side by side."""
    require("figures", "figure")
    from llm_flock.record import read_record

    runs = [read_record(path) for path in records]
    from llm_flock_view._figures import figures

    kind = kind or ("snapshots" if len(runs) == 1 else "comparison")
    target = out or runs[0].path.with_name(f"{kind}.png")
    look: dict[str, Any] = {"width": None if width is None else _inches(width), "font": font_size}
    if kind == "snapshots":
        if len(runs) != 1:
            raise InputError("records", len(runs), "one record for snapshots")
        drawn = figures.snapshots(runs[0], None if rounds is None else _rounds(rounds), **look)
    elif kind == "error":
        drawn = figures.error_over_time(runs, label or _labels(runs), **look)
    elif kind == "comparison":
        drawn = figures.comparison(runs, label or _labels(runs), **look)
    else:
        raise InputError("kind", kind, "snapshots, error or comparison")
    for field, value, used in (("rounds", rounds, kind == "snapshots"), ("label", label, kind != "snapshots")):
        if value and not used:
            raise InputError(field, value[0] if field == "label" else value, says=f"has no effect on {kind}")
    note_broken(runs)
    note_replaced(target)
    figures.save(drawn, target)
    say(target)


def animate(
    record: RecordPath,
    out: Annotated[
        Path | None,
        typer.Option(help="File to write, .gif, .mp4 or .webm [a GIF, and an MP4 too where ffmpeg is installed]"),
    ] = None,
    fps: Annotated[int, typer.Option(min=1, max=60, help="Frames per second")] = 12,
) -> None:
    """Draw a record as an animation."""
    require("figures", "animate")
    from llm_flock.record import read_record

    found = read_record(record)
    names = ("animation.gif", "animation.mp4") if shutil.which("ffmpeg") else ("animation.gif",)
    note_broken([found])
    from llm_flock_view._figures.animation import animate as draw

    for target in [out] if out else map(found.path.with_name, names):
        note_replaced(target)
        draw(found, target, fps=fps)
        say(target)


def _rounds(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError("rounds", text, "round numbers with commas between them, such as 0,4,7") from None


def _inches(text: str) -> float:
    found = re.fullmatch(r"(\d{1,4}(?:\.\d{1,4})?) ?(in|cm|mm)", text.strip())
    inches = 0.0 if found is None else float(found[1]) / {"in": 1.0, "cm": 2.54, "mm": 25.4}[found[2]]
    if not 2.0 <= inches <= 40.0:
        raise InputError("width", text, "from 2in to 40in, or as much in cm or mm, such as 3.5in")
    return inches


def _labels(runs: list[Any]) -> list[str]:
    """Labels of runs: their protocols."""
    from llm_flock.record import protocol_text

    return [protocol_text(r.run.config) or "unknown protocol" for r in runs]
