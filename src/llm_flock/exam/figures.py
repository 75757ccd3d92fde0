"""The figures of an exam: shares with intervals by section, by size and by distance, and what it took."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median

import numpy as np

from llm_flock.exam.ask import Outcome
from llm_flock.exam.questions import SECTIONS
from llm_flock.experiments.statistics import CONFIDENCE, RESAMPLES, Estimate, mean_interval, wilson

SIZES: tuple[tuple[str, int], ...] = (("3 to 5", 5), ("6 to 10", 10), ("11 to 20", 20), ("21 to 30", 30))
"""Bands of the number of places, each with its largest."""

DISTANCES: tuple[tuple[str, float], ...] = (
    ("up to 0.5", 0.5),
    ("0.5 to 1", 1.0),
    ("1 to 3", 3.0),
    ("more than 3", float("inf")),
)
"""Bands of the distance of the goal [step limits]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """Results of a set of questions; shares are of questions, repeats of one averaged.

    Attributes:
        questions: number of questions.
        first: share right at first ask.
        one: share right after one reason at most.
        two: share right after two reasons at most.
        readable: share of first answers that could be read.
        flyable: share of first answers that a robot would fly, clipped if need be.
        separation: share of first answers that keep the safe distance, of those where it applies.
        error: median error of first answers, as in `score.Marks`.
        degrees: median angle of first answers to the way to the goal [degrees].
        unsteady: share of questions that were right at first ask in some repeats and wrong in others.
        failed: share that got no answer, because the provider failed.
    """

    questions: int
    first: Estimate
    one: Estimate
    two: Estimate
    readable: float
    flyable: float
    separation: float | None
    error: float | None
    degrees: float | None
    unsteady: float
    failed: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Use:
    """What an exam took: the model's calls, tokens, seconds for each question (median), money (None: not known)."""

    calls: int
    tokens_input: int
    tokens_output: int
    seconds: float
    cost_usd: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExamFigures:
    """All figures of one exam.

    Attributes:
        total: mean of the sections' shares right at first ask, each section counting the same.
        total_two: the same after two reasons at most.
        sections: by section, those that were asked.
        tags: by section and tag.
        sizes: by section of plans and band of places.
        distances: by section of steps and band of distance.
    """

    total: Estimate
    total_two: Estimate
    sections: Mapping[str, Figures]
    tags: Mapping[str, Mapping[str, Figures]]
    sizes: Mapping[str, Mapping[str, Figures]]
    distances: Mapping[str, Mapping[str, Figures]]
    use: Use


def exam_figures(outcomes: Sequence[Outcome]) -> ExamFigures:
    """The figures of at least one result."""
    # Whichever was answered first: the draws of an interval would differ.
    outcomes = sorted(outcomes, key=lambda o: (o.question, o.repeat))
    sections = {s: [o for o in outcomes if o.section == s] for s in SECTIONS}
    sections = {name: found for name, found in sections.items() if found}
    return ExamFigures(
        total=_total(sections.values(), 0),
        total_two=_total(sections.values(), 2),
        sections={name: figures(found) for name, found in sections.items()},
        tags={name: _by(found, lambda o: o.tags) for name, found in sections.items()},
        sizes=_banded(sections, lambda o: _band(SIZES, o.n) if o.distance is None and o.section != "mission" else None),
        distances=_banded(sections, lambda o: None if o.distance is None else _band(DISTANCES, o.distance)),
        use=_use(outcomes),
    )


def figures(outcomes: Sequence[Outcome]) -> Figures:
    """The figures of some questions, at least one."""
    by_question = _questions(outcomes)
    separation = [o.separation for o in outcomes if o.separation is not None]
    errors = [o.error for o in outcomes if o.error is not None]
    degrees = [o.degrees for o in outcomes if o.degrees is not None]
    return Figures(
        questions=len(by_question),
        first=_share(by_question, 0),
        one=_share(by_question, 1),
        two=_share(by_question, 2),
        readable=fmean(o.readable for o in outcomes),
        flyable=fmean(o.flyable for o in outcomes),
        separation=fmean(separation) if separation else None,
        error=median(errors) if errors else None,
        degrees=median(degrees) if degrees else None,
        unsteady=fmean(len({o.tries == 0 for o in found}) > 1 for found in by_question),
        failed=fmean(o.cause is not None for o in outcomes),
    )


def _questions(outcomes: Iterable[Outcome]) -> list[list[Outcome]]:
    """The results of each question."""
    found: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        found.setdefault(outcome.question, []).append(outcome)
    return list(found.values())


def _rates(questions: Sequence[Sequence[Outcome]], reasons: int) -> list[float]:
    """Share of each question's repeats that were right after this number of reasons or fewer."""
    return [fmean(o.tries is not None and o.tries <= reasons for o in found) for found in questions]


def _share(questions: Sequence[Sequence[Outcome]], reasons: int) -> Estimate:
    """The mean over questions with its bootstrap interval; with Wilson's where all are equal, as that has a width."""
    rates = _rates(questions, reasons)
    if set(rates) <= {0.0} or set(rates) <= {1.0}:
        return wilson(int(sum(rates)), len(rates))
    found = mean_interval(rates, method="bootstrap")
    assert found is not None, "there is a question"
    return found


def _total(sections: Iterable[Sequence[Outcome]], reasons: int) -> Estimate:
    """The mean over sections, with an interval by drawing questions again within each section."""
    rng = np.random.default_rng(0)
    draws = np.zeros(RESAMPLES)
    values: list[float] = []
    for outcomes in sections:
        rates = np.array(_rates(_questions(outcomes), reasons))
        values.append(float(rates.mean()))
        shares = rng.multinomial(len(rates), np.full(len(rates), 1 / len(rates)), size=RESAMPLES) / len(rates)
        draws = draws + shares @ rates
    ends = np.quantile(draws / len(values), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(value=fmean(values), low=float(ends[0]), high=float(ends[1]))


def _by(outcomes: Sequence[Outcome], keys: Callable[[Outcome], Iterable[str]]) -> dict[str, Figures]:
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        for key in keys(outcome):
            groups.setdefault(key, []).append(outcome)
    return {key: figures(found) for key, found in groups.items()}


def _in_order(found: Mapping[str, Figures], bands: Sequence[tuple[str, float]]) -> dict[str, Figures]:
    return {name: found[name] for name, _ in bands if name in found}


def _banded(
    sections: Mapping[str, Sequence[Outcome]], band: Callable[[Outcome], str | None]
) -> dict[str, dict[str, Figures]]:
    def keys(outcome: Outcome) -> Iterable[str]:
        found = band(outcome)
        return () if found is None else (found,)

    order = (*SIZES, *DISTANCES)
    banded = {name: _in_order(_by(outcomes, keys), order) for name, outcomes in sections.items()}
    return {name: found for name, found in banded.items() if found}


def _band(bands: Sequence[tuple[str, float]], value: float) -> str:
    return next(name for name, most in bands if value <= most)


def _use(outcomes: Sequence[Outcome]) -> Use:
    costs = [o.cost_usd for o in outcomes]
    return Use(
        calls=sum(o.calls for o in outcomes),
        tokens_input=sum(o.tokens_input for o in outcomes),
        tokens_output=sum(o.tokens_output for o in outcomes),
        seconds=round(median(o.seconds for o in outcomes), 3),
        cost_usd=None if None in costs else sum(cost for cost in costs if cost is not None),
    )
