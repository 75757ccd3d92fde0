"""The figures of a report: their names, contents and captions."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TypeAlias

import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from numpy.typing import NDArray

from llm_flock_lab._experiments.statistics import Estimate, mean_bands, mean_interval, wilson
from llm_flock_lab._report.findings import ERROR, INTERVAL, CellLine, PairLine, cell_lines, known, pair_lines
from llm_flock_lab._report.results import ResultCell, Results, Team, TrialRow, as_number
from llm_flock_view._figures.charts import Curve, Dot, Facet, Sample, along, bands, boxes, dots, histograms

COLUMNS = 4
EACH = "each condition"
MOST_WORDS = 20  # values of an axis that fit under a figure; the dots of all cells show more
_FORMED = "formed [% of all trials]"

Found: TypeAlias = Sequence[tuple[ResultCell, Estimate | None]]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportDrawing:
    """One figure of the report; `name` is that of its files, `section` its place on the page, `plate`: white there."""

    name: str
    section: str
    title: str
    caption: str
    figure: Figure = field(repr=False)
    plate: bool = False


def draw_all(results: Results, reference: str) -> Iterator[ReportDrawing]:
    """Every figure for which there are data; each says if models were simulated, for it may be copied elsewhere."""
    for drawing in _draw_all(results, reference):
        label_simulated(results, drawing.figure)
        yield drawing


def label_simulated(results: Results, figure: Figure) -> None:
    """Write above the legend that models were simulated, if any was."""
    for legend in figure.legends if results.simulated else ():
        legend.set_title("simulated language models", prop=FontProperties(size=7.5, style="italic"))


def _draw_all(results: Results, reference: str) -> Iterator[ReportDrawing]:
    lines = cell_lines(results)
    yield success(results, lines)
    yield from errors_over_time(results)
    yield from draw_comparisons(results, reference)
    yield from along_axes(results)
    if any(trial.ratio is not None for trial in results.trials):
        yield ratios(results)
    if any(trial.figures["min_separation"] is not None for trial in results.trials):
        yield separations(results)
    yield from spending(results, lines)


def errors_over_time(results: Results) -> Iterator[ReportDrawing]:
    """The error of each model under every protocol, and the other way round where these are not the same curves."""
    model, protocol = attrgetter("model"), attrgetter("protocol")
    length = results.longest
    for by, title, series, series_of, row_of in (
        ("model", "Error over time, by model", results.models, model, protocol),
        ("protocol", "Error over time, by protocol", results.protocols, protocol, model),
    ):
        if len(series) == 1 and (by == "protocol" or len(results.protocols) > 1):
            continue
        rows = list(dict.fromkeys((row_of(cell), cell.condition) for cell in results.cells))
        shown = rows if len(rows) <= 12 else [row for row in rows if row[1] == results.conditions[0]]
        several = len({name for name, _ in rows}) > 1
        grid: list[tuple[str, list[Facet]]] = []
        for name, condition in shown:
            facets: list[Facet] = []
            for team in results.teams:
                tables = {
                    series_of(cell): results.curves(trials, length)
                    for cell, trials in results.cells.items()
                    if (cell.team, cell.condition, row_of(cell)) == (team, condition, name)
                }
                curves = [_curve(one, table) for one, table in tables.items() if len(table)]
                facets.append(Facet(title=str(team), marks=curves))
            label = " · ".join(part for part in (name if several else "", condition) if part)
            grid += [(label, facets[k : k + COLUMNS]) for k in range(0, len(facets), COLUMNS)]
        if not any(facet.marks for _, facets in grid for facet in facets):
            continue
        words = [
            "Mean distance to the ideal shape after each round, over all trials of a cell; bands are the "
            f"{INTERVAL} of the mean, cut at 0. A trial that ended early keeps its last error.",
            _consensus_words(results),
        ]
        if len(shown) < len(rows):
            words.append(f"Only {results.conditions[0]}; {len(results.conditions) - 1} other conditions are not drawn.")
        drawn = [trial for trial in results.trials if (row_of(trial.cell), trial.cell.condition) in shown]
        missing = len(drawn) - len(results.curves(drawn, length))
        if missing:
            words.append(f"{missing} of {len(drawn)} trials have no error at any round and no part in this figure.")
        yield ReportDrawing(
            name=f"error-by-{by}",
            section="error",
            title=title if len(series) > 1 else "Error over time",
            caption=" ".join(filter(None, words)),
            figure=bands(grid, list(series), "round", "mean distance to the ideal shape [units]"),
        )


def draw_bands(results: Results, teams: Sequence[Team], protocols: Sequence[str], y: str, figure: str) -> Figure:
    """A figure of every round with its band: a row for each protocol, a panel for each team, a curve for each model."""

    def facet(*shown: object) -> Facet:
        cells = [(cell.model, trials) for cell, trials in results.cells.items() if (cell.team, cell.protocol) == shown]
        tables = [(model, results.curves(trials, results.longest, figure)) for model, trials in cells]
        return Facet(title=str(shown[0]), marks=[_curve(model, table) for model, table in tables if len(table)])

    rows = [(name, [facet(team, name) for team in teams]) for name in protocols]
    drawn = bands(rows, results.models, "round", y, "symlog")
    label_simulated(results, drawn)
    return drawn


def _curve(series: str, table: NDArray[np.float64]) -> Curve:
    mean, low, high = mean_bands(table, least=0.0)
    x = np.arange(len(mean), dtype=np.float64)
    return Curve(series=series, x=x, mean=mean, low=low, high=high)


def success(results: Results, lines: Sequence[CellLine]) -> ReportDrawing:
    return ReportDrawing(
        name="success",
        section="success",
        title="Share of trials that formed",
        caption="Share of all trials that formed, with Wilson's 95 % interval. Trials that broke off or ran out of "
        "their budget count as not formed.",
        figure=_dots(results, [(line.cell, _percent(line.formed)) for line in lines], _FORMED, (-3, 103)),
    )


def draw_comparisons(results: Results, reference: str) -> Iterator[ReportDrawing]:
    """Protocols against the reference on the same seeds: success, and the error at the end."""
    lines = pair_lines(results, reference)
    formed, error = "formed, difference [% points]", "error at the end, difference [units]"
    kinds: tuple[tuple[str, str, str, Callable[[PairLine], Estimate | None]], ...] = (
        ("success", formed, "Newcombe's 95 % interval", lambda line: _percent(line.formed.difference)),
        ("error", error, INTERVAL, _error_difference),
    )
    for name, x, how, get in kinds:
        found = [(line.cell, get(line)) for line in lines]
        if any(estimate is not None for _, estimate in found):
            yield ReportDrawing(
                name=f"paired-{name}",
                section="paired",
                title=f"{name.capitalize()}, difference from {reference}",
                caption=f"This minus {reference} on the same seeds, with {how}; right of the dashed line is more.",
                figure=_dots(results, found, x, _limits(found), edge=0.0),
            )


def _error_difference(line: PairLine) -> Estimate | None:
    means = line.means[ERROR]
    return None if means is None else means.difference


def _percent(share: Estimate) -> Estimate:
    return share.times(100)


def _limits(found: Found) -> tuple[float, float]:
    """A range that contains all intervals and zero, with a margin."""
    ends = [end for _, e in found if e is not None for end in (e.value, e.low, e.high) if end is not None]
    low, high = min(0.0, *ends, 0.0), max(0.0, *ends, 0.0)
    if low == high:
        return (-1.0, 1.0)  # nothing differs
    room = 0.04 * (high - low)
    return (low - room if low < 0 else 0.0, high + room)


def ratios(results: Results) -> ReportDrawing:
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
    return ReportDrawing(
        name="rounds-over-bound",
        section="rounds",
        title="Rounds over the lower bound",
        caption="Rounds to the formation divided by the fewest in which anybody could have built the agreed plan, of "
        "the trials that formed (how many, at the right); 1 cannot be beaten by much, since the bound is rounded up. "
        "Box: quartiles, sign: median, line: smallest to largest, dots: trials.",
        figure=boxes(
            panels,
            results.protocols,
            "rounds / lower bound",
            _rows_are(results),
            (least, least + (most - least) * 1.22),
        ),
    )


def separations(results: Results) -> ReportDrawing:
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
    return ReportDrawing(
        name="separation",
        section="separation",
        title="Smallest separation",
        caption="Smallest distance of any two robots in a trial, along their paths too. Left of the dashed line, in "
        f"the shaded part, two robots came nearer than the safe distance.{pooled}",
        figure=histograms(panels, results.protocols, "smallest distance of two robots in a trial [units]", "trials"),
    )


def spending(results: Results, lines: Sequence[CellLine]) -> Iterator[ReportDrawing]:
    kinds: tuple[tuple[str, str, str, Callable[[CellLine], Estimate | None]], ...] = (
        ("calls", "Model calls", "model calls a robot and mission", lambda line: line.calls),
        ("tokens", "Tokens", "tokens a robot and mission", lambda line: line.tokens),
        ("cost", "Cost", "cost of a mission [US dollars]", lambda line: line.cost),
    )
    for name, title, x, get in kinds:
        found = [(line.cell, get(line)) for line in lines]
        if all(estimate is None or estimate.value == 0 for _, estimate in found):
            continue
        estimated = " Tokens of simulated models are estimates." if name == "tokens" and results.simulated else ""
        yield ReportDrawing(
            name=name,
            section="spending",
            title=title,
            caption=f"Mean over all trials and its {INTERVAL}; retries of answers that could not be used are "
            f"counted.{estimated}",
            figure=_dots(results, found, x, (0.0, _limits(found)[1])),
        )


def _dots(results: Results, found: Found, x: str, limits: tuple[float, float], *, edge: float | None = None) -> Figure:
    """Estimates of cells; a line marks `edge`, such as no difference."""

    def dot(cell: ResultCell, estimate: Estimate | None) -> Dot:
        value, low, high = (None,) * 3 if estimate is None else (estimate.value, estimate.low, estimate.high)
        return Dot(series=_protocol(results, cell), row=_row(results, cell), value=value, low=low, high=high)

    teams = dict.fromkeys(cell.team for cell, _ in found)
    panels = [
        Facet(title=str(team), marks=[dot(cell, estimate) for cell, estimate in found if cell.team == team], edge=edge)
        for team in teams
    ]
    names = {_protocol(results, cell) for cell, _ in found}
    series = [name for name in (*results.protocols, EACH) if name in names]
    return dots(panels, series, x, _rows_are(results), limits)


def _row(results: Results, cell: ResultCell) -> str:
    """Name of a row: its condition, and its model where there are several."""
    model = cell.model if results.needs("model") else ""
    return " · ".join(part for part in (model, cell.condition) if part)


def _rows_are(results: Results) -> str:
    """The kind of the rows' names; with neither models nor conditions to tell apart, a row has its protocol's name."""
    parts = ("model" if results.needs("model") else "", "condition" if results.conditions != ("",) else "")
    return " · ".join(filter(None, parts)) or "protocol"


def _consensus_words(results: Results) -> str:
    """The rule by which each protocol chooses its plan, as text."""
    rules = {trial.cell.protocol: trial.figures["consensus"] for trial in results.trials if trial.figures["consensus"]}
    words = (f"{name}: {'without' if rule == 'none' else rule} consensus" for name, rule in rules.items())
    return "; ".join(words) + "." if rules else ""


def along_axes(results: Results) -> Iterator[ReportDrawing]:
    """Success and error along every further axis of the grid, and along the size of the team."""
    for axis, values in results.axes.items():
        numbers = [as_number(value) for value in values]
        where = {value: float(k) if x is None else x for k, (value, x) in enumerate(zip(values, numbers, strict=True))}
        words = None if None not in numbers else list(values)
        if words is not None and len(words) > MOST_WORDS:
            continue
        panels = {str(team): [t for t in results.trials if t.cell.team == team] for team in results.teams}
        yield from _along(results, axis, panels, lambda t, a=axis, w=where: w.get(t.figures[f"axis_{a}"] or ""), words)
    sizes = Counter(team.shape for team in results.teams)
    scaled = [shape for shape, count in sizes.items() if count > 2]
    if scaled:
        panels = {shape: [t for t in results.trials if t.cell.team.shape == shape] for shape in scaled}
        yield from _along(results, "number of robots", panels, lambda t: float(t.cell.team.n_robots), None)


def _along(
    results: Results,
    axis: str,
    panels: dict[str, list[TrialRow]],
    place: Callable[[TrialRow], float | None],
    words: list[str] | None,
) -> Iterator[ReportDrawing]:
    def mean(figure: Callable[[TrialRow], float | None]) -> Callable[[list[TrialRow]], Estimate | None]:
        return lambda found: mean_interval(known(map(figure, found)), least=0.0)

    kinds: tuple[tuple[str, str, Callable[[list[TrialRow]], Estimate | None]], ...] = (
        ("formed", _FORMED, lambda ts: _percent(wilson(sum(t.formed for t in ts), len(ts)))),
        ("error", "error at the end [units]", mean(lambda t: t.error)),
        ("calls", "model calls a robot", mean(lambda t: t.per_robot("model_calls"))),
    )
    series = list(dict.fromkeys(_series(results, cell) for cell in results.cells))
    for name, y, estimate in kinds:
        facets: list[Facet] = []
        for title, found in panels.items():
            lines = [
                _line(one, [t for t in found if _series(results, t.cell) == one], place, estimate) for one in series
            ]
            facets.append(Facet(title=title, marks=[line for line in lines if len(line.x)]))
        if not any(facet.marks for facet in facets):
            continue
        how = "Wilson's 95 % interval" if name == "formed" else INTERVAL
        others = "Trials that differ in other axes are taken together. " if len(results.axes) > 1 else ""
        slug = "".join(letter if letter.isalnum() else "-" for letter in axis)
        yield ReportDrawing(
            name=f"{name}-along-{slug}",
            section="axes",
            title=f"{'Success' if name == 'formed' else y.partition(' [')[0].capitalize()} along {axis}",
            caption=f"{others}Bars: {how}.",
            figure=along(facets, series, axis, y, words),
        )


def _line(
    series: str,
    trials: Sequence[TrialRow],
    place: Callable[[TrialRow], float | None],
    estimate: Callable[[list[TrialRow]], Estimate | None],
) -> Curve:
    found: defaultdict[float, list[TrialRow]] = defaultdict(list)
    for trial in trials:
        if (at := place(trial)) is not None:
            found[at].append(trial)
    points = [(at, value) for at in sorted(found) if (value := estimate(found[at])) is not None]
    return Curve(
        series=series,
        x=np.array([at for at, _ in points]),
        mean=np.array([e.value for _, e in points]),
        low=np.array([e.value if e.low is None else e.low for _, e in points]),
        high=np.array([e.value if e.high is None else e.high for _, e in points]),
    )


def _series(results: Results, cell: ResultCell) -> str:
    """Name of a line: its protocol, and its model where there are several."""
    return " · ".join([_protocol(results, cell)] + ([cell.model] if results.needs("model") else []))


def _protocol(results: Results, cell: ResultCell) -> str:
    """The protocol of a cell, where its condition does not tell it."""
    return cell.protocol if results.needs("protocol") or len(results.protocols) == 1 else EACH
