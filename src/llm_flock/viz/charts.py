"""Charts of many trials, drawn from plain numbers: bands, dots with intervals, boxes, histograms, lines on an axis."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from llm_flock.viz.chart_parts import (
    LETTER_INCHES,
    Look,
    Numbers,
    bins_for,
    folded,
    frame,
    legend,
    legend_inches,
    look_of,
    new_figure,
    shortened,
)
from llm_flock.viz.style import FAINT, GRID, INK, house_style

MOST_COLUMNS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A mean and its interval, over rounds or along an axis.

    Attributes:
        series: its series, which looks the same in all panels.
        x: rounds, or values of the axis.
        mean: the means there.
        low: lower ends of the intervals, NaN without.
        high: upper ends.
    """

    series: str
    x: Numbers
    mean: Numbers
    low: Numbers
    high: Numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Dot:
    """A value and its interval; None where they are not known.

    Attributes:
        series: its series.
        row: its row in the panel.
        value: the value.
        low: lower end of its interval.
        high: upper end.
    """

    series: str
    row: str
    value: float | None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """Many values of a series.

    Attributes:
        series: their series.
        row: their row in the panel; empty in histograms.
        values: in any order.
        note: a text beside them.
    """

    series: str
    row: str = ""
    values: Sequence[float] = ()
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Facet:
    """One panel.

    Attributes:
        title: its title.
        marks: the curves, dots or samples in it.
        edge: a value that a line marks.
    """

    title: str
    marks: Sequence[Any] = field(default_factory=tuple[Any, ...])
    edge: float | None = None


def bands(rows: Sequence[tuple[str, Sequence[Facet]]], series: Sequence[str], x: str, y: str) -> Figure:
    """Small multiples of curves with their bands; a row of panels for each entry of `rows`.

    Args:
        rows: title of a row, and its panels with `Curve`s.
        series: all series in their order, which gives each its look.
        x: label along.
        y: label upward.
    """
    with house_style():
        columns = max(len(panels) for _, panels in rows)
        figure = new_figure(max(5.2, 0.7 + 2.3 * columns), 0.75 + 1.95 * len(rows) + legend_inches(series, columns))
        grid = figure.subplots(len(rows), columns, squeeze=False, sharex=True, sharey=True)
        for number, (name, panels) in enumerate(rows):
            above = rows[number - 1][1] if number else ()
            for at, (axes, facet) in enumerate(zip(grid[number], panels, strict=False)):
                frame(axes)
                for curve in facet.marks:
                    _curve(axes, curve, series)
                repeated = len(above) > at and above[at].title == facet.title
                axes.set_title("" if repeated else folded(facet.title, 34))
                axes.set_ylim(bottom=0)
                axes.margins(x=0)
            for axes in grid[number][len(panels) :]:
                axes.set_axis_off()
            if name:
                at_the_right: dict[str, Any] = {"xycoords": "axes fraction", "rotation": 270, "ha": "left", "size": 8}
                grid[number][len(panels) - 1].annotate(folded(name, 30), (1.03, 0.5), va="center", **at_the_right)
        for axes in grid[-1]:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6))
        _finish(figure, series, columns, x, y, band=True)
        return figure


def along(panels: Sequence[Facet], series: Sequence[str], x: str, y: str, ticks: Sequence[str] | None = None) -> Figure:
    """Values along an axis of the grid, with bars for their intervals.

    Where `ticks` names the places 0, 1, ..., these are words, and no line joins them.
    """
    with house_style():
        figure, grid = _panels(panels, series, (0.7, 2.4), (0.7, 2.1))
        for axes, facet in zip(grid, panels, strict=True):
            frame(axes)
            for number, curve in enumerate(facet.marks):
                shift = 0.0 if ticks is None else 0.07 * (number - (len(facet.marks) - 1) / 2)
                _whiskered(axes, curve, series, shift, joined=ticks is None)
            axes.set_ylim(bottom=0)
            if ticks is not None:
                turn: dict[str, Any] = {"rotation": 30, "ha": "right"} if max(map(len, ticks)) > 6 else {}
                axes.set_xticks(range(len(ticks)), [shortened(tick, 24) for tick in ticks], **turn)
        _finish(figure, series, len(panels), x, y, solid=ticks is not None)
        return figure


