"""Figures drawn from records: snapshots of a run, and the error of many over time (paper, sections 4.1 and 4.2)."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import scipy
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from llm_flock.errors import InputError
from llm_flock.printable import one_line
from llm_flock.record import PALETTE, RunRecord, ending, formed_text
from llm_flock_view._figures.charts import DPI, PAGE, fold, new_figure
from llm_flock_view._figures.key import Entry, columns_of, key_of
from llm_flock_view._figures.panel import ABOVE, SIDE, Box, Panel, close_up, view
from llm_flock_view._figures.style import (
    FONT,
    GRID,
    INK,
    LINES,
    MARKERS,
    RC,
    fit_title,
    heading,
    house_style,
    model_names,
    shapes,
    whole_file,
)

CONFIDENCE = 0.95  # of the intervals of means

Column: TypeAlias = NDArray[np.float64]

PANELS_A_ROW = 4
PANEL_INCHES = 2.75
LEAST_PANEL = 1.6
"""Least width of a panel, where the width of the whole figure is given [inches]."""

BETWEEN_INCHES = 0.3  # between two rows of panels, for the label of an axis and a title
ROWS, ROW_INCHES = 2, 0.17  # rows of a legend for which there is room anyway, and the height of each further one
LETTERS = 6.7  # smallest letters of a sheet [points]: the number of a crowd is a tenth smaller
MAX_LABEL = 100  # longest label of a curve [characters]

UNDATED: dict[str, dict[str, Any]] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""No date goes into a file, so that the same figure is always the same file."""


