"""The fast comparison with a shape agrees with the exact error whenever it returns one."""

import numpy as np
import pytest

from llm_flock import correspondence, metrics
from llm_flock import shapes as formations
from llm_flock.correspondence import longest, proven_match
from llm_flock.mission import Mission


@pytest.mark.parametrize(("shape", "n"), [("triangle", 6), ("square", 8), ("cross", 5), ("wedge", 6), ("star", 10)])
@pytest.mark.parametrize("noise", [0.0, 0.005, 0.3])
def test_quick_error_is_exact_if_the_correspondence_is_plain(shape: str, n: int, noise: float) -> None:
    target = np.array(Mission(shape=shape, n_robots=n).ideal)
    rng = np.random.default_rng(5)
    for _ in range(10):
        rows = formations.rotated(target, (50, 50), rng.uniform(0, 7)) + rng.uniform(-noise, noise, target.shape)
        rows = rng.permutation(rows)
        quick = correspondence.quick_error(rows, target)
        assert quick == pytest.approx(metrics.ShapeTarget(target).error(rows).mean, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("shape", "n", "symmetry"), [("grid", 30, 1), ("grid", 36, 4), ("circle", 12, 12), ("line", 9, 2)]
)
@pytest.mark.parametrize("noise", [0.0, 0.01, 1.0, 2.0])
def test_a_proven_match_is_the_best_correspondence(shape: str, n: int, symmetry: int, noise: float) -> None:
    target = np.array(Mission(shape=shape, n_robots=n, center=(100, 100), arena=((0, 0), (200, 200))).ideal)
    rng = np.random.default_rng(5)
    for _ in range(5):
        rows = formations.rotated(target, (50, 50), rng.uniform(0, 7)) + rng.uniform(-noise, noise, target.shape)
        rows = rng.permutation(rows)
        x, y = (points[:, 0] + 1j * points[:, 1] for points in (rows - rows.mean(axis=0), target - target.mean(axis=0)))
        best = longest(x, y)
        for turns in (1, symmetry):
            found = proven_match(rows, target, turns)
            assert found is not None and abs(found.z) == pytest.approx(abs(best.z), rel=1e-12)
            assert sorted(found.columns.tolist()) == list(range(n))


def test_a_crowd_has_no_proven_match() -> None:
    target = np.array(Mission(shape="grid", n_robots=16).ideal)
    assert proven_match(np.random.default_rng(0).uniform(0, 40, target.shape), target) is None
    assert proven_match(np.full((16, 2), 50.0), target) is None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(correspondence, "MAX_INTERVALS", 10)
        assert proven_match(target, target) is None
    assert proven_match(target, target) is not None


def test_a_large_team_has_the_same_error_either_way(monkeypatch: pytest.MonkeyPatch) -> None:
    target = np.array(Mission(shape="grid", n_robots=49, center=(100, 100), arena=((0, 0), (200, 200))).ideal)
    rows = formations.rotated(target, (50, 50), 1.0) + np.random.default_rng(2).uniform(-0.3, 0.3, target.shape)
    slow = metrics.ShapeTarget(target).error(rows)
    monkeypatch.setattr(metrics, "LARGE", 48)
    monkeypatch.setattr(metrics, "longest", None)
    fast = metrics.ShapeTarget(target).error(rows)
    assert fast.mean == pytest.approx(slow.mean, rel=1e-9)
    assert fast.mean_squared == pytest.approx(slow.mean_squared, rel=1e-9)


def test_enough_ends_the_search() -> None:
    target = np.array(Mission(shape="square", n_robots=8).ideal)
    found = correspondence.quick_error(target.round(2), target, 0.1)
    assert found is not None and found <= 0.1


def test_quick_error_has_no_answer_if_nothing_fits() -> None:
    circle = np.array(Mission(shape="circle", n_robots=8).ideal)
    line = np.array(Mission(shape="line", n_robots=8).ideal)
    assert correspondence.quick_error(line, circle) is None
    assert correspondence.quick_error(np.full((8, 2), 50.0), circle) is None
    cross = np.array(Mission(shape="cross", n_robots=5).ideal)
    assert correspondence.quick_error(cross, cross) == pytest.approx(0.0, abs=1e-9)
