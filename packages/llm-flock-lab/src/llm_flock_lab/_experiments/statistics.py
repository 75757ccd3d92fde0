"""Intervals for the results of a number of trials."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from llm_flock.metrics import deadline

CONFIDENCE = 0.95

NOT_KNOWN = "-"
MINUS = "\N{MINUS SIGN}"

RESAMPLES = 4000  # draws of a bootstrap: its ends move by a few hundredths of its width from seed to seed

Duration: TypeAlias = tuple[float, bool]
"""A time and whether the trial formed then. Otherwise it had not formed by then; inf: it cannot form any more."""

Column: TypeAlias = NDArray[np.float64]  # one number for each column of a table, shape (k,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """An estimated value and its confidence interval, in the value's unit; an end is None where it is not known."""

    value: float
    low: float | None
    high: float | None

    @property
    def alone(self) -> Estimate:
        """The value without its interval."""
        return Estimate(value=self.value, low=None, high=None)

    def times(self, factor: float) -> Estimate:
        """The same in another unit."""
        low, high = (None if end is None else factor * end for end in (self.low, self.high))
        return Estimate(value=factor * self.value, low=low, high=high)


def wilson(successes: int, trials: int) -> Estimate:
    """A share of successes with Wilson's score interval.

    It stays within 0 .. 1 and has a width at 0 and at all successes, where the normal interval has none (Wilson:
    Probable inference, the law of succession, and statistical inference, JASA 1927).
    """
    ends = scipy.stats.binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(value=successes / trials, low=float(ends.low), high=float(ends.high))


def mean_interval(values: Sequence[float], *, least: float | None = None) -> Estimate | None:
    """Mean of independent values, with Student's interval for two or more; `least` is as in `mean_bands`."""
    if not values:
        return None
    if len(values) == 1:
        return Estimate(value=float(values[0]), low=None, high=None)
    mean, low, high = mean_bands(np.array(values, dtype=np.float64)[:, None], least=least)
    return Estimate(value=float(mean[0]), low=float(low[0]), high=float(high[0]))


def mean_bands(table: NDArray[np.float64], *, least: float | None = None) -> tuple[Column, Column, Column]:
    """Mean of every column over the rows without NaN, and the ends of Student's interval; NaN where it has none.

    The lower end moves up to `least`, the smallest possible value, which costs no coverage.
    """
    count = (~np.isnan(table)).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):  # columns with too few values get NaN
        mean = np.nansum(table, axis=0) / count
        spread = np.sqrt(np.nansum((table - mean) ** 2, axis=0) / (count - 1))
        factor = np.asarray(scipy.special.stdtrit(count - 1, (1 + CONFIDENCE) / 2), dtype=np.float64)
        half = factor * spread / np.sqrt(count)
    low = mean - half
    return mean, low if least is None else np.maximum(low, least), mean + half


def bootstrap_interval(values: Sequence[float]) -> Estimate:
    """The mean of at least one value with its bias-corrected and accelerated interval (Efron, JASA 1987).

    The draws are the same for every call, so a page does not change from one build to the next.
    """
    mean = float(np.mean(values))
    if len(values) == 1:
        return Estimate(value=mean, low=None, high=None)
    if np.ptp(values) <= 1e-12 * max(1.0, abs(mean)):  # so are all means, and scipy finds no interval
        return Estimate(value=mean, low=mean, high=mean)
    rng = np.random.default_rng(0)
    low, high = scipy.stats.bootstrap(
        (values,), np.mean, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, batch=100, rng=rng
    ).confidence_interval
    return Estimate(value=mean, low=float(low), high=float(high))


def duration(figures: Mapping[str, Any], *, over_bound: bool = False) -> Duration:
    """The rounds of one trial, or with `over_bound` their ratio to its lower bound, of which 0 counts as 1.

    `figures` are those of a summary or a row of the table. A trial that flew all its rounds in vain, or lost its
    budget, is known until then; one that no model answers, or that broke off, never forms.
    """
    bound = max(1, figures["lower_bound_rounds"] or 0) if over_bound else 1
    if figures["formed"] and figures["rounds_to_formed"] is not None:
        return figures["rounds_to_formed"] / bound, True
    rounds = figures["rounds"] if figures["stopped"] in ("rounds", "formed", "budget", "interrupted") else None
    lacks_bound = over_bound and figures["lower_bound_rounds"] is None
    return (math.inf if rounds is None or lacks_bound else rounds / bound), False


def horizon(trials: Iterable[Mapping[str, Any]], *, over_bound: bool = False) -> float:
    """The time up to which trials are compared: the shortest deadline that one missed, else the longest success; or 0.

    Both are as in `duration`. Up to there it is known of every trial that had its time whether it formed. Where those
    that missed theirs have none, the usual one for the smallest lower bound counts.
    """
    rows = [t for t in trials if t["stopped"] not in ("budget", "interrupted")]
    found = [duration(row, over_bound=over_bound) for row in rows]
    bound = min((max(1, b) for row in rows if (b := row["lower_bound_rounds"]) is not None), default=None)
    missed = [time for time, formed in found if not formed and time < math.inf]
    if bound is not None and not missed and (math.inf, False) in found:
        missed = [deadline(bound) / bound if over_bound else float(deadline(bound))]
    return min(missed, default=max((time for time, formed in found if formed), default=0.0))


def restricted(time: Duration, until: float) -> float | None:
    """A duration where a longer one counts as `until`; None if it is not known so far."""
    return min(time[0], until) if time[1] or time[0] >= until else None


def restricted_mean(durations: Sequence[Duration], until: float) -> Estimate | None:
    """Restricted mean time to formation: its mean where a longer one counts as `until`; None without trials.

    It is the area under the Kaplan-Meier curve S up to there, so trials that did not form count, and those that were
    stopped early count as far as they went (Kaplan, Meier: JASA 1958; Royston, Parmar: BMC Medical Research Methodology
    2013). With d_i of n_i trials formed at t_i, its variance is the sum of A_i^2 d_i / (n_i (n_i - d_i)), where A_i is
    the area from t_i on (Klein, Moeschberger: Survival analysis, 2003, 4.5.2); the interval is the normal one.
    """
    if not durations or until <= 0.0:
        return None
    ends = np.array([min(time, until) for time, _ in durations])
    events = np.array([formed and time <= until for time, formed in durations])
    times, where = np.unique(ends[events], return_inverse=True)
    formed = np.bincount(where, minlength=len(times))
    at_risk: Column = (ends[:, None] >= times).sum(axis=0)
    alive = np.ones(len(times) + 1)
    alive[1:] = np.cumprod(1.0 - formed / at_risk)
    areas = alive * np.diff([0.0, *times, until])
    later = np.cumsum(areas[::-1])[::-1][1:]
    left = at_risk - formed
    variance = float((later[left > 0] ** 2 * (formed / at_risk)[left > 0] / left[left > 0]).sum())
    mean, half = float(areas.sum()), float(scipy.special.ndtri((1 + CONFIDENCE) / 2)) * math.sqrt(variance)
    return Estimate(value=mean, low=max(0.0, mean - half), high=min(until, mean + half))


def holm(p_values: Sequence[float]) -> list[float]:
    """The p-values of a family of tests, adjusted so that all may be read at one level (Holm: Scand. J. Stat. 1979)."""
    order = np.argsort(p_values)
    scaled = np.array(p_values)[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty(len(p_values))
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return adjusted.tolist()


def number(value: float | None, digits: int) -> str:
    """A number with the given decimals; trailing zeros of whole numbers are left out."""
    if value is None:
        return NOT_KNOWN
    return f"{value:,.0f}" if digits <= 1 and value == int(value) else f"{value:,.{digits}f}"


def interval(estimate: Estimate | None, digits: int, factor: float = 1.0, *, signed: bool = False) -> str:
    if estimate is None:
        return NOT_KNOWN
    form = f"{'+' if signed else ''},.{digits}f"
    # Rounding first and adding zero removes the minus sign of a zero.
    value, *ends = (
        None if x is None else format(round(factor * x, digits) + 0.0, form).replace("-", MINUS)
        for x in (estimate.value, estimate.low, estimate.high)
    )
    return f"{value}" if None in ends else f"{value} [{ends[0]}, {ends[1]}]"
