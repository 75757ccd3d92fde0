"""Procrustes errors: both formulas, known cases, and what is refused."""

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from llm_flock import shapes as formations
from llm_flock.correspondence import proper_rotation
from llm_flock.errors import InputError
from llm_flock.metrics import ShapeError, ShapeTarget


def ideal(spec: str, n: int) -> np.ndarray:
    points = formations.ideal_points(spec, n, (50, 50), 10)
    assert points is not None
    return points


def procrustes(team: ArrayLike, target: ArrayLike) -> ShapeError:
    return ShapeTarget(target).error(team)


def turn(rng: np.random.Generator, dim: int) -> np.ndarray:
    """A random proper rotation."""
    q = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    q[:, 0] *= np.linalg.det(q)
    return q


@pytest.mark.parametrize("spec", ["line", "circle", "wedge", "grid", "square", "triangle", "cross"])
@pytest.mark.parametrize("seed", range(3))
def test_a_moved_turned_and_shuffled_shape_has_no_error(spec: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    target = ideal(spec, 9 if spec in ("cross", "triangle") else 8)
    order = rng.permutation(len(target))
    team = target[order] @ turn(rng, 2).T + rng.uniform(-100, 100, 2)
    error = procrustes(team, target)
    assert error.mean < 1e-9
    assert error.mean_squared < 1e-18
    laid = (team - team.mean(axis=0)) @ error.rotation.T
    np.testing.assert_allclose(laid, (target - target.mean(axis=0))[list(error.assignment)], atol=1e-9)


def test_both_formulas_by_hand() -> None:
    """A pair 14 apart against a pair 10 apart: each robot is 2 off, whichever way round."""
    error = procrustes([(0, 0), (0, 14)], [(-5, 0), (5, 0)])
    assert error.mean == pytest.approx(2.0)
    assert error.mean_squared == pytest.approx(4.0)


def test_mean_of_distances_is_not_the_root_mean_square() -> None:
    team = ideal("circle", 10)
    team[0] += (team[0] - 50) * 0.5
    error = procrustes(team, ideal("circle", 10))
    assert error.mean < math.sqrt(error.mean_squared) - 0.1


def test_a_mirror_image_is_not_the_shape() -> None:
    """Three unequal sides: the mirrored triangle cannot be turned onto the triangle."""
    target = np.array([(0.0, 0.0), (30.0, 0.0), (0.0, 10.0)])
    mirrored = target * (-1, 1)
    error = procrustes(mirrored, target)
    assert np.linalg.det(error.rotation) == pytest.approx(1.0)
    assert error.mean > 1.0


def test_flipping_a_singular_value_is_not_a_rotation() -> None:
    """The case in which the appendix's recipe gives a reflection."""
    target = np.array([(-20.0, -10.0), (20.0, -10.0), (0.0, 20.0)])
    mirrored = target * (-1, 1)
    u, _, vt = np.linalg.svd(target.T @ mirrored)
    assert np.linalg.det(u @ vt) == pytest.approx(-1.0)
    rotation = proper_rotation(mirrored, target)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    angles = np.linspace(0, 2 * math.pi, 20_001)
    sums = [
        ((mirrored @ np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]).T - target) ** 2).sum()
        for a in angles
    ]
    assert ((mirrored @ rotation.T - target) ** 2).sum() == pytest.approx(min(sums), rel=1e-6)


def test_one_robot_is_always_in_shape() -> None:
    error = procrustes([(3, 4)], [(50, 50)])
    assert (error.mean, error.mean_squared, error.assignment) == (0.0, 0.0, (0,))
    np.testing.assert_array_equal(error.rotation, np.eye(2))


def test_a_team_in_one_spot() -> None:
    target = ideal("circle", 10)
    error = procrustes(np.full((10, 2), 7.0), target)
    assert error.mean == pytest.approx(np.linalg.norm(target - 50, axis=1).mean())
    assert sorted(error.assignment) == list(range(10))


def test_the_same_shape_at_the_edge_of_the_world() -> None:
    team = ideal("square", 8) + 1e6
    assert procrustes(team, ideal("square", 8)).mean < 1e-7


def test_the_target_can_be_used_again() -> None:
    target = ShapeTarget(ideal("wedge", 7))
    rng = np.random.default_rng(5)
    for _ in range(3):
        team = rng.uniform(0, 100, (7, 2))
        again, fresh = target.error(team), procrustes(team, ideal("wedge", 7))
        assert (again.mean, again.mean_squared, again.assignment) == (fresh.mean, fresh.mean_squared, fresh.assignment)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("shape", ["cloud", "flat", "straight", "cube"])
def test_a_shape_in_space_is_found_again(seed: int, shape: str) -> None:
    rng = np.random.default_rng(seed)
    cube = np.array([(x, y, z) for x in (0.0, 10.0) for y in (0.0, 10.0) for z in (0.0, 10.0)])
    target = {
        "cloud": rng.uniform(0, 30, (12, 3)),
        "flat": np.column_stack([ideal("circle", 9), np.full(9, 20.0)]),
        "straight": np.arange(6)[:, None] * np.array([[3.0, 4.0, 5.0]]),
        "cube": cube,
    }[shape]
    team = target[rng.permutation(len(target))] @ turn(rng, 3).T + rng.uniform(-50, 50, 3)
    error = procrustes(team, target)
    assert error.mean < 1e-6
    assert np.linalg.det(error.rotation) == pytest.approx(1.0)
    near = procrustes(team + rng.uniform(-0.2, 0.2, team.shape), target)
    assert near.mean < 0.35


def test_space_tells_a_shape_from_its_mirror_image() -> None:
    target = np.array([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, 30.0)])
    error = procrustes(target * (1, 1, -1), target)
    assert np.linalg.det(error.rotation) == pytest.approx(1.0)
    assert error.mean > 1.0


def test_a_team_in_one_spot_of_space() -> None:
    target = np.random.default_rng(1).uniform(0, 30, (5, 3))
    error = procrustes(np.zeros((5, 3)), target)
    assert error.mean == pytest.approx(np.linalg.norm(target - target.mean(axis=0), axis=1).mean())


@pytest.mark.parametrize(
    ("positions", "target", "field"),
    [
        ([(0, 0)], [(0, 0), (1, 1)], "positions"),
        ([(0, 0, 0)], [(0, 0)], "positions"),
        ([(0, math.nan)], [(0, 0)], "positions"),
        ([(0, 0)], [(math.inf, 0)], "target"),
        ([0, 0], [(0, 0)], "positions"),
        (np.zeros((0, 2)), np.zeros((0, 2)), "target"),
        ([(0,)], [(0,)], "target"),
    ],
)
def test_procrustes_rejects_unfit_points(positions: ArrayLike, target: ArrayLike, field: str) -> None:
    with pytest.raises(InputError) as caught:
        procrustes(positions, target)
    assert caught.value.field == field
