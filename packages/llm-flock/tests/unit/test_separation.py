"""Separation at an instant and along the segments of a round."""

import math

import pytest

from llm_flock.arrays import flattened, separation
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


def test_heights_count_divided_by_the_downwash() -> None:
    one, other = (1.0, 2.0, 3.0), (4.0, 6.0, 27.0)
    assert separation(one, other, 2.0) == pytest.approx(13.0) == min_separation([one, other], 2.0)
    assert separation(one, other, 1.0) == math.dist(one, other) > separation(one, other, 2.0)
    assert separation(one[:2], other[:2], 1.0) == 5.0
    assert flattened([one, other], 2.0).tolist() == [[1.0, 2.0, 1.5], [4.0, 6.0, 13.5]]
    assert flattened([], 2.0).size == 0
    under, passing = [(0, 0, 0), (-5, 0, 8)], [(0, 0, 0), (5, 0, 8)]
    assert segment_separation(under, passing, downwash=2.0) == pytest.approx(4.0)


def test_separation_of_a_single_robot_is_infinite() -> None:
    assert segment_separation([(0, 0)], [(1, 1)]) == math.inf
