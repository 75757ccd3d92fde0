"""The Procrustes error is the global optimum over correspondence and rotation, and an error of shape only."""

import math
from itertools import permutations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from llm_flock import shapes as formations
from llm_flock.metrics import ShapeTarget

SHAPES = {
    "line": (1, 2, 3, 4, 5, 6, 7),
    "circle": (1, 2, 3, 4, 5, 6, 7),
    "grid": (4, 5, 6, 7),
    "wedge": (3, 4, 5, 6, 7),
    "triangle": (3, 6),
    "square": (4,),
    "cross": (5,),
}


def brute_force(positions: np.ndarray, target: np.ndarray) -> float:
    """Least mean of squared distances: all permutations, each with its best rotation in closed form."""
    x, y = positions - positions.mean(axis=0), target - target.mean(axis=0)
    orders = np.array(list(permutations(range(len(x)))))
    a, b = x[:, 0] + 1j * x[:, 1], (y[:, 0] + 1j * y[:, 1])[orders]
    angles = np.angle((a.conj() * b).sum(axis=1))
    return float((np.abs(a * np.exp(1j * angles)[:, None] - b) ** 2).mean(axis=1).min())


@st.composite
def cases(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """A team of up to seven and a target: random, symmetric, nearly symmetric, or on a lattice full of ties."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["shape", "cloud", "lattice"]))
    if kind == "shape":
        spec = draw(st.sampled_from(sorted(SHAPES)))
        ideal = formations.ideal_points(spec, draw(st.sampled_from(SHAPES[spec])), (50, 50), 10)
        assert ideal is not None
        target = ideal + draw(st.sampled_from([0.0, 1e-13, 1e-9, 1e-6, 0.1])) * rng.normal(size=ideal.shape)
    elif kind == "cloud":
        target = rng.uniform(0, 100, (draw(st.integers(1, 7)), 2))
    else:
        target = rng.integers(0, 3, (draw(st.integers(1, 7)), 2)).astype(float)
    team = draw(st.sampled_from(["random", "noisy", "lattice", "same"]))
    if team == "random":
        return rng.uniform(0, 100, target.shape), target
    if team == "lattice":
        return rng.integers(0, 3, target.shape).astype(float), target
    turned = formations.rotated(target, (50, 50), rng.uniform(0, 7))[rng.permutation(len(target))]
    noise = draw(st.sampled_from([1e-12, 1e-9, 1e-5, 0.1, 3.0, 20.0])) if team == "noisy" else 0.0
    return turned + noise * rng.normal(size=target.shape), target


@settings(max_examples=60)
@given(cases())
def test_no_permutation_and_rotation_is_better(case: tuple[np.ndarray, np.ndarray]) -> None:
    positions, target = case
    error = ShapeTarget(target).error(positions)
    assert abs(error.mean_squared - brute_force(positions, target)) < 1e-9
    # The numbers reported belong to the correspondence and rotation reported.
    assert sorted(error.assignment) == list(range(len(target)))
    assert math.isclose(np.linalg.det(error.rotation), 1.0)
    np.testing.assert_allclose(error.rotation @ error.rotation.T, np.eye(2), atol=1e-12)
    goals = (target - target.mean(axis=0))[list(error.assignment)]
    off = np.linalg.norm((positions - positions.mean(axis=0)) @ error.rotation.T - goals, axis=1)
    np.testing.assert_allclose([error.mean, error.mean_squared], [off.mean(), (off**2).mean()], atol=1e-12)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 30), angle=st.floats(-7, 7), dx=st.floats(-1e3, 1e3))
def test_shape_error_ignores_order_and_pose(seed: int, n: int, angle: float, dx: float) -> None:
    rng = np.random.default_rng(seed)
    ideal = formations.ideal_points("wedge" if n > 2 else "line", n, (50, 50), 10)
    assert ideal is not None
    target = ShapeTarget(ideal)
    team = rng.uniform(0, 100, (n, 2))
    moved = formations.rotated(team[rng.permutation(n)], (0, 0), angle) + (dx, -dx)
    assert abs(target.error(team).mean_squared - target.error(moved).mean_squared) < 1e-6


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(3, 40), turn=st.floats(0, 7))
def test_symmetry_is_a_short_cut_and_nothing_else(seed: int, n: int, turn: float) -> None:
    """A circle whose symmetry is hidden by moving one point a little has nearly the same error."""
    rng = np.random.default_rng(seed)
    circle = formations.ideal_points("circle", n, (50, 50), 10)
    assert circle is not None
    hidden = circle.copy()
    hidden[0, 0] += 1e-8
    assert (formations.rotational_symmetry(circle, 1e-12), formations.rotational_symmetry(hidden, 1e-12)) == (n, 1)
    team = formations.rotated(circle, (50, 50), turn) + rng.normal(0, rng.choice([0.1, 5.0, 50.0]), (n, 2))
    assert math.isclose(
        ShapeTarget(circle).error(team).mean_squared, ShapeTarget(hidden).error(team).mean_squared, abs_tol=1e-5
    )
