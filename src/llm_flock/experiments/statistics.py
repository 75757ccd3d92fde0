"""Intervals for the results of a number of trials."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from llm_flock.errors import InputError

CONFIDENCE = 0.95

RESAMPLES = 4000
"""Draws of a bootstrap: its ends move by a few hundredths of its width from seed to seed."""

BATCH = 100
"""Draws of a bootstrap that are in memory at once."""

Method: TypeAlias = Literal["student", "bootstrap"]
"""How to find the interval of a mean: Student's t (as in the paper), or the bootstrap."""

METHODS: tuple[Method, ...] = ("student", "bootstrap")

Column: TypeAlias = NDArray[np.float64]
"""One number for each column of a table, shape (k,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """An estimated value and its confidence interval, in the value's unit; an end is None where it is not known."""

    value: float
    low: float | None
    high: float | None


def wilson(successes: int, trials: int, confidence: float = CONFIDENCE) -> Estimate:
    """A share of successes with Wilson's score interval.

    It stays within 0 .. 1 and has a width at 0 and at all successes, where the normal interval has none (Wilson:
    Probable inference, the law of succession, and statistical inference, JASA 1927).

    Raises:
        InputError: a number is out of its range.
    """
    _check(confidence)
    if trials < 1:
        raise InputError("trials", trials, "at least 1")
    if not 0 <= successes <= trials:
        raise InputError("successes", successes, f"0 .. {trials}")
    ends = scipy.stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return Estimate(value=successes / trials, low=float(ends.low), high=float(ends.high))


def mean_interval(
    values: Sequence[float],
    confidence: float = CONFIDENCE,
    method: Method = "student",
    *,
    least: float | None = None,
) -> Estimate | None:
    """The mean of independent, finite values with its interval; None without values, no interval for a single one.

    `least` is as in `mean_bands`.

    Raises:
        InputError: the confidence is out of its range.
    """
    _check(confidence)
    if not values:
        return None
    if len(values) == 1:
        return Estimate(value=float(values[0]), low=None, high=None)
    mean, low, high = mean_bands(np.array(values, dtype=np.float64)[:, None], method, confidence, least=least)
    return Estimate(value=float(mean[0]), low=float(low[0]), high=float(high[0]))


def mean_bands(
    table: NDArray[np.float64],
    method: Method = "student",
    confidence: float = CONFIDENCE,
    *,
    least: float | None = None,
) -> tuple[Column, Column, Column]:
    """Mean of every column over the rows, and the ends of its interval.

    Args:
        table: a row for each trial, a column for each round; unknown values are NaN and left out of their column.
        method: how to find the interval.
        confidence: between 0 and 1.
        least: the smallest possible value, 0 for counts and lengths. Few trials give an interval that reaches below
            it; its end moves there, which costs no coverage, because the true mean cannot be below it.

    Returns:
        mean, low and high, each of shape (columns,); NaN where there is no value (for the ends: fewer than two).

    Raises:
        InputError: the confidence is out of its range.
    """
    _check(confidence)
    mean, low, high = (np.full(table.shape[1], np.nan) for _ in range(3))
    known = ~np.isnan(table)
    # Columns with the same known rows are done at once. Usually these are all columns.
    patterns, which = np.unique(known, axis=1, return_inverse=True)
    for number, rows in enumerate(patterns.T):
        columns = which.reshape(-1) == number
        values = table[np.ix_(rows, columns)]
        if len(values):
            mean[columns] = values.mean(axis=0)
        if len(values) > 1:
            find = _student_ends if method == "student" else _bootstrap_ends
            low[columns], high[columns] = find(values, confidence)
    if least is not None:
        low = np.maximum(low, least)  # NaN stays
    return mean, low, high


def _student_ends(values: NDArray[np.float64], confidence: float) -> tuple[Column, Column]:
    count = len(values)
    half = scipy.special.stdtrit(count - 1, (1 + confidence) / 2) * values.std(axis=0, ddof=1) / math.sqrt(count)
    return values.mean(axis=0) - half, values.mean(axis=0) + half


def _bootstrap_ends(values: NDArray[np.float64], confidence: float) -> tuple[Column, Column]:
    """Bias-corrected and accelerated interval of each column's mean (Efron: Better bootstrap intervals, JASA 1987).

    The draws are the same for every column and every call, so a report does not change from one build to the next.
    """
    low, high = values.mean(axis=0), values.mean(axis=0)
    # Where all values are equal, so are all means, and scipy finds no interval.
    varied = np.ptp(values, axis=0) > 1e-12 * np.maximum(1.0, np.abs(low))
    if varied.any():
        found = scipy.stats.bootstrap(
            (values[:, varied],),
            np.mean,
            axis=0,
            confidence_level=confidence,
            n_resamples=RESAMPLES,
            batch=BATCH,
            rng=np.random.default_rng(0),
        )
        low[varied], high[varied] = found.confidence_interval
    return low, high


def median(values: Sequence[float]) -> float | None:
    """The middle value, or the mean of the two in the middle; None without values."""
    return statistics.median(values) if values else None


def _check(confidence: float) -> None:
    if not 0 < confidence < 1:
        raise InputError("confidence", confidence, "between 0 and 1")
