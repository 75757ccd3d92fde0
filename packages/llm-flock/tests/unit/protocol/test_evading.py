"""Robots that step out of the way of moving obstacles, and come back."""

import math
from typing import Any

import numpy as np
import pytest
from rounds import observation

import llm_flock
from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.events import Origin
from llm_flock.mission import Mission
from llm_flock.obstacles import Mover, MovingObstacle
from llm_flock.protocol._motion.leg import Leg
from llm_flock.protocol._motion.projection import moving_half_spaces
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.runtime import build_config

MISSION = Mission(shape="line", n_robots=3)
HOME = (50.0, 50.0)


def seen(x: float, y: float = 50.0, speed: float = 2.0, radius: float = 2.0) -> Mover:
    return Mover(number=0, position=(x, y), radius=radius, speed=speed)


def leg(goal: Point, here: Point) -> Leg:
    return Leg(goal=goal, stop=goal, left=math.dist(here, goal))


@pytest.mark.parametrize("has_goal", [True, False])
def test_robot_in_the_way_steps_aside_and_comes_back(has_goal: bool) -> None:
    safety, here, kinds, origins = ShieldedSafety(0, MISSION, 0.0), HOME, list[str](), list[Origin]()
    for round_ in range(30):
        x = 30.0 + 2.0 * round_
        scene = observation(here, {}, moving=(seen(x),) if abs(x - here[0]) < 15 else ())
        step = safety.step(scene, HOME, leg(HOME, here), 0.5) if has_goal else safety.stay(scene)
        kinds += [note.kind for note in step.notes if note.kind == "evades"]
        assert [dict(note.detail) for note in step.notes if note.kind == "evades"] in ([], [{"obstacle": 0}])
        for share in np.linspace(0.0, 1.0, 11):
            there = np.array(here) + share * (np.array(step.waypoint) - here)
            assert math.dist(there, (x + 2.0 * share, 50.0)) >= 3.5 - 1e-6
        origins.append(step.origin)
        here = step.waypoint
    assert kinds and Origin.YIELD in origins
    assert (math.dist(here, HOME) <= 0.5) is has_goal


def test_robot_waits_until_the_obstacle_ahead_has_crossed() -> None:
    safety, here, goal = ShieldedSafety(0, MISSION, 0.0), (50.0, 40.0), (50.0, 60.0)
    safety.step(observation(here, {}, moving=(seen(40.0),)), here, leg(goal, here), 0.5)
    scene = observation(here, {}, moving=(seen(42.0),))
    step = safety.step(scene, (50.0, 46.0), leg(goal, here), 0.5)
    assert step.origin is Origin.YIELD and step.waypoint[1] < 50.0 - 5.5 + 1e-6
    unaware = ShieldedSafety(0, MISSION, 0.0).step(scene, (50.0, 46.0), leg(goal, here), 0.5)
    assert unaware.origin is Origin.MODEL, "it is out of reach now, but not later"


def test_what_is_known_of_its_course_is_not_noise() -> None:
    """With readings off by half a unit, a shift of one unit says nothing about where it flies."""
    here, goal = (50.0, 40.0), (50.0, 60.0)
    for error, origin in ((0.5, Origin.MODEL), (0.2, Origin.YIELD)):
        safety = ShieldedSafety(0, MISSION, error)
        safety.step(observation(here, {}, moving=(seen(39.0),)), here, leg(goal, here), 0.5)
        step = safety.step(observation(here, {}, moving=(seen(40.0),)), (50.0, 46.0), leg(goal, here), 0.5)
        assert step.origin is origin


def test_others_make_way_for_a_robot_that_has_to_leave() -> None:
    safety = ShieldedSafety(1, MISSION, 0.0)
    for x in (38.0, 40.0):
        scene = observation(HOME, {2: (50.0, 53.0)}, moving=(seen(x),))
        safety.step(scene, HOME, leg(HOME, HOME), 0.5)
    course = safety.course
    assert course is not None and (course.level, course.of) == (15, 1)
    way = [(50.0, 50.0), *course.path]
    assert max(abs(y - 50.0) for _, y in way) > 5.0


