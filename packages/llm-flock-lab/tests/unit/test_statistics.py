"""Intervals against scipy's, and at the ends of their range."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llm_flock_lab._experiments.statistics import (
    Duration,
    bootstrap_interval,
    duration,
    holm,
    horizon,
    mean_bands,
    mean_interval,
    restricted,
    restricted_mean,
    wilson,
)


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
    from scipy import stats  # takes a second to import

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


DURATIONS = st.lists(st.tuples(st.integers(1, 30).map(float), st.booleans()), min_size=1, max_size=40)


def test_restricted_mean_of_a_hand_example() -> None:
    """S is 1 up to 2, 0.8 up to 4 (one of five), 8/15 up to 7 (one of three left, one was stopped at 3), up to 10."""
    durations: list[Duration] = [(2.0, True), (3.0, False), (4.0, True), (7.0, True), (math.inf, False)]
    found = restricted_mean(durations, 10.0)
    area = 2.0 + 2 * 0.8 + 3 * 8 / 15 + 3 * 4 / 15
    later = np.array([area - 2.0, 3 * 8 / 15 + 3 * 4 / 15, 3 * 4 / 15])
    variance = (later**2 * np.array([1 / (5 * 4), 1 / (3 * 2), 1 / (2 * 1)])).sum()
    assert found is not None and found.value == pytest.approx(area)
    assert found.low == pytest.approx(area - 1.959964 * math.sqrt(variance), abs=1e-6)
    assert found.high == pytest.approx(min(10.0, area + 1.959964 * math.sqrt(variance)), abs=1e-6)


@given(durations=DURATIONS, until=st.floats(0.5, 40.0))
def test_restricted_mean_is_scipys_area_under_the_curve(durations: list[Duration], until: float) -> None:
    from scipy import stats  # takes a second to import

    times = [time for time, formed in durations if formed]
    stopped = [time for time, formed in durations if not formed]
    sample: Any = stats.CensoredData(times, right=stopped)
    curve = stats.ecdf(sample).sf
    edges = np.array([0.0, *(x for x in np.unique(curve.quantiles) if x < until), until])
    expected = (np.asarray(curve.evaluate(edges[:-1])) * np.diff(edges)).sum()
    found = restricted_mean(durations, until)
    assert found is not None and found.value == pytest.approx(expected)
    assert found.low is not None and found.high is not None
    assert 0.0 <= found.low <= found.value + 1e-9 and found.value - 1e-9 <= found.high <= until


def test_restricted_mean_of_trials_not_stopped_early() -> None:
    """It is the plain mean of the restricted times, and its variance that of a mean, over n instead of n - 1."""
    durations: list[Duration] = [(5.0, True), (8.0, True), (8.0, True), (30.0, True), (math.inf, False), (25.0, False)]
    times = [restricted(one, 20.0) for one in durations]
    assert times == [5.0, 8.0, 8.0, 20.0, 20.0, 20.0]
    found = restricted_mean(durations, 20.0)
    half = 1.959964 * np.std([5.0, 8.0, 8.0, 20.0, 20.0, 20.0]) / math.sqrt(6)
    assert found is not None and found.low is not None and found.value == pytest.approx(13.5)
    assert found.value - found.low == pytest.approx(half, abs=1e-6)
    assert restricted((12.0, False), 20.0) is None, "nobody knows when a trial without budget would have formed"
    assert restricted_mean([], 20.0) is None and restricted_mean(durations, 0.0) is None


def row(stopped: str, rounds: int, formed_in: int | None = None, bound: int | None = 5) -> dict[str, Any]:
    figures = {"stopped": stopped, "rounds": rounds, "lower_bound_rounds": bound}
    return figures | {"formed": formed_in is not None, "rounds_to_formed": formed_in}


def test_durations_and_their_horizon() -> None:
    formed, missed, lost = row("formed", 12, 10), row("rounds", 40), row("rounds", 50, bound=None)
    hopeless, poor = row("no_plan", 7), row("budget", 3)
    assert [duration(one) for one in (formed, missed, lost)] == [(10.0, True), (40.0, False), (50.0, False)]
    assert [duration(one) for one in (hopeless, poor)] == [(math.inf, False), (3.0, False)]
    assert [duration(one, over_bound=True) for one in (formed, missed)] == [(2.0, True), (8.0, False)]
    assert duration(lost, over_bound=True) == (math.inf, False), "a team without one plan has no bound"
    assert duration(row("formed", 3, 1, bound=0), over_bound=True) == (1.0, True)
    assert horizon([formed, missed, lost, hopeless, poor]) == 40.0, "a budget is no deadline"
    assert horizon([formed, hopeless]) == 35.0, "three times the bound and 20"
    assert horizon([formed, hopeless], over_bound=True) == 7.0
    assert horizon([formed]) == 10.0 and horizon([poor]) == 0.0 and horizon([row("no_plan", 7, bound=None)]) == 0.0


def test_holm_adjusts_a_family_of_tests() -> None:
    """Holm 1979: the smallest of four counts four times, the next three times, and none less than one before it."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0] and holm([0.02]) == [0.02] and holm([]) == []


@given(p_values=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20))
def test_holm_lies_between_none_and_bonferroni(p_values: list[float]) -> None:
    adjusted = np.array(holm(p_values))
    assert (adjusted >= np.array(p_values) - 1e-12).all()
    assert (adjusted <= np.minimum(1.0, np.array(p_values) * len(p_values)) + 1e-12).all()
    assert (np.diff(adjusted[np.argsort(p_values)]) >= 0).all()


def test_bootstrap_interval_matches_scipy() -> None:
    from scipy import stats  # takes a second to import

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