def snapshots(
    record: RunRecord, rounds: Sequence[int] | None = None, *, width: float | None = None, font: float = FONT
) -> Figure:
    """The team at chosen rounds: paths, discs by plan, influence, radio links and goals (paper, section 4.1).

    By default, these are the start, the first (when there are plans to see), half-way and the last. Space is shown
    twice, from above and below that from the side. The figure is as wide as its panels need, or has a `width` [inches];
    `font` is the size of its letters [points].

    Raises:
        InputError: the record has no such round, or no round is asked for.
    """
    last = record.rounds
    chosen = sorted({0, min(1, last), last // 2, last}) if rounds is None else list(rounds)
    if not chosen or any(not 0 <= k <= last for k in chosen):
        raise InputError("rounds", chosen, f"rounds of this record, 0 to {last}")
    with house_style(font):
        most = PANELS_A_ROW if width is None else max(1, int(width / LEAST_PANEL))
        rows = -(-len(chosen) // most)
        columns = -(-len(chosen) // rows)
        sides = [ABOVE, SIDE][: record.positions.shape[2] - 1]
        inches = PANEL_INCHES if width is None else (width - 0.4) / columns
        whole = max(columns * PANEL_INCHES, 5.5) if width is None else width
        tall = [inches * _tallness(view(record, seen=seen)) for seen in sides]
        between = BETWEEN_INCHES * (rows * len(sides) - 1)
        title = heading(record, 0.8 * whole * FONT / font)
        # In a narrow figure labels take a larger share.
        more = 0.2 * (title.count("\n") + (0 if width is None else rows * len(sides))) * font / FONT
        figure = new_figure(whole, rows * sum(tall) + 0.85 + between + more)
        # Two columns a panel: a last row with fewer panels stands in the middle.
        grid = figure.add_gridspec(rows * len(sides), 2 * columns, height_ratios=tall * rows)
        known = all(record.metrics[k].procrustes_mean is not None for k in chosen)
        panels: list[tuple[Panel, Axes, int]] = []
        for place, k in enumerate(chosen):
            row, column = divmod(place, columns)
            first = 2 * column + columns - min(columns, len(chosen) - row * columns)
            for below, seen in enumerate(sides):
                axes = figure.add_subplot(grid[row * len(sides) + below, first : first + 2])
                if not below:
                    axes.set_title(_moment(record, k, with_error=known))
                axes.set_xlabel("x [units]")
                if column == 0:
                    axes.set_ylabel(f"{'xyz'[seen[1]]} [units]")
                size: dict[str, Any] = {} if width is None else {"width": 72 * (inches - 0.3), "letters": 0.7 * font}
                panels.append((_frame(record, axes, k, seen, **size), axes, k))
        figure.suptitle(title)
        _legend(figure, key_of((panel, [k]) for panel, _, k in panels), whole)
        _draw_teams(figure, panels)
        return figure


def sheet(rows: Sequence[tuple[str, RunRecord, Sequence[int]]]) -> Figure:
    """Runs below each other, each with its label and as many rounds, as wide as a page of two columns.

    A run that ended before a round shows its last one; its title says which.
    """
    with house_style():
        columns, records = len(rows[0][2]), [record for _, record, _ in rows]
        inches = (PAGE - 0.5) / columns
        tall = sum(inches * _tallness(view(record)) + BETWEEN_INCHES for _, record, _ in rows)
        figure = new_figure(PAGE, tall + 0.75)
        grid = figure.subplots(len(rows), columns, squeeze=False)
        panels: list[tuple[Panel, Axes, int]] = []
        for (label, record, rounds), line in zip(rows, grid, strict=True):
            for k, axes in zip((min(k, record.rounds) for k in rounds), line, strict=True):
                axes.set_title(_moment(record, k, with_error=not math.isnan(record.errors[k])), fontsize=7)
                panel = _frame(record, axes, k, width=72 * (inches - 0.3), letters=LETTERS)
                panels.append((panel, axes, k))
            line[0].set_ylabel(fold(label, int(13 * inches)))
        figure.suptitle(fit_title(model_names(records), PAGE), fontsize=7.5)
        _legend(figure, key_of((panel, [k]) for panel, _, k in panels), PAGE)
        _draw_teams(figure, panels)
        return figure


def _frame(
    record: RunRecord, axes: Axes, k: int, seen: list[int] = ABOVE, *, width: float = 165.0, letters: float = 0.0
) -> Panel:
    """A framed panel for a round: near enough to see the team, with all of the arena in its corner."""
    near = close_up(record, k, seen)
    panel = Panel(record, window=near or view(record, seen=seen), width=width, letters=letters, seen=seen)
    panel.frame(axes)
    if near is not None:
        panel.inset(axes, k, view(record, 0.0, seen))
    return panel


def _legend(figure: Figure, entries: Sequence[Entry], inches: float) -> None:
    """A legend below the panels. A long one makes the figure taller: panels and titles keep their room."""
    size = float(rcParams["legend.fontsize"])
    columns = columns_of(entries, inches, size)
    rows = -(-len(entries) // columns)
    figure.set_figheight(figure.get_figheight() + ROW_INCHES * size / RC["legend.fontsize"] * max(0, rows - ROWS))
    figure.legend(handles=list(entries), loc="outside lower center", ncols=columns)


def error_over_time(
    records: Sequence[RunRecord], labels: Sequence[str], *, width: float | None = None, font: float = FONT
) -> Figure:
    """Mean shape error of all records that share a label, with 95 % Student-t intervals (paper, section 4.2).

    A run that ended early keeps its last error, so that all means are over the same runs.

    Raises:
        InputError: no records, not one label a record, or a record without errors.
    """
    groups = _groups(records, labels)
    with house_style(font):
        inches = width or 5.2
        figure = new_figure(inches, min(3.4, max(2.2, 0.65 * inches)))
        axes = figure.add_subplot()
        _curves(axes, groups)
        axes.legend(loc="upper right")
        figure.suptitle(fit_title(model_names(records), inches * FONT / font), fontsize=font)
        return figure


def comparison(
    records: Sequence[RunRecord], labels: Sequence[str], *, width: float | None = None, font: float = FONT
) -> Figure:
    """Runs side by side: how each ended, and below it the error of all over time.

    Where a run has no known ideal, as a described shape has none, the curves are left out.

    Raises:
        InputError: no records, or not one label a record.
    """
    _check_labels(records, labels)
    known = all(_error_known(record) for record in records)
    with house_style(font):
        whole = _around([view(record) for record in records])
        near = [box for record in records if (box := close_up(record, record.rounds)) is not None]
        window = _around(near) if len(near) == len(records) else whole
        columns = len(records)
        inches = PANEL_INCHES if width is None else (width - 0.4) / columns
        tall = inches * _tallness(window)
        broad = max(columns * (PANEL_INCHES + 0.2), 5.5) if width is None else width
        figure = new_figure(broad, tall + (3.3 if known else 1.2))
        grid = figure.add_gridspec(2, columns, height_ratios=[tall, 2.1]) if known else figure.add_gridspec(1, columns)
        size: dict[str, Any] = {} if width is None else {"width": 72 * (inches - 0.3), "letters": 0.7 * font}
        panels = [Panel(record, window=window, **size) for record in records]
        teams: list[tuple[Panel, Axes, int]] = []
        for column, (panel, label) in enumerate(zip(panels, labels, strict=True)):
            axes = figure.add_subplot(grid[0, column])
            panel.frame(axes)
            if window is not whole:
                panel.inset(axes, panel.record.rounds, view(panel.record, 0.0))
            axes.set_xlabel("x [units]")
            if column == 0:
                axes.set_ylabel("y [units]")
            teams.append((panel, axes, panel.record.rounds))
            lines = [fit_title(text, inches * FONT / font) for text in (label, outcome(panel.record))]
            axes.set_title("\n".join(lines), linespacing=1.4)
        if known:
            below = figure.add_subplot(grid[1, :])
            _curves(below, _groups(records, labels))
            below.legend(loc="upper right")
        robots = records[0].mission.mission["n_robots"]
        title = f"{shapes(records[0])} · {robots} robots · {model_names(records)}"
        figure.suptitle(fit_title(title, 0.8 * broad * FONT / font))
        _legend(figure, key_of((panel, [k]) for panel, _, k in teams), broad)
        _draw_teams(figure, teams)
        return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure; the file's ending decides the format (png, pdf, svg). Missing folders are made.

    Raises:
        InputError: the format is not known, or the file cannot be written.
    """
    formats = FigureCanvasAgg(figure).get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in formats:
        raise InputError("out", str(path), f"a file that ends in one of: {', '.join(sorted(formats))}")
    with house_style(), whole_file(path) as part:
        figure.savefig(part, dpi=DPI, metadata=UNDATED.get(path.suffix.lower()))


def png(figure: Figure) -> bytes:
    file = io.BytesIO()
    with house_style():
        figure.savefig(file, format="png", dpi=DPI)
    return file.getvalue()


def outcome(record: RunRecord) -> str:
    """How a run ended, in a few words."""
    last = record.metrics[-1]
    if formed := formed_text(record.result or {}):
        return formed
    plans = "1 plan" if last.plans_in_use == 1 else f"{last.plans_in_use} plans"
    goals = "1 goal" if last.distinct_goals == 1 else f"{last.distinct_goals} goals"
    how = "broke off" if ending(record.result) == "broke off" else "not formed"
    return f"{how}: {plans}, {goals}"


def mean_and_interval(curves: Sequence[Column]) -> tuple[Column, Column, Column]:
    """Mean error a round [units], and the ends of its Student-t interval, cut at 0; the last one stands to the end."""
    longest = max(len(curve) for curve in curves)
    table = np.array([np.pad(curve, (0, longest - len(curve)), mode="edge") for curve in curves])
    mean, count = table.mean(axis=0), len(table)
    if count < 2:
        return mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan)
    half = scipy.special.stdtrit(count - 1, (1 + CONFIDENCE) / 2) * table.std(axis=0, ddof=1) / math.sqrt(count)
    return mean, np.maximum(mean - half, 0.0), mean + half


def _curves(axes: Axes, groups: dict[str, list[Column]]) -> None:
    largest = 1
    for number, (label, curves) in enumerate(groups.items()):
        mean, low, high = mean_and_interval(curves)
        rounds = np.arange(len(mean))
        largest = max(largest, len(mean) - 1)
        colour = PALETTE[number % len(PALETTE)]
        many = f" (mean of {len(curves)} runs, {CONFIDENCE:.0%} interval)" if len(curves) > 1 else ""
        axes.plot(
            rounds,
            mean,
            color=colour,
            linestyle=LINES[number % len(LINES)],
            marker=MARKERS[number % len(MARKERS)],
            markevery=max(1, len(mean) // 10),
            markersize=4,
            markeredgecolor=INK,
            markeredgewidth=0.4,
            linewidth=1.4,
            label=one_line(label, MAX_LABEL) + many,
        )
        if len(curves) > 1:
            axes.fill_between(rounds, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set_xlim(0, largest)
    axes.set_ylim(bottom=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("round")
    axes.set_ylabel("mean distance\nto the ideal shape [units]")
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)


def _check_labels(records: Sequence[RunRecord], labels: Sequence[str]) -> None:
    if not records:
        raise InputError("records", 0, "at least one record")
    if len(labels) != len(records):
        raise InputError("label", list(labels), f"one label for each of the {len(records)} records")


def _error_known(record: RunRecord) -> bool:
    return not bool(np.isnan(record.errors).any())


def _groups(records: Sequence[RunRecord], labels: Sequence[str]) -> dict[str, list[Column]]:
    _check_labels(records, labels)
    groups: dict[str, list[Column]] = {}
    for record, label in zip(records, labels, strict=True):
        if not _error_known(record):
            raise InputError(
                "records", str(record.path), "records whose distance from the ideal shape is known after every round"
            )
        groups.setdefault(label, []).append(record.errors)
    return groups


def _draw_teams(figure: Figure, panels: Sequence[tuple[Panel, Axes, int]]) -> None:
    """Draw the teams once all else is in its place: words are placed by what is where on the page."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    figure.set_layout_engine("none")
    for axes in figure.axes:
        axes.apply_aspect()
        for inset in axes.child_axes:
            locator = inset.get_axes_locator()
            inset.apply_aspect(None if locator is None else locator(inset, RendererBase()))
    for panel, axes, k in panels:
        panel.draw_team(axes, k)


def _moment(record: RunRecord, k: int, *, with_error: bool) -> str:
    name = "start" if k == 0 else f"round {k}"
    return f"{name} · error {record.metrics[k].procrustes_mean:.2f}" if with_error else name


def _around(windows: Sequence[Box]) -> Box:
    lefts, rights, bottoms, tops = zip(*windows, strict=True)
    return (min(lefts), max(rights), min(bottoms), max(tops))


def _tallness(window: Box) -> float:
    """Height of a window in widths, kept within reason."""
    left, right, bottom, top = window
    return min(2.0, max(0.4, (top - bottom) / (right - left)))
