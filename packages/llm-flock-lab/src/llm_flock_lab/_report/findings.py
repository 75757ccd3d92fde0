"""Statistics of the trials: a line for each cell, and protocols compared on the same seeds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from llm_flock_lab._experiments.paired import PairedMeans, PairedShares, paired_means, paired_shares
from llm_flock_lab._experiments.statistics import (
    Estimate,
    duration,
    mean_interval,
    restricted,
    restricted_mean,
    wilson,
)
from llm_flock_lab._report.results import ResultCell, Results, TrialRow

INTERVAL = "95 % Student-t interval"  # name of the interval of a mean


UNIT_M, SPEED_M_S = 0.1, 0.3
"""Metres of a unit, and metres a second at which a longest step is flown, to state rounds in seconds."""

BIT_RATE = 2e6
"""Bits a second at which payloads are in the air, one after the other; headers and acknowledgements are left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellLine:
    """The figures of one cell; means are over trials, with Student's interval."""

    cell: ResultCell
    trials: int
    formed: Estimate
    by_models: Estimate | None  # of the trials of which it is known
    half: Estimate | None  # share that formed by half of the usual tolerances; `twice` likewise
    twice: Estimate | None
    outcomes: Mapping[str, int]
    rounds: Estimate | None  # restricted mean up to the team's horizon; `ratio` to the lower bound likewise
    ratio: Estimate | None
    detour: Estimate | None  # distance flown over the least possible, of the trials that formed
    flight_s: Estimate | None  # `rounds` at SPEED_M_S
    airtime_s: Estimate | None  # of all messages of a mission at BIT_RATE
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

COMPARED: Mapping[str, Callable[[TrialRow, float], float | None]] = {
    ERROR: lambda trial, until: trial.error,
    "smallest separation [units]": lambda trial, until: trial.figures["min_separation"],
    "rounds to the formation": lambda trial, until: restricted(duration(trial.figures), until),
    "calls a robot": lambda trial, until: trial.per_robot("model_calls"),
}
"""Figures that are compared pair by pair, besides success, in teams with a horizon."""


def cell_lines(results: Results) -> list[CellLine]:
    return [_cell_line(results, cell, trials) for cell, trials in results.cells.items()]


def _share(trials: Sequence[TrialRow], column: str) -> Estimate | None:
    """The share of the trials of which a column is known in which it is true."""
    found = [bool(value) for trial in trials if (value := trial.figures.get(column)) is not None]
    return wilson(sum(found), len(found)) if found else None


def _cell_line(results: Results, cell: ResultCell, trials: Sequence[TrialRow]) -> CellLine:
    until, most = results.horizons[cell.team]
    rounds = restricted_mean([duration(trial.figures) for trial in trials], until)
    steps = known(trial.figures["max_step"] for trial in trials)

    def airtime_s(trial: TrialRow) -> float | None:
        sent, flown = trial.figures["bytes_per_robot_round"], trial.figures["rounds"]
        return None if sent is None or flown is None else 8.0 * sent * flown * cell.team.n_robots / BIT_RATE

    def mean(values: Iterable[float | None]) -> Estimate | None:
        return mean_interval(known(values), least=0.0)

    costs = [trial.figures["cost_usd"] for trial in trials if trial.figures["model_calls"] is not None]
    errors = known(trial.error for trial in trials)
    calls = sum(known(trial.figures["model_calls"] for trial in trials))
    return CellLine(
        cell=cell,
        trials=len(trials),
        formed=wilson(sum(trial.formed for trial in trials), len(trials)),
        by_models=_share(trials, "formed_by_models"),
        half=_share(trials, "formed_half_tolerance"),
        twice=_share(trials, "formed_twice_tolerance"),
        outcomes=Counter(trial.outcome for trial in trials),
        rounds=rounds,
        ratio=restricted_mean([duration(trial.figures, over_bound=True) for trial in trials], most),
        detour=mean(trial.detour for trial in trials),
        flight_s=rounds.times(steps[0] * UNIT_M / SPEED_M_S) if rounds and steps else None,
        airtime_s=mean(map(airtime_s, trials)),
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


def caveats(results: Results) -> list[str]:
    """What errors do not tell, a sentence for each protocol in whose trials it happened."""
    found: list[str] = []
    for name in results.protocols:
        trials = [trial for trial in results.trials if trial.cell.protocol == name]
        counts = {
            "two robots came nearer than the safe distance": sum(trial.too_near for trial in trials),
            "steps longer than the limit ended there": sum(bool(t.figures.get("steps_over_limit")) for t in trials),
            "the team ended beside the centre of its mission": sum(trial.beside_centre for trial in trials),
        }
        words = "; ".join(f"in {count:,} {text}" for text, count in counts.items() if count)
        if words:
            found.append(f"{name}: of {len(trials):,} trials, {words}.")
    return found


def known(values: Iterable[float | None]) -> list[float]:
    return [float(value) for value in values if value is not None]


def pair_lines(results: Results, reference: str) -> list[PairLine]:
    """Every other cell against the reference, as `beside` finds it, seed by seed.

    A trial that broke off did not form, and is a pair like any other in success; in a mean, both need the figure.
    """
    lines: list[PairLine] = []
    for cell, trials in results.cells.items():
        found = beside(results, cell, reference)
        others = {trial.seed: trial for trial in results.cells.get(found, ())}
        pairs = [(trial, others[trial.seed]) for trial in trials if trial.seed in others]
        formed = paired_shares([a.formed for a, _ in pairs], [b.formed for _, b in pairs])
        if formed is None or cell == found:
            continue
        until = results.horizons[cell.team][0]
        means = {name: _pair_means(pairs, figure, until) for name, figure in COMPARED.items()}
        lines.append(PairLine(cell=cell, formed=formed, means=means))
    return lines


def _pair_means(
    pairs: Sequence[tuple[TrialRow, TrialRow]], figure: Callable[[TrialRow, float], float | None], until: float
) -> PairedMeans | None:
    found = ((figure(x, until), figure(y, until)) for x, y in pairs)
    both = [(a, b) for a, b in found if a is not None and b is not None]
    return paired_means([a for a, _ in both], [b for _, b in both])


def beside(results: Results, cell: ResultCell, reference: str) -> ResultCell:
    """The cell that another is compared with: of the same team, and with the protocol `reference` or AXIS=VALUE.

    Everything else is the same too, but for an axis whose values set protocol or model themselves.
    """
    axis, _, value = reference.partition("=")
    if reference in results.protocols:
        return replace(cell, protocol=reference)
    wanted = {**results.axes_of(cell), axis: value}
    alike = [one for one in results.cells if one.team == cell.team and results.axes_of(one) == wanted]
    same = [one for one in alike if (one.protocol, one.model) == (cell.protocol, cell.model)]
    return next(iter((*same, *alike)), cell)


def usual_reference(results: Results) -> str:
    """What the others are compared with: the value `default` of an axis, the baseline, or else another preset."""
    if (found := next((name for name in results.references if name.endswith("=default")), None)) is not None:
        return found
    usual = (name for name in ("baseline", "flock", "paper") if name in results.protocols)
    return next(usual, results.protocols[-1])
