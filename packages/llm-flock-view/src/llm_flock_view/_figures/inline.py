"""Runs as a notebook shows them: a picture and a table in HTML, and animations."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from llm_flock.errors import InputError
from llm_flock.extras import EXTRAS, require
from llm_flock.printable import one_line, shape_title
from llm_flock.record import RunRecord, caveats, protocol_text, work_text


@dataclass(frozen=True, slots=True, kw_only=True)
class Animation:
    """A run as an animated picture. A notebook shows it below its cell."""

    record: RunRecord
    fps: int  #: Frames per second.
    gif: bytes = field(repr=False)  #: The picture in the format GIF.

    def save(self, path: str | Path) -> None:
        """Write the animation; the file's ending decides: .gif, .mp4 or .webm.

        Raises:
            InputError: another ending, no ffmpeg for videos, or a place that cannot be written to.
        """
        from llm_flock_view._figures.animation import animate

        animate(self.record, Path(path), fps=self.fps)

    def _repr_html_(self) -> str:
        return _image(self.gif, "gif", f"Animation of {_title(self.record)}")


def animation(record: RunRecord, *, fps: int = 12) -> Animation:
    """Draw a record; takes about as long as a tenth of a second a round.

    Raises:
        InputError: a rate below 1.
        ExtraMissing: the extra `figures` is not installed.
    """
    require("figures", "animate()")
    if fps < 1:
        raise InputError("fps", fps, "at least 1 frame per second")
    from llm_flock_view._figures.animation import gif

    return Animation(record=record, fps=fps, gif=gif(record, fps))


def record_html(record: RunRecord) -> str:
    """The team at some rounds of a run, and the figures of its end."""
    title = _title(record)
    rows = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:left'>{escape(value)}</td></tr>"
        for name, value in end_figures(record)
    )
    picture = _picture(record, title)
    return f"<div><p><b>{escape(title)}</b></p>{picture}<table>{rows}</table></div>"


def _picture(record: RunRecord, title: str) -> str:
    figures = EXTRAS["figures"]
    if figures.missing:
        return f"<p>For a picture: {escape(figures.install)}</p>"
    from llm_flock_view._figures.figures import png, snapshots

    return _image(png(snapshots(record)), "png", f"Snapshots of {title}")


def _image(data: bytes, kind: str, words: str) -> str:
    text = b64encode(data).decode()
    return f'<img alt="{escape(words)}" style="max-width:100%" src="data:image/{kind};base64,{text}">'


def _title(record: RunRecord) -> str:
    mission = record.mission.mission
    simulated = " (simulated language models)" if record.run.simulated else ""
    shape = shape_title(str(mission["shape"]))
    return one_line(f"{shape}, {mission['n_robots']} robots, seed {record.run.seed}{simulated}")


def end_figures(record: RunRecord) -> Sequence[tuple[str, str]]:
    """The result as rows of text; records may come from anywhere, so nothing in them is trusted."""
    result: Mapping[str, Any] = record.result or {}
    last = record.metrics[-1]
    came, bound = record.outcome(), result.get("lower_bound_rounds")
    more = result.get("reason") if came.ending != "formed" else "" if bound is None else f"lower bound {bound}"
    free = record.run.simulated and not result.get("cost_usd")
    cost = "none (simulated)" if free else _number(last.cost_usd, "{:.4f} USD")
    rows = [
        ("protocol", protocol_text(record.run.config)),
        ("outcome", f"{came.headline} ({more})" if more else came.headline),
        ("why not", record.diagnosis().why),
        ("rounds", str(record.rounds)),
        ("plans in use", str(last.plans_in_use)),
        ("distinct goals", str(last.distinct_goals)),
        ("mean error [units]", _number(last.procrustes_mean, "{:.3f}")),
        ("smallest separation [units]", _number(result.get("min_separation"), "{:.3f}")),
        ("beware", "; ".join(caveats(result, record.mission.mission))),
        ("work", work_text(result)),
        ("model calls", f"{last.model_calls:,}"),
        ("tokens", f"{last.tokens:,}"),
        ("cost", cost),
        ("record", str(result.get("record") or "")),
        ("cannot be repeated", " ".join(record.run.unrepeatable or [])),
    ]
    return [(name, one_line(value)) for name, value in rows if value]


def _number(value: object, form: str) -> str:
    return form.format(value) if isinstance(value, int | float) else "not known"
