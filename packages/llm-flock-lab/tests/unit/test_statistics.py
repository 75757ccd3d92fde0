"""Intervals against scipy's, and at the ends of their range."""

import numpy as np
import pytest
from scipy import stats

from llm_flock_lab._experiments.paired import paired_means, paired_shares
from llm_flock_lab._experiments.statistics import bootstrap_interval, mean_bands, mean_interval, median, wilson


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_is_newcombes_table(successes: int, trials: int, low: float, high: float) -> None:
    """Newcombe: Two-sided confidence intervals for the single proportion, Statistics in Medicine 1998, table I."""
    found = wilson(successes, trials)
    assert found.value == successes / trials
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-5)


def test_wilson_ends_exactly_at_none_and_all() -> None:
    for trials in range(1, 200):
        assert wilson(0, trials).low == 0.0
        assert wilson(trials, trials).high == 1.0


def test_students_interval_is_scipys() -> None:
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


def test_a_bootstrap_interval_is_scipys() -> None:
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


def test_the_paired_difference_is_students() -> None:
    first, second = [5.0, 4.0, 7.0, 6.5, 8.0], [3.0, 4.5, 4.0, 5.0, 5.5]
    found = paired_means(first, second)
    expected = stats.ttest_rel(first, second).confidence_interval(0.95)
    assert found is not None and found.pairs == 5
    assert found.difference.value == pytest.approx(1.7)
    assert (found.difference.low, found.difference.high) == pytest.approx((expected.low, expected.high))
    # Hedges' correction for 4 degrees of freedom is 0.79788.
    differences = np.subtract(first, second)
    assert found.effect is not None
    assert found.effect.value == pytest.approx(0.797885 * differences.mean() / differences.std(ddof=1), rel=1e-5)


@pytest.mark.parametrize("shift", [0.0, 0.3, -1.0, 20.0])
def test_the_effects_interval_is_the_noncentral_ts(shift: float) -> None:
    differences = np.random.default_rng(5).normal(shift, 1.0, 30)
    found = paired_means(differences.tolist(), [0.0] * 30)
    assert found is not None and found.effect is not None
    assert found.effect.low is not None and found.effect.high is not None
    score = differences.mean() / differences.std(ddof=1) * np.sqrt(30)
    unbiased = found.effect.value / (score / np.sqrt(30))
    for end, share in ((found.effect.low, 0.975), (found.effect.high, 0.025)):
        assert stats.nct.cdf(score, 29, end / unbiased * np.sqrt(30)) == pytest.approx(share, abs=1e-4)


def test_the_effects_interval_covers_the_truth() -> None:
    rng = np.random.default_rng(11)
    hits = 0
    for _ in range(400):
        found = paired_means(rng.normal(0.8, 1.0, 10).tolist(), [0.0] * 10)
        assert found is not None and found.effect is not None
        assert found.effect.low is not None and found.effect.high is not None
        hits += found.effect.low <= 0.8 <= found.effect.high
    assert 0.92 <= hits / 400 <= 0.98


def test_pairs_without_spread_or_too_few_have_no_effect_size() -> None:
    assert paired_means([], []) is None and paired_shares([], []) is None
    equal = paired_means([2.1, 3.1, 4.1], [1.0, 2.0, 3.0])
    assert equal is not None and equal.effect is None and equal.difference.value == pytest.approx(1.1)
    two = paired_means([2.0, 5.0], [1.0, 2.0])
    assert two is not None and two.effect is None
    with pytest.raises(ValueError, match="shorter"):
        paired_means([1.0], [])


def pairs(both: int, only_first: int, only_second: int, neither: int) -> tuple[list[bool], list[bool]]:
    first = [True] * (both + only_first) + [False] * (only_second + neither)
    return first, [True] * both + [False] * only_first + [True] * only_second + [False] * neither


def test_paired_shares_are_newcombes() -> None:
    found = paired_shares(*pairs(36, 12, 2, 0))
    assert found is not None and (found.pairs, found.only_first, found.only_second) == (50, 12, 2)
    # Newcombe 1998, the first example of table III.
    assert (found.difference.low, found.difference.high) == pytest.approx((0.0569, 0.3404), abs=6e-5)
    swapped = paired_shares(*pairs(36, 2, 12, 0))
    assert swapped is not None
    assert (swapped.difference.low, swapped.difference.high) == pytest.approx((-0.3404, -0.0569), abs=6e-5)


def test_the_interval_of_paired_shares_covers_the_truth() -> None:
    rng = np.random.default_rng(2)
    cells = rng.multinomial(20, [0.5, 0.3, 0.1, 0.1], size=1000)
    found = [paired_shares(*pairs(*row)) for row in cells.tolist()]
    hits = sum(f is not None and (f.difference.low or 0) <= 0.2 <= (f.difference.high or 0) for f in found)
    assert 0.92 <= hits / 1000 <= 0.99


def test_paired_shares_at_all_and_none() -> None:
    found = paired_shares([True] * 10, [False] * 10)
    assert found is not None and found.difference.value == 1.0
    assert found.difference.high == 1.0 and found.difference.low is not None and 0.5 < found.difference.low < 1.0
