"""The disk graph: neighbours within range, and connection."""

import numpy as np
import pytest

from llm_flock import graph

ROW = [(0.0, 0.0), (10.0, 0.0), (20.0, 0.0), (50.0, 0.0)]


def test_distances_are_symmetric_in_any_dimension() -> None:
    rows = np.random.default_rng(1).uniform(0, 100, (20, 3))
    apart = graph.distances(rows)
    np.testing.assert_array_equal(apart, apart.T)
    np.testing.assert_allclose(apart[3, 7], np.linalg.norm(rows[3] - rows[7]))
    assert graph.distances([(1, 2)]).tolist() == [[0.0]]


def test_neighbours_are_within_range_and_never_oneself() -> None:
    assert graph.neighbors(ROW, 15.0) == ((1,), (0, 2), (1,), ())
    assert graph.neighbors(ROW, 10.0) == ((1,), (0, 2), (1,), ())  # the range itself is within range
    assert graph.neighbors(ROW, 9.999) == ((), (), (), ())
    assert not graph.adjacency(ROW, 100.0).diagonal().any()


@pytest.mark.parametrize(("comm_range", "connected"), [(15.0, False), (30.0, True), (29.0, False), (60.0, True)])
def test_connection(comm_range: float, connected: bool) -> None:
    near = graph.adjacency(ROW, comm_range)
    assert graph.is_connected(near) is connected
    np.fill_diagonal(near, True)
    assert graph.is_connected(near) is connected


def test_one_robot_is_connected() -> None:
    assert graph.is_connected(np.zeros((1, 1), dtype=bool))


def test_a_long_chain_is_connected() -> None:
    assert graph.is_connected(graph.adjacency([(float(k), 0.0) for k in range(30)], 1.0))
