"""The quick look agrees with the exact error wherever it says anything."""

import numpy as np
import pytest

from llm_flock import formations, metrics
from llm_flock.mission import Mission


@pytest.mark.parametrize(("shape", "n"), [("triangle", 6), ("square", 8), ("cross", 5), ("wedge", 6), ("star", 10)])
@pytest.mark.parametrize("noise", [0.0, 0.005, 0.3])
def test_it_is_the_exact_error_where_the_correspondence_is_plain(shape: str, n: int, noise: float) -> None:
    target = np.array(Mission(shape=shape, n_robots=n).ideal)
    rng = np.random.default_rng(5)
    for _ in range(10):
        rows = formations.rotated(target, (50, 50), rng.uniform(0, 7)) + rng.uniform(-noise, noise, target.shape)
        rows = rng.permutation(rows)
        quick = metrics.resemblance(rows, target)
        assert quick == pytest.approx(metrics.procrustes(rows, target).mean, rel=1e-6, abs=1e-9)


def test_enough_ends_the_search() -> None:
    target = np.array(Mission(shape="square", n_robots=8).ideal)
    found = metrics.resemblance(target.round(2), target, 0.1)
    assert found is not None and found <= 0.1


def test_it_says_nothing_where_nothing_fits() -> None:
    circle = np.array(Mission(shape="circle", n_robots=8).ideal)
    line = np.array(Mission(shape="line", n_robots=8).ideal)
    assert metrics.resemblance(line, circle) is None
    assert metrics.resemblance(np.full((8, 2), 50.0), circle) is None
    cross = np.array(Mission(shape="cross", n_robots=5).ideal)
    assert metrics.resemblance(cross, cross) == pytest.approx(0.0, abs=1e-9)
