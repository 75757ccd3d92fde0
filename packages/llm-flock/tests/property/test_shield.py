"""The safety shield against its proof: no pair ever nearer than the safe distance, and the nearest such waypoint."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from llm_flock.metrics import segment_separation
from llm_flock.shield import project, separation_half_spaces

SAFE, STEP, SENSE = 3.0, 6.0, 15.0


TALL = {2: [1.0], 3: [1.0, 2.0, 3.0, 3.7]}
"""Downwash in the plane and in space."""


def spread(rng: np.random.Generator, n: int, dim: int, side: float, downwash: float = 1.0) -> np.ndarray:
    """Random positions at least SAFE apart."""
    squeeze = np.array([1.0, 1.0, 1.0 / downwash][:dim])
    placed: list[np.ndarray] = []
    while len(placed) < n:
        draw = rng.uniform(0, side, dim)
        if all(np.linalg.norm((draw - other) * squeeze) >= SAFE for other in placed):
            placed.append(draw)
    return np.array(placed)


def in_range(positions: np.ndarray, i: int, downwash: float = 1.0) -> list[tuple[float, ...]]:
    return [
        tuple(positions[j])
        for j in range(len(positions))
        if j != i and np.linalg.norm(positions[j] - positions[i]) <= SENSE + SAFE * (downwash - 1)
    ]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(2, 12), dim=st.sampled_from([2, 3]), side=st.floats(14, 40))
def test_any_wishes_keep_every_pair_at_the_safe_distance(seed: int, n: int, dim: int, side: float) -> None:
    rng = np.random.default_rng(seed)
    limits: Any = {"safe_distance": SAFE, "max_step": STEP, "downwash": float(rng.choice(TALL[dim]))}
    positions = spread(rng, n, dim, side, limits["downwash"])
    for _ in range(6):
        wishes = rng.uniform(-10, side + 10, (n, dim)) if rng.random() < 0.5 else np.tile(positions.mean(0), (n, 1))
        after = np.array(
            [
                project(tuple(at), tuple(wish), in_range(positions, i, limits["downwash"]), **limits)
                for i, (at, wish) in enumerate(zip(positions, wishes, strict=True))
            ]
        )
        assert segment_separation(positions, after, downwash=limits["downwash"]) >= SAFE - 1e-6
        assert np.linalg.norm(after - positions, axis=1).max() <= STEP + 1e-6
        positions = after


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(2, 8), noise=st.floats(0.001, 0.3))
def test_no_pair_comes_too_near_with_bounded_noise(seed: int, n: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    positions = spread(rng, n, 2, 16.0)

    def reading(x: np.ndarray) -> np.ndarray:
        angle = rng.uniform(0, 2 * math.pi)
        return x + noise * np.array([math.cos(angle), math.sin(angle)])

    for _ in range(6):
        moved = positions.copy()
        for i in range(n):
            own = reading(positions[i])
            others = [tuple(reading(positions[j])) for j in range(n) if j != i]
            target = project(tuple(own), (8.0, 8.0), others, safe_distance=SAFE, max_step=STEP, noise_bound=noise)
            moved[i] = positions[i] + (np.array(target) - own)
        assert segment_separation(positions, moved) >= SAFE - 1e-6
        positions = moved


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(2, 9), dim=st.sampled_from([2, 3]))
def test_the_projection_is_the_nearest_safe_waypoint(seed: int, n: int, dim: int) -> None:
    """Against a general-purpose solver of the same convex problem."""
    rng = np.random.default_rng(seed)
    within_cell: Any = {"safe_distance": SAFE, "max_step": STEP, "downwash": float(rng.choice(TALL[dim]))}
    positions = spread(rng, n, dim, 14.0, within_cell["downwash"])
    wish = rng.uniform(-5, 20, dim)
    others = in_range(positions, 0)
    ours = np.array(project(tuple(positions[0]), tuple(wish), others, **within_cell))
    sides = separation_half_spaces(tuple(positions[0]), others, **within_cell)
    want = wish - positions[0]
    limits: list[Any] = [{"type": "ineq", "fun": lambda u: STEP**2 - u @ u, "jac": lambda u: -2 * u}]
    if sides:
        normals = np.array([side.normal for side in sides])
        rooms = np.array([side.room for side in sides])
        limits.append({"type": "ineq", "fun": lambda u: rooms - normals @ u, "jac": lambda u: -normals})
    found = minimize(
        lambda u: float((u - want) @ (u - want)),
        np.zeros(dim),
        jac=lambda u: 2 * (u - want),
        constraints=limits,
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-12},
    )
    within = float(found.x @ found.x) <= STEP**2 + 1e-7
    kept = all(float(np.dot(side.normal, found.x)) <= side.room + 1e-7 for side in sides)
    assume(found.success and within and kept)
    assert float(np.linalg.norm(ours - wish)) <= float(np.linalg.norm(found.x - want)) + 1e-5


def test_a_safe_waypoint_comes_back_untouched() -> None:
    wish = (3.3, 4.4)
    assert project((0.0, 0.0), wish, [(14.0, 0.0)], safe_distance=SAFE, max_step=STEP) is wish


def test_a_long_step_is_clipped() -> None:
    for others in ([], [(40.0, 0.0)]):
        assert project((0.0, 0.0), (48.0, 0.0), others, safe_distance=SAFE, max_step=STEP) == pytest.approx((6.0, 0.0))
    assert separation_half_spaces((0.0, 0.0), [(40.0, 0.0)], safe_distance=SAFE, max_step=STEP) == []


def test_head_on_robots_stop_at_the_safe_distance() -> None:
    left = project((0.0, 0.0), (6.0, 0.0), [(5.0, 0.0)], safe_distance=SAFE, max_step=STEP)
    assert left == pytest.approx((1.0, 0.0))


@pytest.mark.parametrize("dim", [2, 3])
def test_a_robot_in_an_empty_cell_stands_still(dim: int) -> None:
    """Squeezed from both sides closer than the safe distance, no move keeps all sides."""
    own = (0.0,) * dim
    others = [(-1.0, *own[1:]), (1.0, *own[1:])]
    stay = project(own, (5.0, *own[1:]), others, safe_distance=SAFE, max_step=STEP)
    assert stay == pytest.approx(own, abs=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_robot_unable_to_get_clear_in_one_step_backs_off_fully(dim: int) -> None:
    """Half a unit from its neighbour it would have to back off 1.25, but may move 1."""
    own = (0.0,) * dim
    moved = project(own, (5.0, *own[1:]), [(0.5, *own[1:])], safe_distance=SAFE, max_step=1.0)
    assert moved == pytest.approx((-1.0, *own[1:]))


def test_a_robot_too_near_moves_away() -> None:
    moved = project((0.0, 0.0), (5.0, 0.0), [(2.0, 0.0)], safe_distance=SAFE, max_step=STEP)
    assert moved[0] <= -0.5 + 1e-9


def test_a_coincident_body_does_not_break_the_others() -> None:
    moved = project((0.0, 0.0), (6.0, 0.0), [(0.0, 0.0), (5.0, 0.0)], safe_distance=SAFE, max_step=STEP)
    assert moved == pytest.approx((1.0, 0.0))
