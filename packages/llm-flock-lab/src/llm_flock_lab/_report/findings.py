"""Statistics of the trials: a line for each cell, and protocols compared on the same seeds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from llm_flock_lab._experiments.paired import PairedMeans, PairedShares, paired_means, paired_shares
from llm_flock_lab._experiments.statistics import Estimate, mean_interval, median, wilson
from llm_flock_lab._report.results import ResultCell, Results, TrialRow

INTERVAL = "95 % Student-t interval"
"""Name of the interval of a mean."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellLine:
    """The figures of one cell; means are over trials, with Student's interval."""

    cell: ResultCell
    trials: int
    formed: Estimate
    by_models: Estimate | None  # of the trials of which it is known
    outcomes: Mapping[str, int]
    rounds: float | None  # median over trials that formed; `ratio` to the lower bound likewise
    ratio: float | None
    error: Estimate | None  # at the end [units], over `errors_known` trials
    errors_known: int
    min_separation: float | None
    too_near: int
    calls: Estimate | None  # a robot and mission; `tokens` likewise
    tokens: Estimate | None
    cost: Estimate | None  # of a mission [US dollars]; None where a price is not known
    latency: Estimate | None  # of a call [s]
    rejected: float | None  # share of calls


@dataclass(frozen=True, slots=True, kw_only=True)
class PairLine:
    """A cell against the reference's on the same seeds: success, and the means in `COMPARED`, None without pairs."""

    cell: ResultCell
    formed: PairedShares
    means: Mapping[str, PairedMeans | None]


ERROR = "error at the end [units]"

COMPARED: Mapping[str, Callable[[TrialRow], float | None]] = {
    ERROR: lambda trial: trial.error,
    "smallest separation [units]": lambda trial: trial.figures["min_separation"],
    "rounds to the formation": lambda trial: trial.figures["rounds_to_formed"] if trial.formed else None,
    "calls a robot": lambda trial: trial.per_robot("model_calls"),
}
"""Figures that are compared pair by pair, besides success."""


def cell_lines(results: Results) -> list[CellLine]:
    return [_cell_line(cell, trials) for cell, trials in results.cells.items()]


def _cell_line(cell: ResultCell, trials: Sequence[TrialRow]) -> CellLine:
    def mean(values: Iterable[float | None]) -> Estimate | None:
        return mean_interval(known(values), least=0.0)

    costs = [trial.figures["cost_usd"] for trial in trials if trial.figures["model_calls"] is not None]
    alone = [bool(by_models) for trial in trials if (by_models := trial.figures.get("formed_by_models")) is not None]
    errors = known(trial.error for trial in trials)
    calls = sum(known(trial.figures["model_calls"] for trial in trials))
    return CellLine(
        cell=cell,
        trials=len(trials),
        formed=wilson(sum(trial.formed for trial in trials), len(trials)),
        by_models=wilson(sum(alone), len(alone)) if alone else None,
        outcomes=Counter(trial.outcome for trial in trials),
        rounds=median(known(trial.figures["rounds_to_formed"] for trial in trials if trial.formed)),
        ratio=median(known(trial.ratio for trial in trials)),
        error=mean(errors),
        errors_known=len(errors),
        min_separation=min(known(trial.figures["min_separation"] for trial in trials), default=None),
        too_near=sum(trial.too_near for trial in trials),
        calls=mean(trial.per_robot("model_calls") for trial in trials),
        tokens=mean(trial.per_robot("tokens") for trial in trials),
        cost=None if None in costs else mean(costs),
        latency=mean(trial.figures["latency_mean_s"] for trial in trials),
        rejected=sum(known(trial.figures["calls_rejected"] for trial in trials)) / calls if calls else None,
    )


def known(values: Iterable[float | None]) -> list[float]:
    return [float(value) for value in values if value is not None]


def pair_lines(results: Results, reference: str) -> list[PairLine]:
    """Every other protocol against the reference: same team, model and condition, seed by seed.

    A trial that broke off did not form, and is a pair like any other in success; in a mean, both need the figure.
    """
    lines: list[PairLine] = []
    for cell, trials in results.cells.items():
        others = {trial.seed: trial for trial in results.cells.get(replace(cell, protocol=reference), ())}
        pairs = [(trial, others[trial.seed]) for trial in trials if trial.seed in others]
        formed = paired_shares([a.formed for a, _ in pairs], [b.formed for _, b in pairs])
        if formed is None or cell.protocol == reference:
            continue
        means = {name: _pair_means(pairs, figure) for name, figure in COMPARED.items()}
        lines.append(PairLine(cell=cell, formed=formed, means=means))
    return lines


def _pair_means(
    pairs: Sequence[tuple[TrialRow, TrialRow]], figure: Callable[[TrialRow], float | None]
) -> PairedMeans | None:
    both = [(a, b) for a, b in ((figure(x), figure(y)) for x, y in pairs) if a is not None and b is not None]
    return paired_means([a for a, _ in both], [b for _, b in both])


def usual_reference(results: Results) -> str:
    """The protocol that the others are compared with: the baseline if it was flown, else the last of the presets."""
    return "baseline" if "baseline" in results.protocols else results.protocols[-1]
