"""Walls and obstacles: the whole straight way keeps clear, with exact and with noisy positions."""

import math

import numpy as np
from effort import cases
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle, clearance, segment_clearance
from llm_flock.protocol._motion.projection import static_half_spaces
from llm_flock.shield import project

U_SHAPE = (
    (30.0, 30.0),
    (60.0, 30.0),
    (60.0, 70.0),
    (30.0, 70.0),
    (30.0, 66.0),
    (56.0, 66.0),
    (56.0, 34.0),
    (30.0, 34.0),
)
MISSION = Mission(
    shape="text:anything",
    n_robots=1,
    obstacles=(
        Obstacle(polygon=U_SHAPE),
        Obstacle(polygon=((70.0, 10.0), (90.0, 20.0), (75.0, 25.0))),
        Obstacle(center=(80.0, 60.0), radius=6.0),
    ),
)


def flown(position: tuple[float, ...], wish: tuple[float, ...], noise: float) -> tuple[float, ...]:
    return project(
        position,
        wish,
        (),
        safe_distance=MISSION.safe_distance,
        max_step=MISSION.max_step,
        noise_bound=noise,
        also=lambda longest: static_half_spaces(position, MISSION, max_step=longest, noise_bound=noise),
    )


@cases(15)
@given(seed=st.integers(0, 2**32), noise=st.sampled_from([0.0, 0.1, 0.5]))
def test_no_way_leads_near_an_obstacle_or_out_of_the_arena(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    here = rng.uniform(0, 100, 2)
    while clearance(tuple(here.tolist()), MISSION.obstacles) < MISSION.body_radius:
        here = rng.uniform(0, 100, 2)
    wish = rng.uniform(-20, 120, 2)
    for _ in range(25):
        if rng.random() < 0.2:
            wish = rng.uniform(-20, 120, 2)
        angle = rng.uniform(0, 2 * math.pi)
        seen = here + noise * np.array([math.cos(angle), math.sin(angle)])
        move = np.array(flown(tuple(seen.tolist()), tuple(wish.tolist()), noise)) - seen
        there = here + move
        way = segment_clearance(tuple(here.tolist()), tuple(there.tolist()), MISSION.obstacles)
        assert way >= MISSION.body_radius - 1e-6
        assert there.min() >= -1e-6 and there.max() <= 100 + 1e-6
        assert np.linalg.norm(move) <= MISSION.max_step + 1e-6
        here = there


@cases(10)
@given(seed=st.integers(0, 2**32))
def test_way_leads_back_from_obstacles_and_outside_the_arena(seed: int) -> None:
    rng = np.random.default_rng(seed)
    here: tuple[float, ...] = tuple(rng.uniform(-40, 140, 2).tolist())
    for _ in range(40):
        here = flown(here, tuple(rng.uniform(0, 100, 2).tolist()), 0.0)
    assert clearance(here, MISSION.obstacles) >= MISSION.body_radius - 1e-6
    assert min(here) >= -1e-6 and max(here) <= 100 + 1e-6
