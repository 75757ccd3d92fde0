"""Intervals for what a number of trials has shown."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.special import ndtri, stdtrit

from llm_flock.errors import InputError

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value and the interval that holds the true one with the confidence asked for; in the value's unit.

    Attributes:
        value: the best guess.
        low: lower end; None where nothing can be said.
        high: upper end; None where nothing can be said.
    """

    value: float
    low: float | None
    high: float | None


def wilson(successes: int, trials: int, confidence: float = CONFIDENCE) -> Estimate:
    """A share of successes with Wilson's score interval.

    It stays within 0 .. 1 and is of use at 0 and at all successes, where the plain normal interval has no width
    (Wilson: Probable inference, the law of succession, and statistical inference, JASA 1927).

    Args:
        successes: at most `trials`.
        trials: at least 1.
        confidence: between 0 and 1.

    Raises:
        InputError: a number is out of its range.
    """
    if trials < 1:
        raise InputError("trials", trials, "at least 1")
    if not 0 <= successes <= trials:
        raise InputError("successes", successes, f"0 .. {trials}")
    z = _normal_quantile(confidence)
    share = successes / trials
    scale = 1 + z * z / trials
    middle = (share + z * z / (2 * trials)) / scale
    half = z / scale * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    # At the ends the formula gives exactly 0 and 1; rounding must not move them.
    low = 0.0 if successes == 0 else middle - half
    high = 1.0 if successes == trials else middle + half
    return Estimate(value=share, low=low, high=high)


def mean_interval(values: Sequence[float], confidence: float = CONFIDENCE) -> Estimate | None:
    """The mean with Student's t interval; None without values, without interval for a single one.

    Args:
        values: independent and finite.
        confidence: between 0 and 1.

    Raises:
        InputError: the confidence is out of its range.
    """
    _check(confidence)
    if not values:
        return None
    mean = statistics.fmean(values)
    if len(values) == 1:
        return Estimate(value=mean, low=None, high=None)
    quantile = float(stdtrit(len(values) - 1, (1 + confidence) / 2))
    half = quantile * statistics.stdev(values, mean) / math.sqrt(len(values))
    return Estimate(value=mean, low=mean - half, high=mean + half)


def median(values: Sequence[float]) -> float | None:
    """The middle value, or the mean of the two in the middle; None without values."""
    return statistics.median(values) if values else None


def _normal_quantile(confidence: float) -> float:
    _check(confidence)
    return float(ndtri((1 + confidence) / 2))


def _check(confidence: float) -> None:
    if not 0 < confidence < 1:
        raise InputError("confidence", confidence, "between 0 and 1")
