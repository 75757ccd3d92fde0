"""Intervals against scipy's, and at the ends of their range."""

import pytest
from scipy import stats

from llm_flock.errors import InputError
from llm_flock.experiments.statistics import mean_interval, median, wilson


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (0, 10), (3, 10), (10, 10), (997, 1000)])
def test_wilson_is_scipys(successes: int, trials: int, confidence: float) -> None:
    found = wilson(successes, trials, confidence)
    expected = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    assert found.value == successes / trials
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-12)


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


@pytest.mark.parametrize(
    ("successes", "trials", "field"), [(0, 0, "trials"), (-1, 5, "successes"), (6, 5, "successes")]
)
def test_impossible_counts_are_refused(successes: int, trials: int, field: str) -> None:
    with pytest.raises(InputError) as caught:
        wilson(successes, trials)
    assert caught.value.field == field


@pytest.mark.parametrize("confidence", [0.0, 1.0, float("nan")])
def test_a_confidence_is_a_share(confidence: float) -> None:
    with pytest.raises(InputError, match="confidence"):
        wilson(1, 2, confidence)
    with pytest.raises(InputError, match="confidence"):
        mean_interval([1.0, 2.0], confidence)
