"""What the shield keeps in truth when sensors are wrong and late, up to the bounds that it was told."""

from typing import Any

import numpy as np
import pytest
from effort import cases
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.metrics import segment_separation
from llm_flock.mission import MAX_DOWNWASH, Mission
from llm_flock.runtime._schedule import Sight
from llm_flock.shield import project
from llm_flock.simulate import Readings

SAFE, STEP = 3.0, 6.0


def spread(rng: np.random.Generator, n: int, dim: int, side: float) -> np.ndarray:
    placed = [rng.uniform(0, side, dim)]
    while len(placed) < n:
        draw = rng.uniform(0, side, dim)
        if min(np.linalg.norm(draw - other) for other in placed) >= SAFE:
            placed.append(draw)
    return np.array(placed)


def turned(rng: np.random.Generator, places: np.ndarray, towards: np.ndarray, error: float) -> np.ndarray:
    """Readings off by the whole error: at random, or away from or towards a point, which hides how near others are."""
    way = rng.normal(size=places.shape) if rng.random() < 0.4 else (towards - places) * rng.choice([-1.0, 1.0])
    return places + error * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)


def smallest_true_distance(
    seed: int, n: int, dim: int, error: float, delay: float, sense_range: float, sight: Sight, downwash: float = 1.0
) -> float:
    """The smallest true distance in eighteen rounds of a team whose wishes and errors are against it."""
    rng = np.random.default_rng(seed)
    now, low = spread(rng, n, dim, 13.0 if downwash == 1.0 else 26.0) * ([1, 1, downwash][:dim]), np.inf
    past = [now] * 8
    for number in range(1, 19):
        there, after = int(np.floor(delay)), now.copy()
        seen = past[-1 - there] + (delay - there) * (past[-2 - there] - past[-1 - there])
        if (number - 1) % (1 + sight.rests) == 0:
            wish = rng.uniform(-5, 20, dim)
            for i in range(n):
                own = turned(rng, now[[i]], wish, error)[0]
                others = turned(rng, seen, own, error)
                near = np.linalg.norm(seen - seen[i], axis=1) <= sense_range
                told: Any = [tuple(others[j]) for j in np.flatnonzero(near) if j != i]
                aim = wish if rng.random() < 0.7 else now[rng.integers(n)]
                limits: Any = {"safe_distance": SAFE, "max_step": STEP, "noise_bound": sight.error}
                limits["downwash"] = downwash
                after[i] = now[i] + np.array(project(tuple(own), tuple(aim), told, **limits)) - own
        low = min(low, segment_separation(now, after, downwash=downwash))
        past, now = [*past[1:], after], after
    return low


@cases(25)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(2, 8),
    dim=st.sampled_from([2, 3]),
    error=st.sampled_from([0.0, 0.2, 0.5, 0.75]),
    delay=st.sampled_from([0.0, 0.05, 0.2, 0.5, 0.9, 1.0, 1.4, 3.0]),
    sense_range=st.sampled_from([15.0, 20.0, 30.0]),
)
def test_late_and_wrong_positions_cost_no_separation(
    seed: int, n: int, dim: int, error: float, delay: float, sense_range: float
) -> None:
    sight = Sight.of(Mission(sense_range=sense_range), error, delay)
    assert smallest_true_distance(seed, n, dim, error, delay, sense_range, sight) >= SAFE - 1e-6


@cases(15)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(2, 7),
    downwash=st.sampled_from([2.0, 3.0, MAX_DOWNWASH]),
    error=st.sampled_from([0.0, 0.2, 0.75]),
    delay=st.sampled_from([0.0, 0.05, 0.5, 1.4]),
)
def test_nor_do_they_where_rotors_need_more_height(
    seed: int, n: int, downwash: float, error: float, delay: float
) -> None:
    mission = Mission(shape="sphere", n_robots=12, downwash=downwash, sense_range=2 * STEP + SAFE * downwash + 5)
    sight = Sight.of(mission, error, delay)
    assert smallest_true_distance(seed, n, 3, error, delay, mission.sensing, sight, downwash) >= SAFE - 1e-6


@pytest.mark.parametrize(
    ("error", "delay", "told"),
    [
        (0.0, 1.0, Sight()),
        (0.0, 0.2, Sight()),
        (0.5, 0.0, Sight()),
        (0.5, 0.5, Sight(error=0.5)),
    ],
)
def test_sensors_worse_than_told_cost_separation(error: float, delay: float, told: Sight) -> None:
    """Each part of the bound is needed: without it, bodies come nearer in truth."""
    found = [smallest_true_distance(seed, 6, 2, error, delay, 20.0, told) for seed in range(30)]
    assert min(found) < SAFE - 0.1


@pytest.mark.parametrize("delay", [0.25, 1.0, 1.75])
def test_readings_are_of_where_the_others_were(delay: float) -> None:
    start = np.array([[10.0, 10.0], [20.0, 10.0]])
    readings = Readings(Mission(shape="line", n_robots=2), start, 0.0, np.random.default_rng(0), delay=delay)
    for _ in range(4):
        readings.move(np.array([[0.0, 1.0], [0.0, 2.0]]))
    seen = readings.sense(0)
    assert seen.position == (10.0, 14.0)
    assert seen.sensed[1] == pytest.approx((20.0, 18.0 - 2.0 * delay))


def test_whom_a_late_sensor_sees_is_who_was_in_range() -> None:
    start = np.array([[10.0, 10.0], [30.0, 10.0]])
    readings = Readings(Mission(shape="line", n_robots=2), start, 0.0, np.random.default_rng(0), delay=1.0)
    readings.move(np.array([[0.0, 0.0], [-6.0, 0.0]]))
    assert not readings.sense(0).sensed and readings.in_radio_range[0] == (1,)
    readings.move(np.array([[0.0, 0.0], [0.0, 0.0]]))
    assert readings.sense(0).sensed == {1: (24.0, 10.0)}


def test_drift_wanders_within_its_bound() -> None:
    start = np.array([[10.0, 10.0], [20.0, 10.0]])
    readings = Readings(Mission(shape="line", n_robots=2), start, 0.0, np.random.default_rng(3), drift=0.5)
    offsets = []
    for _ in range(300):
        readings.move(np.zeros((2, 2)))
        offsets.append(np.array(readings.sense(0).position) - start[0])
        assert readings.sense(1).sensed[0] == readings.sense(0).position  # an offset is the same for all who see it
    lengths, steps = np.linalg.norm(offsets, axis=1), np.linalg.norm(np.diff(offsets, axis=0), axis=1)
    assert lengths.max() <= 0.5 + 1e-9 and steps.max() <= 0.05 + 1e-9
    assert lengths.max() > 0.45 and np.ptp(offsets, axis=0).min() > 0.3
