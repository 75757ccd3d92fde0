"""Separation along segments against dense sampling in time."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from llm_flock.metrics import min_separation, segment_separation


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 12), dim=st.sampled_from([2, 3]), step=st.floats(0, 20))
def test_no_instant_is_nearer_and_some_instant_is_as_near(seed: int, n: int, dim: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    before = rng.uniform(0, 30, (n, dim))
    after = before + rng.uniform(-step, step, (n, dim))
    exact = segment_separation(before, after)
    sampled = min(min_separation(before + t * (after - before)) for t in np.linspace(0, 1, 401))
    # Between two samples a pair closes in by at most twice the longest move of half an interval.
    slack = np.linalg.norm(after - before, axis=1).max() / 400
    assert sampled - slack - 1e-9 <= exact <= sampled + 1e-9
    assert segment_separation(after, before) == exact or abs(segment_separation(after, before) - exact) < 1e-9


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), side=st.floats(30, 2000))
def test_large_teams_by_tree_as_by_all_pairs(seed: int, side: float) -> None:
    rng = np.random.default_rng(seed)
    before = rng.uniform(0, side, (230, 2))
    after = before + rng.uniform(-6, 6, before.shape)
    one, two = np.triu_indices(len(before), 1)
    pair = np.stack([one, two], axis=1)
    offset = before[pair[:, 0]] - before[pair[:, 1]]
    change = (after - before)[pair[:, 0]] - (after - before)[pair[:, 1]]
    share = np.clip(-(offset * change).sum(axis=1) / (change * change).sum(axis=1), 0, 1)
    expected = np.linalg.norm(offset + share[:, None] * change, axis=1).min()
    assert abs(segment_separation(before, after) - expected) < 1e-9
