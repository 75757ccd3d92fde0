"""The tables of the report as text; the page and the Markdown show the same rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from llm_flock.record import ENDINGS
from llm_flock_lab._experiments.paired import PairedMeans, PairedShares
from llm_flock_lab._experiments.statistics import (
    NOT_KNOWN,
    duration,
    holm,
    horizon,
    interval,
    number,
    restricted_mean,
)
from llm_flock_lab._report.findings import BIT_RATE, COMPARED, INTERVAL, SPEED_M_S, UNIT_M, CellLine, PairLine, known
from llm_flock_lab._report.results import ResultCell, Results

T = TypeVar("T")
P = TypeVar("P", PairedMeans, PairedShares)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """One table; its first `words` columns hold words, the others numbers, and `note` says how to read it."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int
    note: str


def success_sheet(results: Results, lines: Sequence[CellLine]) -> Sheet:
    ends = [name for name in ENDINGS if name != "formed" and any(line.outcomes[name] for line in lines)]
    columns: dict[str, Callable[[CellLine], str]] = {
        "trials": lambda line: str(line.trials),
        "formed % [95 %]": lambda line: interval(line.formed, 1, 100.0),
        "by the models alone % [95 %]": lambda line: interval(line.by_models, 1, 100.0),
        "at half the tolerance %": lambda line: interval(line.half and line.half.alone, 1, 100.0),
        "at twice": lambda line: interval(line.twice and line.twice.alone, 1, 100.0),
        **{name: lambda line, end=name: str(line.outcomes[end]) for name in ends},
        "too near": lambda line: str(line.too_near),
        "smallest separation [units]": lambda line: number(line.min_separation, 3),
    }
    note = (
        "Formed: share of all trials, with Wilson's interval; trials that broke off or ran out of their budget "
        "are counted as not formed. By the models alone: geometry stood in for no plan, waypoint or answer. "
        "At half and twice the tolerance: the share if robots had to be within 2.5 or 10 % of the spacing of their "
        "goals, and the team within 5 or 20 % of its shape, in runs that end when the usual 5 and 10 % are met. "
        "Too near: trials in which two robots were nearer than the safe distance. "
    ) + " ".join(f"{name.capitalize()}: {ENDINGS[name]}." for name in ends)
    return _sheet(results, "How the trials ended", columns, {line.cell: line for line in lines}, note)


def flight_sheet(results: Results, lines: Sequence[CellLine]) -> Sheet:
    columns: dict[str, Callable[[CellLine], str]] = {
        "formed": lambda line: str(line.outcomes["formed"]),
        "rounds [95 %]": lambda line: interval(line.rounds, 1),
        "flight [s]": lambda line: interval(line.flight_s and line.flight_s.alone, 1),
        "over the bound [95 %]": lambda line: interval(line.ratio, 2),
        "distance over the least [95 %]": lambda line: interval(line.detour, 2),
        "error [95 %]": lambda line: interval(line.error, 2),
        "of": lambda line: str(line.errors_known),
    }
    note = (
        "Rounds, and rounds over the lower bound: restricted means (areas under Kaplan-Meier curves), in which a trial "
        "that formed later or never counts as the shortest deadline that a trial of its team missed, or the longest "
        f"time if none did: {_ends(results)}. Flight: the same at {SPEED_M_S:g} m/s, {UNIT_M:g} m a unit, without the "
        "models' time. Distance: flown by all robots, over the smallest sum of ways to the places, if they formed. "
        f"Error: mean distance to the ideal shape at the end [units], {INTERVAL}, of those that have one, formed or "
        "not."
    )
    return _sheet(results, "Rounds and error", columns, {line.cell: line for line in lines}, note)


def spending_sheet(results: Results, lines: Sequence[CellLine]) -> Sheet:
    columns: dict[str, Callable[[CellLine], str]] = {
        "calls a robot": lambda line: interval(line.calls, 2),
        "tokens a robot": lambda line: interval(line.tokens, 0),
        "answers not used %": lambda line: number(None if line.rejected is None else 100 * line.rejected, 2),
        "latency [s]": lambda line: interval(line.latency, 3),
        "airtime of a mission [s]": lambda line: interval(line.airtime_s, 3),
        "cost of a mission [US $]": lambda line: (
            interval(line.cost, 4) if line.cost is None or line.cost.value else "0"
        ),
    }
    note = (
        f"Means over trials, {INTERVAL}. Airtime: payloads of all messages at {BIT_RATE / 1e6:g} Mbit/s. A cost is "
        "given where the price of every call is known"
    )
    note += "; simulated models cost nothing, and their tokens are estimates." if results.simulated else "."
    return _sheet(results, "Calls, tokens and money", columns, {line.cell: line for line in lines}, note)


