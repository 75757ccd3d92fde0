"""Charts of many trials, drawn from plain numbers: bands, dots with intervals, boxes, histograms, lines on an axis."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from llm_flock.printable import one_line
from llm_flock_view._figures.style import FAINT, GRID, INK, LINES, MARKERS, SERIES, house_style

MAX_COLUMNS = 4
DPI = 160
COLUMN, PAGE = 3.5, 7.16
"""Widths of figures [inches]: a column, and a page of two columns. Their smallest letters have 6 points."""

LETTER_INCHES = 0.062  # width of a letter of a label, about

Numbers = NDArray[np.float64]


class Look(NamedTuple):
    """How a series is drawn: never by colour alone."""

    colour: str
    line: str
    marker: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A mean and the ends of its interval (NaN without), over rounds or along an axis."""

    series: str
    x: Numbers
    mean: Numbers
    low: Numbers
    high: Numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Dot:
    """A value and the ends of its interval in a row of a panel; None where they are not known."""

    series: str
    row: str
    value: float | None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """Many values of a series, in any order, and a text beside them; histograms have no rows."""

    series: str
    row: str = ""
    values: Sequence[float]
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Facet:
    """One panel with its curves, dots or samples; a line marks the value `edge`."""

    title: str
    marks: Sequence[Any]
    edge: float | None = None


def bands(
    rows: Sequence[tuple[str, Sequence[Facet]]], series: Sequence[str], x: str, y: str, scale: str = "linear"
) -> Figure:
    """Small multiples of curves with their bands, in titled `rows`; a name's place in `series` gives it its look."""
    with house_style():
        columns = max(len(panels) for _, panels in rows)
        width = page_width(columns)
        figure = new_figure(width, 0.75 + 1.35 * len(rows) + legend_inches(series, width))
        grid = figure.subplots(len(rows), columns, squeeze=False, sharex=True, sharey=True)
        for number, (name, panels) in enumerate(rows):
            above = rows[number - 1][1] if number else ()
            for at, (axes, facet) in enumerate(zip(grid[number], panels, strict=False)):
                frame(axes)
                for curve in facet.marks:
                    _curve(axes, curve, series)
                repeated = len(above) > at and above[at].title == facet.title
                axes.set_title("" if repeated else _fold_title(facet.title, columns), fontsize=8)
                axes.set_yscale(scale)
                axes.yaxis.set_major_formatter("{x:g}")
                axes.set_ylim(bottom=0)
                axes.margins(x=0)
            for axes, above_it in zip(grid[number][len(panels) :], grid[number - 1][len(panels) :], strict=True):
                axes.set_axis_off()
                above_it.tick_params(labelbottom=number > 0)  # nothing stands below it
            if name:
                at_the_right: dict[str, Any] = {"xycoords": "axes fraction", "rotation": 270, "ha": "left", "size": 8}
                grid[number][len(panels) - 1].annotate(fold(name, 20), (1.03, 0.5), va="center", **at_the_right)
        for axes in grid[-1]:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6))
        shown = [curve for _, panels in rows for facet in panels for curve in facet.marks]
        _finish(figure, series, x, y, band=any(np.isfinite(curve.low).any() for curve in shown))
        return figure


def along(panels: Sequence[Facet], series: Sequence[str], x: str, y: str, ticks: Sequence[str] | None = None) -> Figure:
    """Values along an axis of the grid, with bars for intervals; no line joins places 0, 1, ... named by `ticks`."""
    with house_style():
        figure, grid = _panels(panels, series, 0.7, 1.5)
        for axes, facet in zip(grid, panels, strict=True):
            frame(axes)
            for number, curve in enumerate(facet.marks):
                shift = 0.0 if ticks is None else 0.07 * (number - (len(facet.marks) - 1) / 2)
                _draw_whiskers(axes, curve, series, shift, joined=ticks is None)
            axes.set_ylim(bottom=0)
            if ticks is not None:
                turn: dict[str, Any] = {"rotation": 30, "ha": "right"} if max(map(len, ticks)) > 6 else {}
                axes.set_xticks(range(len(ticks)), [shorten(tick, 24) for tick in ticks], **turn)
        _finish(figure, series, x, y, solid=ticks is not None)
        return figure


def dots(panels: Sequence[Facet], series: Sequence[str], x: str, y: str, limits: tuple[float, float]) -> Figure:
    """A line of dots with intervals for every row and series; panels stand side by side and share their rows."""

    def draw(axes: Axes, mark: Dot, at: float, look: Look) -> None:
        if mark.value is None:
            axes.annotate("not known", (0.02, at), xycoords=("axes fraction", "data"), va="center", size=6, color=FAINT)
            return
        low, high = (mark.value if end is None else end for end in (mark.low, mark.high))
        axes.plot([low, high], [at, at], color=look.colour, linewidth=1.6, solid_capstyle="butt")
        axes.plot([mark.value], [at], ls="", marker=look.marker, ms=5, color=look.colour, mec=INK, mew=0.4)

    return _draw_lines(panels, series, x, y, limits, draw)


