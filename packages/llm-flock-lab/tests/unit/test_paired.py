"""Paired differences and effect sizes: their intervals match published ones, and cover the true value."""

import numpy as np
import pytest

from llm_flock_lab._experiments.paired import paired_means, paired_shares


def test_paired_difference_matches_scipy() -> None:
    from scipy import stats  # takes a second to import

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
def test_effect_interval_matches_noncentral_t(shift: float) -> None:
    from scipy import stats  # takes a second to import

    differences = np.random.default_rng(5).normal(shift, 1.0, 30)
    found = paired_means(differences.tolist(), [0.0] * 30)
    assert found is not None and found.effect is not None
    assert found.effect.low is not None and found.effect.high is not None
    score = differences.mean() / differences.std(ddof=1) * np.sqrt(30)
    unbiased = found.effect.value / (score / np.sqrt(30))
    for end, share in ((found.effect.low, 0.975), (found.effect.high, 0.025)):
        assert stats.nct.cdf(score, 29, end / unbiased * np.sqrt(30)) == pytest.approx(share, abs=1e-4)


def test_effect_interval_covers_the_true_effect() -> None:
    rng = np.random.default_rng(11)
    hits = 0
    for _ in range(400):
        found = paired_means(rng.normal(0.8, 1.0, 10).tolist(), [0.0] * 10)
        assert found is not None and found.effect is not None
        assert found.effect.low is not None and found.effect.high is not None
        hits += found.effect.low <= 0.8 <= found.effect.high
    assert 0.92 <= hits / 400 <= 0.98


def test_p_values_are_those_of_wilcoxon_and_mcnemar() -> None:
    from scipy import stats  # takes a second to import

    rng = np.random.default_rng(3)
    first, second = rng.normal(0.5, 1.0, 20), rng.normal(0.0, 1.0, 20)
    found = paired_means(first.tolist(), second.tolist())
    assert found is not None and found.p_value == pytest.approx(stats.wilcoxon(first, second).pvalue)
    ties = [3.0, -1.0, 1.0, 1.0, 2.0, 0.0, -3.0, 2.0, 2.0]
    tied = paired_means(ties, [0.0] * len(ties))
    assert tied is not None and tied.p_value == pytest.approx(stats.wilcoxon(ties).pvalue), "all 2^8 signs, counted"
    for count in (30, 300):  # by the normal distribution beyond 200
        values = rng.normal(0.15, 1.0, count)
        many = paired_means(values.tolist(), [0.0] * count)
        assert many is not None and many.p_value == pytest.approx(stats.wilcoxon(values).pvalue)
    equal = paired_means([1.0, 2.0], [1.0, 2.0])
    assert equal is not None and equal.p_value == 1.0
    # Of 20 seeds on which one alone succeeded, 5 or fewer, or 15 or more, are the first's with this chance.
    shares = paired_shares(*pairs(30, 5, 15, 10))
    assert shares is not None and shares.p_value == pytest.approx(0.0413895, abs=1e-7)
    alike = paired_shares(*pairs(3, 0, 0, 2))
    assert alike is not None and alike.p_value == 1.0


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


def test_paired_shares_match_newcombe_1998() -> None:
    found = paired_shares(*pairs(36, 12, 2, 0))
    assert found is not None and (found.pairs, found.only_first, found.only_second) == (50, 12, 2)
    # Newcombe 1998, the first example of table III.
    assert (found.difference.low, found.difference.high) == pytest.approx((0.0569, 0.3404), abs=6e-5)
    swapped = paired_shares(*pairs(36, 2, 12, 0))
    assert swapped is not None
    assert (swapped.difference.low, swapped.difference.high) == pytest.approx((-0.3404, -0.0569), abs=6e-5)


def test_interval_of_paired_shares_covers_the_true_difference() -> None:
    rng = np.random.default_rng(2)
    cells = rng.multinomial(20, [0.5, 0.3, 0.1, 0.1], size=1000)
    found = [paired_shares(*pairs(*row)) for row in cells.tolist()]
    hits = sum(f is not None and (f.difference.low or 0) <= 0.2 <= (f.difference.high or 0) for f in found)
    assert 0.92 <= hits / 1000 <= 0.99


def test_paired_shares_at_all_and_none() -> None:
    found = paired_shares([True] * 10, [False] * 10)
    assert found is not None and found.difference.value == 1.0
    assert found.difference.high == 1.0 and found.difference.low is not None and 0.5 < found.difference.low < 1.0
