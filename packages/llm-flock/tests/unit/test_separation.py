"""Separation at an instant and along the segments of a round."""

import math

import pytest

from llm_flock.metrics import min_separation, segment_separation


def test_separation_of_positions() -> None:
    assert min_separation([(0, 0), (3, 4), (10, 10)]) == 5.0
    assert min_separation([(0, 0, 0), (1, 2, 2)]) == 3.0
    assert min_separation([(0, 0)]) == math.inf


@pytest.mark.parametrize(
    ("before", "after", "nearest"),
    [
        ([(0, 0), (10, 0)], [(10, 0), (0, 0)], 0.0),  # head on: far apart at both ends, together in the middle
        ([(0, 0), (10, 1)], [(10, 0), (0, 1)], 1.0),
        ([(0, 0), (10, 0)], [(0, 0), (4, 0)], 4.0),  # nearest at the end
        ([(0, 0), (4, 0)], [(0, 0), (10, 0)], 4.0),  # nearest at the start
        ([(0, 0), (3, 4)], [(6, 6), (9, 10)], 5.0),  # side by side
        ([(0, 0), (3, 4)], [(0, 0), (3, 4)], 5.0),  # none moves
        ([(0, 0), (10, 10)], [(10, 0), (10, 10)], 10.0),
        ([(0, 0), (0, -4)], [(8, 0), (0, 4)], 4 / math.sqrt(2)),  # through the same place, one after the other
        ([(0, 0, 0), (10, 1, 2)], [(10, 0, 0), (0, 1, 2)], math.sqrt(5)),
    ],
)
def test_separation_along_segments(
    before: list[tuple[float, ...]], after: list[tuple[float, ...]], nearest: float
) -> None:
    assert segment_separation(before, after) == pytest.approx(nearest, abs=1e-12)


def test_separation_of_a_single_robot_is_infinite() -> None:
    assert segment_separation([(0, 0)], [(1, 1)]) == math.inf