def boxes(panels: Sequence[Facet], series: Sequence[str], x: str, y: str, limits: tuple[float, float]) -> Figure:
    """Quartiles, a sign for the median, whiskers to the ends, and every value as a dot (up to 300 of them)."""

    def draw(axes: Axes, mark: Sample, at: float, look: Look) -> None:
        if mark.note:
            axes.annotate(
                mark.note, (0.985, at), xycoords=("axes fraction", "data"), ha="right", va="center", size=6, zorder=5
            )
        if not mark.values:
            return
        values = np.sort(np.array(mark.values, dtype=np.float64))
        low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
        axes.plot([values[0], values[-1]], [at, at], color=look.colour, linewidth=0.8)
        axes.barh(at, high - low, left=low, height=0.14, color=look.colour, alpha=0.45, linewidth=0)
        shown = values if len(values) <= 300 else values[np.linspace(0, len(values) - 1, 300).astype(int)]
        scatter = np.random.default_rng(0).uniform(-0.045, 0.045, len(shown))
        axes.scatter(shown, at + scatter, s=3, color=look.colour, linewidths=0, alpha=0.6)
        axes.plot([middle], [at], ls="", marker=look.marker, ms=5, color=look.colour, mec=INK, mew=0.6)

    return _draw_lines(panels, series, x, y, limits, draw)


