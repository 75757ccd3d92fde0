"""Where robots start: given, or drawn in the arena or a part of it."""

from typing import Any

import numpy as np
import pytest
from command_line import typed

import llm_flock
from llm_flock import graph
from llm_flock.errors import InputError
from llm_flock.metrics import min_separation
from llm_flock.simulate import draw_start

TEAM = llm_flock.Mission(n_robots=10)
CROWD = llm_flock.Mission(n_robots=30)
TRIANGLE = llm_flock.Mission(shape="triangle", n_robots=3)
AREA = ((10.0, 20.0), (30.0, 40.0))


def test_given_starts_are_taken_or_refused() -> None:
    mission = llm_flock.Mission(shape="line", n_robots=2)
    result = llm_flock.run(mission, start_positions=((1, 2), (30, 40)), rounds=1)
    assert result.positions[0].tolist() == [[1, 2], [30, 40]]
    with pytest.raises(InputError, match="start_positions"):
        llm_flock.run(mission, start_positions=((1, 2),), rounds=1)
    for outside in ((30, 100.5), (-0.5, 40)):
        with pytest.raises(InputError, match=r"start_positions = .* inside the arena .*robot 1 is not"):
            llm_flock.run(mission, start_positions=((0, 100), outside), rounds=1)


def test_separated_starts_keep_safe_distance_uniform_may_not() -> None:
    near = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        assert min_separation(draw_start(TEAM, "separated", rng)) >= TEAM.safe_distance
        near += min_separation(draw_start(TEAM, "uniform", np.random.default_rng(seed))) < TEAM.safe_distance
    assert near > 10


def test_connected_starts_are_in_radio_contact_and_apart() -> None:
    low, high = CROWD.arena
    for seed in range(20):
        starts = draw_start(CROWD, "connected", np.random.default_rng(seed))
        assert min_separation(starts) >= CROWD.safe_distance and (starts >= low).all() and (starts <= high).all()
        near = graph.neighbors(starts, CROWD.comm_range)
        met = [0]
        for robot in met:
            met.extend(j for j in near[robot] if j not in met)
        assert len(met) == CROWD.n_robots
    assert min_separation(draw_start(CROWD, "connected", np.random.default_rng(0))) < CROWD.comm_range


def test_an_area_is_typed_as_two_corners() -> None:
    assert typed("--start-area", "20,30,60,70") == {"start_area": ((20.0, 30.0), (60.0, 70.0))}
    assert typed("--start-area", "1,2,3,4,5,6") == {"start_area": ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))}
    with pytest.raises(InputError, match="start_area"):
        llm_flock.run(rounds=0, model="geometry", **typed("--start-area", "20,30,60"))


def test_starts_are_drawn_in_an_area() -> None:
    low, high = AREA
    for start in ("separated", "uniform", "connected"):
        result = llm_flock.run(TRIANGLE, rounds=0, start=start, start_area=AREA, model="geometry")
        assert ((result.positions[0] >= low) & (result.positions[0] <= high)).all()


@pytest.mark.parametrize(
    "area", [((10, 20), (10, 40)), ((10, 20), (30, 140)), ((1, 1, 1), (9, 9, 9)), ((10, 20), (11, 21))]
)
def test_an_area_outside_the_arena_or_without_room_is_refused(area: Any) -> None:
    with pytest.raises(InputError, match=r"start_area|n_robots"):
        llm_flock.run(TRIANGLE, rounds=0, start_area=area, model="geometry")
