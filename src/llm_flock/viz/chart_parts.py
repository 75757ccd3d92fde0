"""Parts of charts: looks, frames, legends, labels."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from llm_flock.viz.style import FAINT, GRID, INK, LINES, MARKERS, SERIES

DPI = 160
LETTER_INCHES = 0.062
"""Width of a letter of a tick label, about."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How a series is drawn: never by colour alone."""

    colour: str
    line: str
    marker: str


def look_of(series: Sequence[str], name: str) -> Look:
    """The look of one of all series: the same in all panels."""
    number = series.index(name)
    return Look(
        colour=SERIES[number % len(SERIES)],
        line=LINES[number % len(LINES)],
        marker=MARKERS[number % len(MARKERS)],
    )


def frame(axes: Axes, grid: str = "both") -> None:
    """A quiet frame with a grid."""
    which: Any = grid
    axes.grid(axis=which, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(length=2)
    axes.spines[["top", "right"]].set_visible(False)


def legend(
    figure: Figure,
    series: Sequence[str],
    columns: int,
    *,
    band: bool = False,
    line_only: bool = False,
    solid: bool = False,
) -> None:
    """Names of all series above the panels."""
    handles: list[Line2D | Patch] = []
    for name in series:
        look = look_of(series, name)
        style: dict[str, Any] = {"lw": 1.4, "ms": 4.5, "mec": INK, "mew": 0.4}
        style |= {"ls": "-" if solid else look.line, "marker": "" if line_only else look.marker}
        handles.append(Line2D([], [], color=look.colour, label=shortened(name, 44), **style))
    if band:
        handles.append(Patch(color=FAINT, alpha=0.35, linewidth=0, label="95 % interval of the mean"))
    figure.legend(handles=handles, loc="outside upper center", ncols=legend_columns(series, columns))


def legend_columns(series: Sequence[str], columns: int) -> int:
    """Names that fit beside each other above the given columns of panels."""
    room = 2.3 * columns / (0.55 + LETTER_INCHES * max(map(len, series), default=1))
    return max(1, min(len(series) + 1, int(room)))


def legend_inches(series: Sequence[str], columns: int) -> float:
    """Height of the legend."""
    return 0.15 + 0.2 * math.ceil((len(series) + 1) / legend_columns(series, columns))


def bins_for(values: Sequence[float], edge: float | None) -> Numbers:
    """Edges of about thirty bins of equal width, one of which is the given edge."""
    top = max([*values, 1e-9 if edge is None else edge]) * 1.02
    step = top / 30
    if edge:
        step = edge / max(1, round(edge / step))
    return np.arange(0.0, top + step, step)


def folded(text: str, width: int) -> str:
    """A label on two lines at most, broken after a separator where there is one."""
    if "\n" in text:
        return "\n".join(folded(line, width) for line in text.split("\n"))
    if len(text) <= width:
        return text
    cut = max(text.rfind(sign, 0, width) for sign in " ,:/·-") + 1
    cut = cut if cut > width // 4 else width
    return f"{text[:cut].rstrip()}\n{shortened(text[cut:].lstrip(), width)}"


def shortened(text: str, most: int) -> str:
    """A text, cut to at most this many letters."""
    return text if len(text) <= most else text[: most - 1] + "…"


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of a size [inches]."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure
