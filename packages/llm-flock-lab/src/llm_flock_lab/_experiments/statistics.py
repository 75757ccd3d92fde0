"""Intervals for the results of a number of trials."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

CONFIDENCE = 0.95

NOT_KNOWN = "-"
MINUS = "\N{MINUS SIGN}"

RESAMPLES = 4000
"""Draws of a bootstrap: its ends move by a few hundredths of its width from seed to seed."""

Column: TypeAlias = NDArray[np.float64]
"""One number for each column of a table, shape (k,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """An estimated value and its confidence interval, in the value's unit; an end is None where it is not known."""

    value: float
    low: float | None
    high: float | None


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


def median(values: Sequence[float]) -> float | None:
    """The middle value, or the mean of the two in the middle; None without values."""
    return statistics.median(values) if values else None


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