def histograms(panels: Sequence[Facet], series: Sequence[str], x: str, y: str) -> Figure:
    """Counts of values as outlines over each other; the range below a panel's edge is shaded."""
    with house_style():
        figure, grid = _panels(panels, series, 0.8, 1.4)
        values = [value for facet in panels for mark in facet.marks for value in mark.values]
        bins: list[float] = bins_for(values, next((f.edge for f in panels if f.edge is not None), None)).tolist()
        for axes, facet in zip(grid, panels, strict=True):
            frame(axes)
            if facet.edge is not None:
                axes.axvspan(bins[0], facet.edge, color=GRID, alpha=0.6, linewidth=0, zorder=0)
                axes.axvline(facet.edge, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
            for mark in facet.marks:
                look = look_of(series, mark.series)
                axes.hist(mark.values, bins=bins, histtype="stepfilled", color=look.colour, alpha=0.15)
                axes.hist(mark.values, bins=bins, histtype="step", color=look.colour, ls=look.line, linewidth=1.4)
            axes.margins(x=0)
        grid[0].yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
        _finish(figure, series, x, y, line_only=True)
        return figure


def _panels(panels: Sequence[Facet], series: Sequence[str], beside: float, each: float) -> tuple[Figure, list[Axes]]:
    """A figure with titled panels, four in a row at most; heights are those beside all panels, and of each [inches]."""
    columns = min(MAX_COLUMNS, len(panels))
    lines = math.ceil(len(panels) / columns)
    width = page_width(columns)
    figure = new_figure(width, beside + each * lines + legend_inches(series, width))
    grid: list[Axes] = list(figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel())
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    for axes, facet in zip(grid, panels, strict=False):
        axes.set_title(_fold_title(facet.title, columns), fontsize=8)
    for above in grid[len(panels) - columns : columns * (lines - 1)]:
        above.tick_params(labelbottom=True)  # nothing stands below these
    return figure, grid[: len(panels)]


def _finish(
    figure: Figure,
    series: Sequence[str],
    x: str,
    y: str,
    *,
    band: bool = False,
    line_only: bool = False,
    solid: bool = False,
) -> None:
    figure.supxlabel(x, size=8)
    beside = figure.get_figheight() - 2 * legend_inches(series, figure.get_figwidth())
    figure.supylabel(fold(y, max(24, int(beside / LETTER_INCHES))), size=8)
    handles: list[Line2D | Patch] = []
    for name in series:
        look = look_of(series, name)
        style: dict[str, Any] = {"lw": 1.4, "ms": 4.5, "mec": INK, "mew": 0.4}
        style |= {"ls": "-" if solid else look.line, "marker": "" if line_only else look.marker}
        handles.append(Line2D([], [], color=look.colour, label=shorten(name, 44), **style))
    if band:
        handles.append(Patch(color=FAINT, alpha=0.35, linewidth=0, label="95 % interval of the mean"))
    figure.legend(handles=handles, loc="outside upper center", ncols=legend_columns(series, figure.get_figwidth()))


def _curve(axes: Axes, curve: Curve, series: Sequence[str]) -> None:
    look = look_of(series, curve.series)
    axes.fill_between(curve.x, curve.low, curve.high, color=look.colour, alpha=0.22, linewidth=0)
    every = max(1, len(curve.x) // 8)
    # Markers of different series begin at different rounds, so that none hides another.
    first = series.index(curve.series) * max(1, every // max(1, len(series))) % every
    axes.plot(
        curve.x,
        curve.mean,
        color=look.colour,
        linestyle=look.line,
        linewidth=1.4,
        marker=look.marker,
        markevery=(first, every),
        markersize=3.6,
        markeredgecolor=INK,
        markeredgewidth=0.3,
    )


def _draw_whiskers(axes: Axes, curve: Curve, series: Sequence[str], shift: float, *, joined: bool) -> None:
    look = look_of(series, curve.series)
    line = look.line if joined else ""
    x = curve.x + shift
    axes.vlines(x, curve.low, curve.high, color=look.colour, linewidth=1.2)
    axes.plot(x, curve.mean, color=look.colour, ls=line, lw=1.2, marker=look.marker, ms=4, mec=INK, mew=0.3)


def _draw_lines(
    panels: Sequence[Facet],
    series: Sequence[str],
    x: str,
    y: str,
    limits: tuple[float, float],
    draw: Callable[[Axes, Any, float, Look], None],
) -> Figure:
    """Panels side by side with the same rows, in each row a line for every series; a single row names the series."""
    with house_style():
        names = list(dict.fromkeys(mark.row for facet in panels for mark in facet.marks))
        labelled = names != [""]
        shown = names if labelled else list(series)
        # A gap of half a line between rows.
        step = len(series) + 0.8
        tall = max(0.95, 0.18 * step * len(names) + 0.15)
        figure, grid = _panels(panels, series, 0.5, tall + 0.45)
        for axes, facet in zip(grid, panels, strict=True):
            frame(axes, "x")
            if facet.edge is not None:
                axes.axvline(facet.edge, color=INK, linewidth=0.9, linestyle=(0, (4, 2)), zorder=1)
            for mark in facet.marks:
                line = names.index(mark.row) * step + series.index(mark.series)
                draw(axes, mark, line * 0.2, look_of(series, mark.series))
            middles = [(k * step + (len(series) - 1) / 2) * 0.2 for k in range(len(names))]
            places = middles if labelled else [0.2 * k for k in range(len(shown))]
            axes.set_yticks(places, [fold(name, 26) for name in shown])
            axes.tick_params(axis="y", length=0)
            axes.set_ylim((len(names) * step - 0.8 - 0.1) * 0.2, -0.9 * 0.2)
            axes.set_xlim(*limits)
        _finish(figure, series, x, y, solid=True)
        return figure


def look_of(series: Sequence[str], name: str) -> Look:
    number = series.index(name)
    return Look(SERIES[number % len(SERIES)], LINES[number % len(LINES)], MARKERS[number % len(MARKERS)])


def frame(axes: Axes, grid: str = "both") -> None:
    """A quiet frame with a grid."""
    which: Any = grid
    axes.grid(axis=which, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(length=2)
    axes.spines[["top", "right"]].set_visible(False)


def page_width(columns: int) -> float:
    """The width of a figure with panels side by side [inches]."""
    return COLUMN if columns == 1 else PAGE


def _fold_title(text: str, columns: int) -> str:
    """A title above one of several panels side by side; a letter of it takes less than a thirteenth of an inch."""
    return fold(text, int(13 * (page_width(columns) - 0.7) / columns))


def legend_columns(series: Sequence[str], inches: float) -> int:
    """Names that fit beside each other in a width."""
    room = (inches - 0.2) / (0.55 + LETTER_INCHES * max(map(len, series), default=1))
    return max(1, min(len(series) + 1, int(room)))


def legend_inches(series: Sequence[str], inches: float) -> float:
    return 0.15 + 0.2 * math.ceil((len(series) + 1) / legend_columns(series, inches))


def bins_for(values: Sequence[float], edge: float | None) -> Numbers:
    """Edges of about thirty bins of equal width, one of which is the given edge."""
    top = max([*values, 1e-9 if edge is None else edge]) * 1.02
    step = top / 30
    if edge:
        step = edge / max(1, round(edge / step))
    return np.arange(0.0, top + step, step)


def fold(text: str, width: int) -> str:
    """A label on two lines at most, broken after a separator where there is one."""
    if "\n" in text:
        return "\n".join(fold(line, width) for line in text.split("\n"))
    text = one_line(text)
    if len(text) <= width:
        return text
    cut = max(text.rfind(sign, 0, width) for sign in " ,:/·-") + 1
    cut = cut if cut > width // 4 else width
    return f"{text[:cut].rstrip()}\n{shorten(text[cut:].lstrip(), width)}"


def shorten(text: str, most: int) -> str:
    """A text of at most this many letters, cut in its middle: names of models, and conditions, differ at their end."""
    text = one_line(text)
    end = (most - 1) // 2
    return text if len(text) <= most else f"{text[: most - 1 - end]}…{text[-end:]}"


def new_figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure
