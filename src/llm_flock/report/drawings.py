"""The figures of a report: which there are, what is in each, and its caption."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter

import numpy as np
from matplotlib.font_manager import FontProperties

from llm_flock.experiments.statistics import Estimate, Method, mean_bands
from llm_flock.report.axes import along_axes
from llm_flock.report.drawing import INTERVALS, Drawing
from llm_flock.report.findings import ERROR, CellLine, PairLine, cell_lines, known, pair_lines
from llm_flock.report.results import ResultCell, Results, TrialRow
from llm_flock.viz.charts import Curve, Dot, Facet, Sample, bands, boxes, dots, histograms

COLUMNS = 4
MOST_ROWS = 12
"""With more rows, only curves of the first condition are drawn, and the page says so."""


def draw_all(results: Results, reference: str, method: Method = "student") -> Iterator[Drawing]:
    """Every figure for which the results have data; protocols are compared with the reference.

    Figures are copied out of reports, so where any model was simulated, each of them says so.
    """
    for drawing in _draw_all(results, reference, method):
        if results.simulated:
            for legend in drawing.figure.legends:
                legend.set_title("simulated language models", prop=FontProperties(size=7.5, style="italic"))
        yield drawing


def _draw_all(results: Results, reference: str, method: Method) -> Iterator[Drawing]:
    lines = cell_lines(results, method)
    yield success(results, lines)
    yield from errors_over_time(results, method)
    yield from compared(results, reference, method)
    yield from along_axes(results, method)
    if any(trial.ratio is not None for trial in results.trials):
        yield ratios(results)
    if any(trial.figures["min_separation"] is not None for trial in results.trials):
        yield separations(results)
    yield from spending(results, lines, method)


def errors_over_time(results: Results, method: Method) -> Iterator[Drawing]:
    """The error over time: of each model under every protocol, and of each protocol with every model."""
    model, protocol = attrgetter("model"), attrgetter("protocol")
    length = results.longest(results.trials)
    for by, title, series, series_of, row_of in (
        ("model", "Error over time, by model", results.models, model, protocol),
        ("protocol", "With and without consensus", results.protocols, protocol, model),
    ):
        rows = list(dict.fromkeys((row_of(cell), cell.condition) for cell in results.cells))
        shown = rows if len(rows) <= MOST_ROWS else [row for row in rows if row[1] == results.conditions[0]]
        several = len({name for name, _ in rows}) > 1
        grid: list[tuple[str, list[Facet]]] = []
        missing = total = 0
        for name, condition in shown:
            facets: list[Facet] = []
            for team in results.teams:
                cells = {
                    series_of(cell): trials
                    for cell, trials in results.cells.items()
                    if (cell.team, cell.condition, row_of(cell)) == (team, condition, name)
                }
                curves, lost = _curves(results, cells, length, method)
                missing, total = missing + lost, total + sum(map(len, cells.values()))
                facets.append(Facet(title=str(team), marks=curves))
            label = " · ".join(part for part in (name if several else "", condition) if part)
            grid += [(label, facets[k : k + COLUMNS]) for k in range(0, len(facets), COLUMNS)]
        if not any(facet.marks for _, facets in grid for facet in facets):
            continue
        words = [
            "Mean distance to the ideal shape after each round, over all trials of a cell; bands are the "
            f"{INTERVALS[method]} of the mean, cut at 0. A trial that ended early keeps its last error.",
            _consensus_words(results),
        ]
        if len(shown) < len(rows):
            words.append(f"Only {results.conditions[0]}; {len(results.conditions) - 1} other conditions are not drawn.")
        if missing:
            words.append(f"{missing} of {total} trials have no error at any round and no part in this figure.")
        yield Drawing(
            name=f"error-by-{by}",
            section="error",
            title=title,
            caption=" ".join(filter(None, words)),
            figure=bands(grid, list(series), "round", "mean distance to the ideal shape [units]"),
        )


def _curves(results: Results, found: dict[str, list[TrialRow]], length: int, method: Method) -> tuple[list[Curve], int]:
    """A curve for each series, all of one length, and how many trials have none."""
    curves: list[Curve] = []
    lost = 0
    for name, trials in found.items():
        table = results.curves(trials, length)
        lost += len(trials) - len(table)
        if len(table):
            mean, low, high = mean_bands(table, method)
            x = np.arange(length, dtype=np.float64)
            curves.append(Curve(series=name, x=x, mean=mean, low=np.maximum(low, 0.0), high=high))
    return curves, lost


def success(results: Results, lines: Sequence[CellLine]) -> Drawing:
    """The share of trials that formed, by cell."""
    return Drawing(
        name="success",
        section="success",
        title="Share of trials that formed",
        caption="Share of all trials that formed, with Wilson's 95 % interval. Trials that broke off or ran out of "
        "their budget count as not formed.",
        figure=dots(
            _dot_panels(results, [(line.cell, line.formed) for line in lines], 100.0),
            results.protocols,
            "formed [% of all trials]",
            (-3, 103),
        ),
    )


def compared(results: Results, reference: str, method: Method) -> Iterator[Drawing]:
    """Protocols against the reference on the same seeds: success, and the error at the end."""
    lines = pair_lines(results, reference, method)
    others = [name for name in results.protocols if name != reference]
    formed, error = "formed, difference [% points]", "error at the end, difference [units]"
    kinds: tuple[tuple[str, str, str, Callable[[PairLine], Estimate | None], float], ...] = (
        ("success", formed, "Newcombe's 95 % interval", lambda line: line.formed.difference, 100),
        ("error", error, INTERVALS[method], _error_difference, 1),
    )
    for name, x, how, get, factor in kinds:
        found = [(line.cell, get(line)) for line in lines]
        if any(estimate is not None for _, estimate in found):
            yield Drawing(
                name=f"paired-{name}",
                section="paired",
                title=f"{name.capitalize()}, difference from {reference}",
                caption=f"This minus {reference} on the same seeds, with {how}; right of the dashed line is more.",
                figure=dots(
                    _dot_panels(results, found, factor, edge=0.0), others, x, _limits([e for _, e in found], factor)
                ),
            )


def _error_difference(line: PairLine) -> Estimate | None:
    means = line.means[ERROR]
    return None if means is None else means.difference


def _limits(estimates: Sequence[Estimate | None], factor: float) -> tuple[float, float]:
    """A range that contains all intervals and zero, with a margin."""
    ends = [end for e in estimates if e is not None for end in (e.value, e.low, e.high) if end is not None]
    low, high = factor * min(0.0, *ends, 0.0), factor * max(0.0, *ends, 0.0)
    if low == high:
        return (-1.0, 1.0)  # nothing differs
    room = 0.04 * (high - low)
    return (low - room if low < 0 else 0.0, high + room)


def ratios(results: Results) -> Drawing:
    """Rounds over the lower bound of every trial that formed."""
    panels = [
        Facet(
            title=str(team),
            edge=1.0,
            marks=[
                Sample(
                    series=cell.protocol,
                    row=_row(results, cell),
                    values=known(trial.ratio for trial in trials),
                    note=f"{sum(trial.formed for trial in trials)} of {len(trials)}",
                )
                for cell, trials in results.cells.items()
                if cell.team == team
            ],
        )
        for team in results.teams
    ]
    known_ratios = known(trial.ratio for trial in results.trials)
    # A team in formation from the start has ratio 0. The counts at the right need room.
    least, most = min(1.0, *known_ratios) - 0.1, max(1.0, *known_ratios)
    return Drawing(
        name="rounds-over-bound",
        section="rounds",
        title="Rounds over the lower bound",
        caption="Rounds to the formation divided by the fewest in which anybody could have built the agreed plan, of "
        "the trials that formed (how many, at the right); 1 cannot be beaten by much, since the bound is rounded up. "
        "Box: quartiles, sign: median, line: smallest to largest, dots: trials.",
        figure=boxes(panels, results.protocols, "rounds / lower bound", (least, least + (most - least) * 1.22)),
    )


def separations(results: Results) -> Drawing:
    """The smallest distance of two robots in every trial."""
    panels: list[Facet] = []
    for model in results.models:
        for team in results.teams:
            found = [t for t in results.trials if (t.cell.model, t.cell.team) == (model, team)]
            marks = [
                Sample(series=name, values=known(t.figures["min_separation"] for t in found if t.cell.protocol == name))
                for name in results.protocols
            ]
            edge = next(iter(known(t.figures["safe_distance"] for t in found)), None)
            title = str(team) if len(results.models) == 1 else f"{team}\n{model}"
            if any(mark.values for mark in marks):
                panels.append(Facet(title=title, marks=[mark for mark in marks if mark.values], edge=edge))
    pooled = " Trials of all conditions are taken together." if len(results.conditions) > 1 else ""
    return Drawing(
        name="separation",
        section="separation",
        title="Smallest separation",
        caption="Smallest distance of any two robots in a trial, along their paths too. Left of the dashed line, in "
        f"the shaded part, two robots came nearer than the safe distance.{pooled}",
        figure=histograms(panels, results.protocols, "smallest distance of two robots in a trial [units]", "trials"),
    )


def spending(results: Results, lines: Sequence[CellLine], method: Method) -> Iterator[Drawing]:
    """Calls, tokens and money."""
    kinds: tuple[tuple[str, str, str, Callable[[CellLine], Estimate | None]], ...] = (
        ("calls", "Model calls", "model calls a robot and mission", lambda line: line.calls),
        ("tokens", "Tokens", "tokens a robot and mission", lambda line: line.tokens),
        ("cost", "Cost", "cost of a mission [US dollars]", lambda line: line.cost),
    )
    for name, title, x, get in kinds:
        found = [(line.cell, get(line)) for line in lines]
        if all(estimate is None or estimate.value == 0 for _, estimate in found):
            continue
        limits = _limits([estimate for _, estimate in found], 1.0)
        yield Drawing(
            name=name,
            section="spending",
            title=title,
            caption=f"Mean over all trials and its {INTERVALS[method]}; retries of answers that could not be used are "
            "counted." + (" Tokens of simulated models are estimates." if results.simulated else ""),
            figure=dots(_dot_panels(results, found, 1.0), results.protocols, x, (0.0, limits[1])),
        )


def _dot_panels(
    results: Results, found: Sequence[tuple[ResultCell, Estimate | None]], factor: float, edge: float | None = None
) -> list[Facet]:
    def dot(cell: ResultCell, estimate: Estimate | None) -> Dot:
        ends = (None, None, None) if estimate is None else (estimate.value, estimate.low, estimate.high)
        value, low, high = (None if end is None else factor * end for end in ends)
        return Dot(series=cell.protocol, row=_row(results, cell), value=value, low=low, high=high)

    teams = dict.fromkeys(cell.team for cell, _ in found)
    return [
        Facet(title=str(team), marks=[dot(cell, estimate) for cell, estimate in found if cell.team == team], edge=edge)
        for team in teams
    ]


def _row(results: Results, cell: ResultCell) -> str:
    """Name of a row: its condition, and its model where there are several."""
    model = cell.model if len(results.models) > 1 else ""
    return " · ".join(part for part in (model, cell.condition) if part)


def _consensus_words(results: Results) -> str:
    """The rule by which each protocol chooses its plan, in words."""
    rules = {trial.cell.protocol: trial.figures["consensus"] for trial in results.trials if trial.figures["consensus"]}
    words = [
        f"{name}: {'without consensus' if rule == 'none' else f'{rule} consensus'}" for name, rule in rules.items()
    ]
    return "; ".join(words) + "." if words else ""
