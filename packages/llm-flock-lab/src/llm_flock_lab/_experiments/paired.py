"""Compare two protocols trial by trial, on the same seeds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from llm_flock_lab._experiments.statistics import CONFIDENCE, Estimate, mean_interval, wilson

MOST_EXACT = 200  # most pairs of which the distribution of rank sums is counted; beyond, the normal one is as good


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedMeans:
    """A figure of two protocols: mean of first - second, in standard deviations too (Hedges' g of pairs) if defined.

    `p_value` is that of Wilcoxon's signed-rank test (Individual comparisons by ranking methods, Biometrics Bulletin
    1945), two-sided: that the differences lie around 0.
    """

    pairs: int
    difference: Estimate
    effect: Estimate | None
    p_value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedShares:
    """Success of two protocols on the same seeds: on how many one alone succeeded, and first share minus second.

    `p_value` is that of McNemar's exact test (Psychometrika 1947), two-sided: that both succeed as often.
    """

    pairs: int
    only_first: int
    only_second: int
    difference: Estimate
    p_value: float


def paired_means(first: Sequence[float], second: Sequence[float]) -> PairedMeans | None:
    """Compare finite figures of the same seeds pair by pair; None without pairs.

    The interval of the effect size is that of the noncentral t distribution (Hedges, Olkin: Statistical methods for
    meta-analysis, 1985; Goulet-Pelletier, Cousineau: A review of effect sizes, TQMP 2018).
    """
    differences = [a - b for a, b in zip(first, second, strict=True)]
    mean = mean_interval(differences)
    if mean is None:
        return None
    effect, p_value = _effect(differences), _signed_rank_p_value(differences)
    return PairedMeans(pairs=len(differences), difference=mean, effect=effect, p_value=p_value)


def paired_shares(first: Sequence[bool], second: Sequence[bool]) -> PairedShares | None:
    """Compare success pair by pair; None without pairs.

    The interval is Newcombe's of squared and added score intervals, corrected for the pairs' correlation (Improved
    confidence intervals for the difference between binomial proportions based on paired data, Statistics in Medicine
    1998, method 10). It has a width where all or none succeeded.
    """
    n = len(first)
    if not n:
        return None
    one, two = wilson(sum(first), n), wilson(sum(second), n)
    both = sum(a and b for a, b in zip(first, second, strict=True))
    only_first, only_second = sum(first) - both, sum(second) - both
    alone = only_first + only_second
    correlation = _correlation(both, only_first, only_second, n - both - only_first - only_second)
    difference = one.value - two.value
    (below_one, above_one), (below_two, above_two) = _arms(one), _arms(two)
    down = _deviation_of_difference(below_one, above_two, correlation)
    up = _deviation_of_difference(above_one, below_two, correlation)
    return PairedShares(
        pairs=n,
        only_first=only_first,
        only_second=only_second,
        difference=Estimate(value=difference, low=max(-1.0, difference - down), high=min(1.0, difference + up)),
        p_value=float(scipy.stats.binomtest(only_first, alone).pvalue) if alone else 1.0,
    )


def _signed_rank_p_value(differences: Sequence[float]) -> float:
    """Wilcoxon's test without the differences that are 0, exact with ties too: each of the others has either sign.

    scipy counts all signs one by one where there are ties, which takes seconds for 13 pairs.
    """
    apart = np.array([x for x in differences if x])
    if len(apart) > MOST_EXACT:
        return float(scipy.stats.wilcoxon(apart).pvalue)
    ranks = (2 * scipy.stats.rankdata(np.abs(apart))).astype(int)  # twice each, so that those of ties are whole
    chances = np.ones(1)  # of each sum of the ranks of positive differences
    for rank in ranks:
        chances = (np.pad(chances, (0, rank)) + np.pad(chances, (rank, 0))) / 2
    found = int(ranks[apart > 0].sum())
    return min(1.0, 2 * float(min(chances[: found + 1].sum(), chances[found:].sum())))


def _effect(differences: Sequence[float]) -> Estimate | None:
    n = len(differences)
    if n < 3:
        return None
    mean, spread = statistics.fmean(differences), statistics.stdev(differences)
    if spread <= 1e-12 * max(map(abs, differences)):
        return None  # no spread to measure the difference by
    free = n - 1
    # Without this factor the effect of few pairs would be overestimated.
    unbiased = math.exp(math.lgamma(free / 2) - math.lgamma((free - 1) / 2)) / math.sqrt(free / 2)
    score = mean / spread * math.sqrt(n)
    low, high = (
        float(scipy.special.nctdtrinc(free, share, score)) / math.sqrt(n) * unbiased
        for share in ((1 + CONFIDENCE) / 2, (1 - CONFIDENCE) / 2)
    )
    sane = math.isfinite(low) and math.isfinite(high) and low < high
    value = mean / spread * unbiased
    return Estimate(value=value, low=low if sane else None, high=high if sane else None)


def _correlation(both: int, only_first: int, only_second: int, neither: int) -> float:
    """Correlation of the two successes, with Newcombe's correction for chance where it is positive."""
    margins = (both + only_first) * (only_second + neither) * (both + only_second) * (only_first + neither)
    if not margins:
        return 0.0
    surplus = float(both * neither - only_first * only_second)
    if surplus > 0:
        surplus = max(surplus - (both + only_first + only_second + neither) / 2, 0.0)
    return surplus / math.sqrt(margins)


def _arms(share: Estimate) -> tuple[float, float]:
    """Distances from a share down and up to the ends of its interval."""
    assert share.low is not None and share.high is not None, "Wilson's interval always has ends"
    return share.value - share.low, share.high - share.value


def _deviation_of_difference(one: float, two: float, correlation: float) -> float:
    return math.sqrt(max(0.0, one * one - 2 * correlation * one * two + two * two))
