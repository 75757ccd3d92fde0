"""Crowds that start too near together."""

from typing import Any

import numpy as np
import pytest
from safe_team import SAFE, SafeTeam

from llm_flock.arrays import flattened
from llm_flock.metrics import min_separation


def dense(seed: int, dim: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Up to a dozen robots in a box that is too small for them, some on one spot."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 13))
    starts = 50 + rng.uniform(-4, 4, (n, dim))
    for k in range(1, n):
        if rng.random() < 0.3:
            starts[k] = starts[int(rng.integers(0, k))]
    goals = np.full((n, dim), 50.0) if seed % 2 else 50 + rng.uniform(-30, 30, (n, dim))
    return starts, goals


def separates(seed: int, dim: int = 2, **fields: Any) -> None:
    """A crowd is apart within eight rounds, and no pair comes nearer on the way."""
    team = SafeTeam(*dense(seed, dim), **fields)

    def gaps() -> np.ndarray:
        rows = flattened(team.positions, team.mission.downwash)
        return np.linalg.norm(rows[:, None] - rows, axis=2)

    crowded = min_separation(team.positions, team.mission.downwash) < SAFE - 1e-6
    for _ in range(8):
        before = gaps()
        if min_separation(team.positions, team.mission.downwash) >= SAFE - 1e-6:
            break
        team.round()
        assert bool((gaps() + 1e-6 >= np.minimum(before, SAFE)).all()), seed
    assert min_separation(team.positions, team.mission.downwash) >= SAFE - 1e-6, seed
    assert ("separating" in team.kinds) == crowded


@pytest.mark.parametrize("first", range(0, 200, 50))
def test_any_crowd_separates_in_eight_rounds_no_pair_worsens(first: int) -> None:
    for seed in range(first, first + 50):
        separates(seed)


@pytest.mark.parametrize("downwash", [1.0, 2.0, 3.0])
def test_crowds_in_space_separate_as_well(downwash: float) -> None:
    for seed in range(12):
        separates(seed, 3, downwash=downwash)
