"""Figures along the axes of the grid, such as fault rates or the size of the team."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from llm_flock.experiments.statistics import Estimate, Method, mean_interval, wilson
from llm_flock.report.drawing import INTERVALS, Drawing
from llm_flock.report.findings import known
from llm_flock.report.results import ResultCell, Results, TrialRow, as_number
from llm_flock.viz.charts import Curve, Facet, along


def along_axes(results: Results, method: Method) -> Iterator[Drawing]:
    """Success and error along every further axis of the grid, and along the size of the team."""
    for axis, values in results.axes.items():
        numbers = [as_number(value) for value in values]
        x = [float(k) if number is None else number for k, number in enumerate(numbers)]
        words = None if None not in numbers else list(values)
        panels = {str(team): [t for t in results.trials if t.cell.team == team] for team in results.teams}
        where = dict(zip(values, x, strict=True))
        yield from _along(
            results, axis, panels, lambda t, a=axis, w=where: w.get(t.figures[f"axis_{a}"] or ""), words, method
        )
    sizes = {shape: {team.n_robots for team in results.teams if team.shape == shape} for shape in _shapes(results)}
    scaled = [shape for shape, found in sizes.items() if len(found) > 2]
    if scaled:
        panels = {shape: [t for t in results.trials if t.cell.team.shape == shape] for shape in scaled}
        yield from _along(results, "number of robots", panels, lambda t: float(t.cell.team.n_robots), None, method)


def _along(
    results: Results,
    axis: str,
    panels: dict[str, list[TrialRow]],
    place: Callable[[TrialRow], float | None],
    words: list[str] | None,
    method: Method,
) -> Iterator[Drawing]:
    def mean(figure: Callable[[TrialRow], float | None]) -> Callable[[list[TrialRow]], Estimate | None]:
        return lambda found: mean_interval(known(map(figure, found)), method=method)

    kinds: tuple[tuple[str, str, Callable[[list[TrialRow]], Estimate | None]], ...] = (
        ("formed", "formed [% of all trials]", _formed_percent),
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
        how = "Wilson's 95 % interval" if name == "formed" else INTERVALS[method]
        others = "Trials that differ in other axes are taken together. " if len(results.axes) > 1 else ""
        slug = "".join(letter if letter.isalnum() else "-" for letter in axis)
        yield Drawing(
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
    found: dict[float, list[TrialRow]] = {}
    for trial in trials:
        at = place(trial)
        if at is not None:
            found.setdefault(at, []).append(trial)
    points = [(at, known_estimate) for at in sorted(found) if (known_estimate := estimate(found[at])) is not None]
    return Curve(
        series=series,
        x=np.array([at for at, _ in points]),
        mean=np.array([e.value for _, e in points]),
        low=np.array([e.value if e.low is None else e.low for _, e in points]),
        high=np.array([e.value if e.high is None else e.high for _, e in points]),
    )


def _formed_percent(trials: list[TrialRow]) -> Estimate:
    share = wilson(sum(trial.formed for trial in trials), len(trials))
    low, high = (None if end is None else 100 * end for end in (share.low, share.high))
    return Estimate(value=100 * share.value, low=low, high=high)


def _series(results: Results, cell: ResultCell) -> str:
    """Name of a line: its protocol, and its model where there are several."""
    return " · ".join([cell.protocol] + ([cell.model] if len(results.models) > 1 else []))


def _shapes(results: Results) -> list[str]:
    return list(dict.fromkeys(team.shape for team in results.teams))
