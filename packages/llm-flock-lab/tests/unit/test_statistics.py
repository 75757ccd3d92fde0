"""Intervals against scipy's, and at the ends of their range."""

import numpy as np
import pytest
from scipy import stats

from llm_flock_lab._experiments.statistics import bootstrap_interval, mean_bands, mean_interval, median, wilson


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_interval_matches_newcombe_1998(successes: int, trials: int, low: float, high: float) -> None:
    """Newcombe: Two-sided confidence intervals for the single proportion, Statistics in Medicine 1998, table I."""
    found = wilson(successes, trials)
    assert found.value == successes / trials
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-5)


def test_wilson_ends_exactly_at_none_and_all() -> None:
    for trials in range(1, 200):
        assert wilson(0, trials).low == 0.0
        assert wilson(trials, trials).high == 1.0


def test_mean_interval_matches_scipy() -> None:
    values = [3.0, 4.5, 4.0, 9.0]
    found = mean_interval(values)
    assert found is not None and found.value == 5.125
    expected = stats.t.interval(0.95, 3, loc=5.125, scale=stats.sem(values))
    assert (found.low, found.high) == pytest.approx(expected, rel=1e-9)


def test_too_few_values_for_an_interval() -> None:
    assert mean_interval([]) is None
    single = mean_interval([2.0])
    assert single is not None and (single.value, single.low, single.high) == (2.0, None, None)
    equal = mean_interval([2.0, 2.0])
    assert equal is not None and equal.low == equal.high == 2.0


def test_median() -> None:
    assert median([]) is None
    assert median([5.0, 1.0, 2.0]) == 2.0
    assert median([4.0, 1.0, 2.0, 3.0]) == 2.5


def test_bootstrap_interval_matches_scipy() -> None:
    values = np.random.default_rng(3).exponential(2.0, 40)
    found = bootstrap_interval(values.tolist())
    expected = stats.bootstrap((values,), np.mean, n_resamples=20_000, rng=np.random.default_rng(1))
    low, high = expected.confidence_interval
    assert found.low is not None and found.high is not None
    assert found.value == pytest.approx(values.mean())
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.05 * (high - low))
    # A skewed sample has a skewed interval, which Student's cannot have.
    assert found.high - found.value > 1.05 * (found.value - found.low)
    assert bootstrap_interval(values.tolist()) == found


def test_a_bootstrap_of_few_or_equal_values() -> None:
    single = bootstrap_interval([2.0])
    assert (single.low, single.high) == (None, None)
    equal = bootstrap_interval([0.1] * 7)
    assert equal.low == equal.high == pytest.approx(0.1)


def test_an_interval_of_counts_holds_no_impossible_value() -> None:
    free, counts = mean_interval([1.0, 12.0]), mean_interval([1.0, 12.0], least=0.0)
    assert free is not None and free.low is not None and free.low < 0
    assert counts is not None and (counts.value, counts.low, counts.high) == (free.value, 0.0, free.high)
    assert mean_interval([5.0], least=0.0) == mean_interval([5.0])


def test_bands_are_the_intervals_of_their_columns() -> None:
    table = np.random.default_rng(0).normal(5.0, 2.0, (12, 4))
    table[3:, 1] = np.nan
    table[:, 2] = np.nan
    table[1:, 3] = np.nan
    mean, low, high = mean_bands(table)
    for column in (0, 1):
        values = table[~np.isnan(table[:, column]), column]
        expected = mean_interval(values.tolist())
        assert expected is not None
        assert (mean[column], low[column], high[column]) == pytest.approx((expected.value, expected.low, expected.high))
    assert np.isnan([mean[2], low[2], high[2], low[3], high[3]]).all()
    assert mean[3] == table[0, 3]
