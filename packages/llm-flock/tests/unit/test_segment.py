"""A smooth motion from one point to another, and where a robot stops on it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.robots._base import PEAK_SPEED, Position
from llm_flock.robots._segment import Segment, stopping_point

COORDINATE = st.floats(-3.0, 3.0).map(lambda x: round(x, 3))
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)


def norm(a: Position, b: Position = (0.0, 0.0, 0.0)) -> float:
    return float(np.linalg.norm(np.subtract(a, b)))


@given(POINT, POINT, POINT, POINT, st.floats(0.5, 4.0))
def test_a_segment_keeps_its_ends_and_comes_to_rest(
    start: Position, target: Position, velocity: Position, acceleration: Position, duration: float
) -> None:
    segment = Segment(start=start, target=target, duration_s=duration, velocity=velocity, acceleration=acceleration)
    at, v, a = segment.at(0.0)
    assert np.allclose(at, start) and np.allclose(v, velocity) and np.allclose(a, acceleration, atol=1e-9)
    at, v, a = segment.at(duration * (1 - 1e-9))
    assert np.allclose(at, target, atol=1e-5) and np.allclose(v, 0, atol=1e-4) and np.allclose(a, 0, atol=1e-3)
    assert segment.at(duration + 1.0) == (target, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    # The velocity matches a finite difference of the position.
    t, h = 0.4 * duration, 1e-5 * duration
    before, _, _ = segment.at(t - h)
    after, _, _ = segment.at(t + h)
    _, v, _ = segment.at(t)
    assert np.allclose(np.subtract(after, before) / (2 * h), v, atol=1e-4)


def test_peak_speed_of_a_segment_is_the_one_limits_assume() -> None:
    segment = Segment(start=(0.0, 0.0, 0.0), target=(1.0, 0.0, 0.0), duration_s=2.0)
    speeds = [segment.at(t)[1][0] for t in np.linspace(0, 2, 2001)]
    assert max(speeds) == pytest.approx(PEAK_SPEED / 2.0, abs=1e-9)


@given(st.lists(st.tuples(POINT, POINT), min_size=2, max_size=4), st.floats(0.1, 1.9))
def test_robots_started_together_have_flown_the_same_share(ways: list[tuple[Position, Position]], time: float) -> None:
    shares: list[float] = []
    for start, target in ways:
        at, _, _ = Segment(start=start, target=target, duration_s=2.0).at(time)
        if norm(start, target) > 0.01:
            shares.append(norm(start, at) / norm(start, target))
    assert all(a == pytest.approx(b, abs=1e-6) for a, b in itertools.pairwise(shares))


def test_stopping_point_is_on_the_way_without_turning_back() -> None:
    segment = Segment(start=(0.0, 0.0, 1.0), target=(2.0, 0.0, 1.0), duration_s=4.0)
    for t in np.linspace(0.0, 2.5, 26):
        stop = stopping_point(segment, float(t), 1.0)
        assert stop is not None
        at, velocity, acceleration = segment.at(float(t))
        braking = Segment(start=at, target=stop, duration_s=1.0, velocity=velocity, acceleration=acceleration)
        way = [braking.at(s)[0][0] for s in np.linspace(0, 1, 200)]
        assert max(way) <= 2.0
        assert max(way) - way[-1] < 0.02
    assert stopping_point(segment, 3.5, 1.0) is None
