"""Moving obstacles: what a robot keeps in truth from one that chases it, whatever it knows late or wrongly."""

import math
from typing import Any

import numpy as np
import pytest
from effort import cases
from hypothesis import assume, given
from hypothesis import strategies as st

from llm_flock.metrics import passing_distances, segment_separation
from llm_flock.mission import Mission
from llm_flock.obstacles import Mover, MovingObstacle
from llm_flock.protocol._motion.leg import Leg
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.protocol._parts import Observation
from llm_flock.runtime._schedule import Sight

WIDE = Mission(n_robots=2, shape="line", center=(500.0, 500.0), arena=((0.0, 0.0), (1000.0, 1000.0)), sense_range=60.0)
STEP, BODY = WIDE.max_step, WIDE.body_radius


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def around(rng: np.random.Generator, point: np.ndarray, error: float) -> tuple[float, ...]:
    return tuple((point + error * unit(rng.normal(size=2))).tolist())


def chase(
    seed: int, robots: int, obstacles: int, radius: float, speed: float, error: float = 0.0, delay: float = 0.0
) -> tuple[float, float, float]:
    """Robots that want to fly through obstacles, which chase them at their largest speed, for thirty rounds.

    Returns the smallest true distance from surface to centre while bodies fly, that at the ends of rounds before
    robots fly again, and the smallest true separation of robots.
    """
    rng = np.random.default_rng(seed)
    sight = Sight.of(WIDE, error, delay)
    team = [ShieldedSafety(k, WIDE, sight.error, delay=delay, rests=sight.rests) for k in range(robots)]
    now = np.array([500.0, 500.0]) + 5.0 * np.array([[k, 0.0] for k in range(robots)])
    far = radius + BODY + (speed * (2.0 + sight.rests + delay)) + 2 * error + rng.uniform(0.0, 5.0)
    angles = rng.uniform(0, 2 * math.pi, obstacles)
    places = now.mean(axis=0) + (far + 5.0 * robots) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    seen, on_way, at_end, apart = [places] * 8, math.inf, math.inf, math.inf
    for number in range(1, 31):
        late, after = math.floor(delay), now.copy()
        old = seen[-1 - late] + (delay - late) * (seen[-2 - late] - seen[-1 - late])
        for k, safety in enumerate(team):
            if safety.rests(number):
                continue
            here = around(rng, now[k], error)
            movers = tuple(
                Mover(number=m, position=around(rng, place, error), radius=radius, speed=speed)
                for m, place in enumerate(old)
            )
            others: Any = {j: around(rng, now[j], error) for j in range(robots) if j != k}
            wish = tuple((now[k] + STEP * unit(places[rng.integers(obstacles)] - now[k])).tolist())
            leg = Leg(goal=wish, stop=wish, left=STEP)
            scene = Observation(round=number, position=here, sensed=others, moving=movers)
            after[k] = now[k] + np.array(safety.step(scene, wish, leg, 0.1).waypoint) - np.array(here)
            assert np.linalg.norm(after[k] - now[k]) <= STEP + 1e-6
        aims = [after[rng.integers(robots)] + rng.choice([0.0, 1.0]) * rng.normal(size=2) for _ in places]
        there = np.array([x + speed * unit(aim - x) for x, aim in zip(places, aims, strict=True)])
        for before, behind in zip(places, there, strict=True):
            on_way = min(on_way, float(passing_distances(now, after, before, behind).min()) - radius)
        apart = min(apart, segment_separation(now, after))
        now, places, seen = after, there, [*seen[1:], there]
        if all(not safety.rests(number + 1) for safety in team):
            at_end = min(at_end, min(float(np.linalg.norm(now - x, axis=1).min()) for x in places) - radius)
    return on_way, at_end, apart


@cases(30)
@given(seed=st.integers(0, 2**32), radius=st.floats(0.5, 8.0), share=st.floats(0.1, 1.0))
def test_a_robot_keeps_clear_of_whatever_chases_it_no_faster(seed: int, radius: float, share: float) -> None:
    on_way, at_end, _ = chase(seed, 1, 1, radius, share * STEP)
    assert min(on_way, at_end) >= BODY - 1e-6


@cases(30)
@given(
    seed=st.integers(0, 2**32),
    error=st.sampled_from([0.0, 0.1, 0.3]),
    delay=st.sampled_from([0.0, 0.1, 0.5, 1.0, 2.0]),
    share=st.floats(0.1, 1.0),
)
def test_late_and_wrong_readings_of_it_are_allowed_for(seed: int, error: float, delay: float, share: float) -> None:
    sight, radius = Sight.of(WIDE, error, delay), 3.0
    # Wherever the robot may believe the obstacle to be, it has to be able to fly back far enough in one step.
    speed = share * (STEP - 2.0 * sight.error - 2.0 * error) / (1 + sight.rests + 2 * delay)
    assume(speed >= 0.05)
    on_way, at_end, _ = chase(seed, 1, 1, radius, speed, error, delay)
    assert at_end >= BODY - 1e-6
    assert on_way >= BODY - 2.0 * (speed * delay + 2.0 * error) - 1e-6


@cases(15)
@given(seed=st.integers(0, 2**32), speed=st.floats(1.0, 12.0))
def test_hunted_robots_never_come_too_near_to_each_other(seed: int, speed: float) -> None:
    """Several fast obstacles hit robots; their separation is kept all the same."""
    assert chase(seed, 3, 3, 2.0, speed)[2] >= WIDE.safe_distance - 1e-6


def test_faster_obstacles_do_reach_robots() -> None:
    """The condition on the speed is needed."""
    assert min(min(chase(seed, 1, 1, 2.0, 1.5 * STEP)[:2]) for seed in range(5)) < BODY - 0.5


def test_an_obstacle_flies_its_path_at_its_speed() -> None:
    one = MovingObstacle(center=(0.0, 0.0), radius=1.0, speed=2.0, path=((5.0, 0.0), (5.0, 4.0)), since=3)
    assert [one.at(time) for time in (-2.0, 0.0, 3.0)] == [(0.0, 0.0)] * 3
    assert one.at(4.5) == pytest.approx((3.0, 0.0)) and one.at(5) == pytest.approx((4.0, 0.0))
    assert one.at(6) == pytest.approx((5.0, 1.0)) and one.at(5.5) == pytest.approx((4.5, 0.5))
    assert one.end == 7.5 and one.at(8) == one.at(100) == (5.0, 4.0)
    steps = [math.dist(one.at(t / 4), one.at((t + 1) / 4)) for t in range(40)]
    assert max(steps) <= 0.5 + 1e-9
