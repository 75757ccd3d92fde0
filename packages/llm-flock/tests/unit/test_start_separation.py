"""Starts that are too near: counted, followed until they have come apart, and kept out of what the protocol did."""

import math

import numpy as np
import pytest

from llm_flock.metrics import StartSeparation, min_separation, segment_separation


def follow(*rounds: list[tuple[float, float]], safe_distance: float = 3.0) -> StartSeparation:
    found = StartSeparation(safe_distance)
    before = np.array(rounds[0])
    for number, row in enumerate(rounds):
        now = np.array(row)
        found.update(number, now, min(min_separation(now), segment_separation(before, now)))
        before = now
    return found


def test_a_good_start_is_as_every_other_round() -> None:
    found = follow([(0, 0), (5, 0)], [(0, 0), (3.5, 0)])
    assert (found.start_violations, found.separated_at, found.smallest) == (0, 0, 3.5)


def test_a_pair_too_near_counts_from_when_it_is_apart() -> None:
    rounds = [[(0.0, 0.0), (1.0, 0.0), (9.0, 0.0)], [(-0.5, 0.0), (2.0, 0.0), (9.0, 0.0)]]
    found = follow(*rounds)
    assert (found.start_violations, found.separated_at, found.smallest) == (1, None, 7.0)
    rounds += [[(-1.0, 0.0), (2.0, 0.0), (9.0, 0.0)], [(-1.0, 0.0), (2.5, 0.0), (9.0, 0.0)]]
    found = follow(*rounds)
    assert (found.start_violations, found.separated_at, found.smallest) == (1, 2, 3.0)
    found = follow(*rounds, [(-1.0, 0.0), (0.5, 0.0), (9.0, 0.0)])
    assert (found.separated_at, found.smallest) == (2, 1.5)


def test_other_pairs_count_from_the_start() -> None:
    found = follow([(0.0, 0.0), (1.0, 0.0), (9.0, 0.0), (12.0, 0.0)], [(0.0, 0.0), (1.0, 0.0), (9.0, 0.0), (11.0, 0.0)])
    assert (found.start_violations, found.smallest) == (1, 2.0)


def test_two_robots_alone_on_one_spot_violate_at_start() -> None:
    found = follow([(5.0, 5.0), (5.0, 5.0)])
    assert (found.start_violations, found.separated_at, found.smallest) == (1, None, math.inf)
    assert follow([(5.0, 5.0)]).separated_at == 0


def test_pairs_left_out_of_a_large_team() -> None:
    rng = np.random.default_rng(0)
    grid = np.array([(10.0 * (k % 20), 10.0 * (k // 20)) for k in range(300)]) + rng.uniform(-1, 1, (300, 2))
    grid[1] = grid[0] + 0.5
    assert segment_separation(grid, grid) == pytest.approx(math.sqrt(0.5))
    assert segment_separation(grid, grid, frozenset({(0, 1)})) > 5.0