@pytest.mark.parametrize("error", [0.0, 0.1])
def test_squeezed_robot_does_not_fly_towards_it(error: float) -> None:
    """Others behind it leave no room to fly back: it is hit by the obstacle's motion, never by its own."""
    behind = {j: (53.0 + 0.2 * error, 50.0 + y) for j, y in ((1, -1.5), (2, 1.5))}
    safety = ShieldedSafety(0, MISSION, error)
    for x in (44.6, 45.0, 46.0):
        step = safety.step(observation(HOME, behind, moving=(seen(x),)), (44.0, 50.0), leg((44.0, 50.0), HOME), 0.5)
        assert step.waypoint[0] >= 50.0 - 1e-6
        assert min(math.dist(step.waypoint, other) for other in behind.values()) >= 2.9


def test_a_robot_in_the_very_middle_of_it_has_no_side() -> None:
    one = {"max_step": 6.0, "horizon": 1.0, "noise_bound": 0.0}
    assert moving_half_spaces(HOME, [seen(50.0)], MISSION, **one) == []
    (side,) = moving_half_spaces(HOME, [seen(48.0)], MISSION, **one)
    assert side.violated and side.room == pytest.approx(2.0 - 3.5 - 2.0) and side.normal == (-1.0, 0.0)
    (unsure,) = moving_half_spaces(HOME, [seen(48.0)], MISSION, **one | {"noise_bound": 0.1})
    assert unsure.room == pytest.approx(side.room - 0.2)
    assert moving_half_spaces(HOME, [seen(30.0)], MISSION, **one) == []


CROSSING: dict[str, Any] = {"center": (0, 50), "radius": 2, "speed": 3, "path": [(100, 50)], "since": 12}


@pytest.mark.no_cover
@pytest.mark.parametrize("model", ["simulated:ideal", "simulated:collapse"])
def test_a_team_forms_again_after_obstacles_have_crossed(model: str) -> None:
    two = [CROSSING, {**CROSSING, "center": (58, 0), "path": [(58, 100)]}]
    result = llm_flock.run(seed=4, model=model, moving_obstacles=two, sense_range=20)
    summary = result.summary
    assert summary.formed and summary.obstacle_violations == 0
    assert (summary.min_clearance or 0.0) >= 1.5 - 1e-6 and (summary.min_separation or 0.0) >= 3.0 - 1e-6
    assert summary.rounds >= 46 and (summary.rounds_to_formed or 0) >= 46, "a crossing undoes the formation"
    one = MovingObstacle(**CROSSING)
    gaps = [np.linalg.norm(row - one.at(k), axis=1).min() for k, row in enumerate(result.positions)]
    assert summary.min_clearance <= min(gaps) - 2.0 + 1e-9


def test_robots_without_the_shield_are_hit() -> None:
    result = llm_flock.run(seed=4, protocol="paper", rounds=46, moving_obstacles=[CROSSING], trace=False)
    assert result.summary.obstacle_violations > 0


def test_starts_are_clear_of_obstacles_that_will_move() -> None:
    wide = {"center": (50, 50), "radius": 30, "speed": 1, "path": [(50, 51)], "since": 100}
    start = llm_flock.run(seed=0, rounds=0, moving_obstacles=[wide], n_robots=20).positions[0]
    assert np.linalg.norm(start - 50.0, axis=1).min() >= 31.5


def test_obstacles_are_seen_as_late_and_as_far_as_robots() -> None:
    from llm_flock.simulate import Readings

    one = MovingObstacle(**{**CROSSING, "since": 0})
    rng, start = np.random.default_rng(0), np.array([[20.0, 50.0], [90.0, 50.0]])
    readings = Readings(Mission(n_robots=2, shape="line"), start, 0.2, rng, delay=1.5, moving=[one])
    for _ in range(3):
        readings.move(np.zeros((2, 2)))
    (mover,) = readings.sense(0).moving
    assert math.dist(mover.position, (4.5, 50.0)) <= 0.2 and mover.position != (4.5, 50.0)
    assert (mover.radius, mover.speed, readings.sense(1).moving) == (2.0, 3.0, ())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"center": (0, 0, 0)}, "2 coordinates"),
        ({"path": [(1, 2, 3)]}, "2 coordinates"),
        ({"path": []}, "at least 1"),
        ({"speed": 0}, "greater than 0|more than 0"),
        ({"speed": 8}, "a speed of at most 7.5"),
        ({"speed": 1e-4}, "by round 100,000"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_obstacles_that_cannot_be_are_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        build_config(moving_obstacles=[{**CROSSING, **change}])
    assert build_config(moving_obstacles=[{**CROSSING, "speed": 8}], shield=False).schedule().crossed == 25