def pair_sheets(results: Results, lines: Sequence[PairLine], reference: str) -> list[Sheet]:
    """Protocols against the reference on the same seeds: success, then every other figure that any pair has."""
    success: dict[str, Callable[[tuple[PairedShares, float]], str]] = {
        "pairs": lambda found: str(found[0].pairs),
        "difference in % points [95 %]": lambda found: interval(found[0].difference, 1, 100.0, signed=True),
        "formed: only this": lambda found: str(found[0].only_first),
        f"only {reference}": lambda found: str(found[0].only_second),
        "p (McNemar, Holm)": lambda found: p_text(found[1]),
    }
    others: dict[str, Callable[[tuple[PairedMeans, float]], str]] = {
        "pairs": lambda found: str(found[0].pairs),
        "mean difference [95 %]": lambda found: interval(found[0].difference, 2, signed=True),
        "effect size g [95 %]": lambda found: interval(found[0].effect, 2, signed=True),
        "p (Wilcoxon, Holm)": lambda found: p_text(found[1]),
    }
    note = (
        f"Each trial is compared with the trial of {reference} of the same team, model, condition and seed, which has "
        f"the same starts if both draw them alike; differences are this minus {reference}. The interval is Newcombe's "
        f"for paired shares, and p that of McNemar's exact test. {_FAMILY}"
    )
    title = f"Success compared with {reference}, seed by seed"
    found = [_sheet(results, title, success, _with_holm({line.cell: line.formed for line in lines}), note)]
    note = (
        f"Pairs: seeds on which both have the figure. Mean difference: {INTERVAL}. g: the "
        "mean difference in standard deviations of the differences, with Hedges' correction for few pairs. "
        f"p: Wilcoxon's signed-rank test. {_FAMILY} Rounds are restricted as in the table above."
    )
    for name in COMPARED:
        if rows := {line.cell: mean for line in lines if (mean := line.means[name]) is not None}:
            title = f"{name[0].upper()}{name[1:]}, compared with {reference}, seed by seed"
            found.append(_sheet(results, title, others, _with_holm(rows), note))
    return found


_FAMILY = "By Holm's correction all p in this table may be read at one level."


def _with_holm(found: Mapping[ResultCell, P]) -> dict[ResultCell, tuple[P, float]]:
    """Comparisons with the p-values that they have as one family."""
    adjusted = holm([one.p_value for one in found.values()])
    return {cell: (one, p) for (cell, one), p in zip(found.items(), adjusted, strict=True)}


def p_text(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def _ends(results: Results) -> str:
    return ", ".join(f"{number(until, 0)} ({team})" for team, (until, _) in results.horizons.items())


def _sheet(
    results: Results, title: str, columns: Mapping[str, Callable[[T], str]], rows: Mapping[ResultCell, T], note: str
) -> Sheet:
    """A table with a row for each cell: the words that tell it from others, then its figures."""
    labels: dict[str, Callable[[ResultCell], str]] = {
        "shape": lambda cell: cell.team.shape,
        "N": lambda cell: str(cell.team.n_robots),
        **({"model": lambda cell: cell.model} if results.needs("model") else {}),
        **({"condition": lambda cell: cell.condition} if results.conditions != ("",) else {}),
        **({"protocol": lambda cell: cell.protocol} if results.needs("protocol") else {}),
    }

    def row(cell: ResultCell, found: T) -> tuple[str, ...]:
        return (*(name(cell) for name in labels.values()), *(text(found) for text in columns.values()))

    texts = tuple(row(cell, found) for cell, found in rows.items())
    return Sheet(title=title, header=(*labels, *columns), rows=texts, words=len(labels), note=note)


def facts(results: Results, lines: Sequence[CellLine]) -> list[tuple[str, str]]:
    """The most important numbers, each with its name. No figure of success is pooled over protocols."""
    free = all(trial.figures["simulated"] for trial in results.trials)
    costs = [trial.figures["cost_usd"] for trial in results.trials if trial.figures["model_calls"] is not None]
    return [
        (f"{len(results.trials):,}", "trials"),
        *_success(results, lines),
        (_compact(sum(known(trial.figures["model_calls"] for trial in results.trials))), "model calls"),
        (_compact(sum(known(trial.figures["tokens"] for trial in results.trials))), "tokens"),
        *(() if free else ((NOT_KNOWN if None in costs else f"{sum(known(costs)):,.2f} $", "cost"),)),
    ]


def _success(results: Results, lines: Sequence[CellLine]) -> list[tuple[str, str]]:
    if len(results.protocols) > 1:
        trials = {name: [t for t in results.trials if t.cell.protocol == name] for name in results.protocols}
        formed = {name: sum(trial.outcome == "formed" for trial in flown) for name, flown in trials.items()}
        return [(f"{formed[name]:,} of {len(trials[name]):,}", f"formed with {name}") for name in trials]
    formed, every = results.outcomes()["formed"], [trial.figures for trial in results.trials]
    mean = restricted_mean([duration(row, over_bound=True) for row in every], horizon(every, over_bound=True))
    return [
        (f"{formed:,}", f"formed ({100 * formed / len(results.trials):.1f} %)"),
        (f"{sum(line.too_near for line in lines):,}", "with robots too near"),
        (interval(mean and mean.alone, 2), "rounds over the bound"),
    ]


def _compact(value: float) -> str:
    """A count in a few letters: 12,345, 1.23 M."""
    for unit, size in (("G", 1e9), ("M", 1e6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value:,.0f}"