def dots(panels: Sequence[Facet], series: Sequence[str], x: str, limits: tuple[float | None, float | None]) -> Figure:
    """A line of dots with intervals for every row and series; panels stand side by side and share their rows."""

    def draw(axes: Axes, mark: Dot, at: float, look: Look) -> None:
        if mark.value is None:
            axes.annotate("not known", (0.02, at), xycoords=("axes fraction", "data"), va="center", size=6, color=FAINT)
            return
        low, high = (mark.value if end is None else end for end in (mark.low, mark.high))
        axes.plot([low, high], [at, at], color=look.colour, linewidth=1.6, solid_capstyle="butt")
        axes.plot([mark.value], [at], ls="", marker=look.marker, ms=5, color=look.colour, mec=INK, mew=0.4)

    return _lined(panels, series, x, limits, draw)


def boxes(panels: Sequence[Facet], series: Sequence[str], x: str, limits: tuple[float | None, float | None]) -> Figure:
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

    return _lined(panels, series, x, limits, draw)


def histograms(panels: Sequence[Facet], series: Sequence[str], x: str, y: str) -> Figure:
    """Counts of values as outlines over each other; the range below a panel's edge is shaded."""
    with house_style():
        figure, grid = _panels(panels, series, (0.7, 2.4), (0.8, 1.9))
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
        _finish(figure, series, len(panels), x, y, line_only=True)
        return figure


def _panels(
    panels: Sequence[Facet], series: Sequence[str], width: tuple[float, float], height: tuple[float, float]
) -> tuple[Figure, list[Axes]]:
    """A figure with titled panels in rows of four at most, and their axes.

    Args:
        panels: the panels.
        series: all series, for which the legend needs room.
        width: width beside all panels, and of each [inches].
        height: height above and below all panels, and of each [inches].
    """
    columns = min(MOST_COLUMNS, len(panels))
    lines = math.ceil(len(panels) / columns)
    figure = new_figure(
        max(5.2, width[0] + width[1] * columns), height[0] + height[1] * lines + legend_inches(series, columns)
    )
    grid: list[Axes] = list(figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel())
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    for axes, facet in zip(grid, panels, strict=False):
        axes.set_title(folded(facet.title, 34))
    return figure, grid[: len(panels)]


def _finish(figure: Figure, series: Sequence[str], columns: int, x: str, y: str = "", **options: bool) -> None:
    """Label the axes, and put the legend above the panels."""
    figure.supxlabel(x, size=8)
    if y:
        figure.supylabel(y, size=8)
    legend(figure, series, min(MOST_COLUMNS, columns), **options)


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


def _whiskered(axes: Axes, curve: Curve, series: Sequence[str], shift: float, *, joined: bool) -> None:
    look = look_of(series, curve.series)
    line = look.line if joined else ""
    x = curve.x + shift
    axes.vlines(x, curve.low, curve.high, color=look.colour, linewidth=1.2)
    axes.plot(x, curve.mean, color=look.colour, ls=line, lw=1.2, marker=look.marker, ms=4, mec=INK, mew=0.3)


def _lined(
    panels: Sequence[Facet],
    series: Sequence[str],
    x: str,
    limits: tuple[float | None, float | None],
    draw: Callable[[Axes, Any, float, Look], None],
) -> Figure:
    """Panels side by side with the same rows, in each row a line for every series."""
    with house_style():
        names = list(dict.fromkeys(mark.row for facet in panels for mark in facet.marks))
        labelled = names != [""]
        left = 0.3 + LETTER_INCHES * min(26, max(map(len, names), default=0)) if labelled else 0.3
        # A gap of half a line between rows.
        step = len(series) + 0.8
        tall = max(0.95, 0.18 * step * len(names) + 0.15)
        figure, grid = _panels(panels, series, (left, 2.2), (0.5, tall + 0.45))
        for axes, facet in zip(grid, panels, strict=True):
            frame(axes, "x")
            if facet.edge is not None:
                axes.axvline(facet.edge, color=INK, linewidth=0.9, linestyle=(0, (4, 2)), zorder=1)
            for mark in facet.marks:
                line = names.index(mark.row) * step + series.index(mark.series)
                draw(axes, mark, line * 0.2, look_of(series, mark.series))
            middles = [(k * step + (len(series) - 1) / 2) * 0.2 for k in range(len(names))]
            axes.set_yticks(middles if labelled else [], [folded(n, 26) for n in names] if labelled else [])
            axes.tick_params(axis="y", length=0)
            axes.set_ylim((len(names) * step - 0.8 - 0.1) * 0.2, -0.9 * 0.2)
            axes.set_xlim(*limits)
        _finish(figure, series, len(panels), x, solid=True)
        return figure
