"""Crowds that start too near together."""

import numpy as np
import pytest
from safe_team import SAFE, SafeTeam

from llm_flock.metrics import min_separation


def dense(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Up to a dozen robots in a box that is too small for them, some on one spot."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 13))
    starts = 50 + rng.uniform(-4, 4, (n, 2))
    for k in range(1, n):
        if rng.random() < 0.3:
            starts[k] = starts[int(rng.integers(0, k))]
    goals = np.full((n, 2), 50.0) if seed % 2 else 50 + rng.uniform(-30, 30, (n, 2))
    return starts, goals


@pytest.mark.parametrize("first", range(0, 200, 50))
def test_any_crowd_separates_in_eight_rounds_no_pair_worsens(first: int) -> None:
    for seed in range(first, first + 50):
        team = SafeTeam(*dense(seed))
        crowded = min_separation(team.positions) < SAFE - 1e-6
        for _ in range(8):
            before = np.linalg.norm(team.positions[:, None] - team.positions, axis=2)
            if min_separation(team.positions) >= SAFE - 1e-6:
                break
            team.round()
            after = np.linalg.norm(team.positions[:, None] - team.positions, axis=2)
            assert bool((after + 1e-6 >= np.minimum(before, SAFE)).all()), seed
        assert min_separation(team.positions) >= SAFE - 1e-6, seed
        assert ("separating" in team.kinds) == crowded
