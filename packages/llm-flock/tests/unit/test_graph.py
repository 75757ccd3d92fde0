"""The disk graph: neighbours within range, influence, connection and diameter."""

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


def test_influence_is_the_share_of_neighbours() -> None:
    """Paper, equation 1: |N_i| / N."""
    assert graph.influence(ROW, 15.0).tolist() == [0.25, 0.5, 0.25, 0.0]
    assert graph.influence(ROW, 100.0).tolist() == [0.75] * 4
    assert graph.influence([(0, 0)], 1.0).tolist() == [0.0]


@pytest.mark.parametrize(
    ("comm_range", "connected", "diameter"),
    [(15.0, False, None), (30.0, True, 2), (29.0, False, None), (60.0, True, 1)],
)
def test_connection(comm_range: float, connected: bool, diameter: int | None) -> None:
    near = graph.adjacency(ROW, comm_range)
    assert graph.is_connected(near) is connected
    assert graph.diameter(near) == diameter
    np.fill_diagonal(near, True)
    assert graph.is_connected(near) is connected
    assert graph.diameter(near) == diameter


def test_one_robot_is_connected() -> None:
    assert graph.is_connected(np.zeros((1, 1), dtype=bool))
    assert graph.diameter(np.zeros((1, 1), dtype=bool)) == 0


def test_a_long_chain_takes_all_its_hops() -> None:
    chain = [(float(k), 0.0) for k in range(30)]
    near = graph.adjacency(chain, 1.0)
    assert graph.is_connected(near)
    assert graph.diameter(near) == 29
