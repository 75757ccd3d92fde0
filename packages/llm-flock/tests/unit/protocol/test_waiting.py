"""Waiting places of spare robots: near the formation and out of the way."""

import math

import pytest

from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.protocol._membership.occupancy import CLEARANCE, sight, waiting_place

MISSION = Mission(shape="line", n_robots=4, places=3)
PLAN = Plan.of(MISSION.ideal or ())


def test_robot_that_blocks_no_place_stays() -> None:
    assert waiting_place(MISSION, (50.0, 60.0), PLAN, []) == (50.0, 60.0)


@pytest.mark.parametrize("here", [PLAN.points[1], (42.0, 51.0), (0.0, 0.0)])
def test_robot_on_a_place_moves_off_it_no_farther_than_it_must(here: tuple[float, ...]) -> None:
    others = [(50.0, 57.0), (50.0, 43.0)]
    place = waiting_place(MISSION, here, PLAN, others)
    assert min(math.dist(place, x) for x in PLAN.points) >= CLEARANCE * MISSION.safe_distance
    assert min(math.dist(place, x) for x in others) >= MISSION.safe_distance
    assert math.dist(place, here) <= 12.0


def test_robot_waiting_for_blocked_places_sees_the_nearest_one() -> None:
    mission = MISSION.change(comm_range=15)
    far, clear = (10.0, 90.0), CLEARANCE * mission.safe_distance
    place = waiting_place(mission, far, PLAN, [], [0, 2])
    assert clear <= math.dist(place, PLAN.points[0]) <= sight(mission)
    assert waiting_place(mission, place, PLAN, [], [0, 2]) == place
    short = MISSION.change(sense_range=9, max_step=2)
    dim = waiting_place(short, (50.0, 50.0 + 11.5), PLAN, [], [1])
    assert clear <= math.dist(dim, PLAN.points[1]) <= sight(short)
    seen = (50.0, 50.0 + sight(mission))
    assert waiting_place(mission, seen, PLAN, [], [1]) == seen
    assert waiting_place(mission, seen, PLAN, [seen], [1]) != seen


def test_walls_and_obstacles_are_kept_clear_of() -> None:
    mission = MISSION.model_copy(update={"obstacles": (Obstacle(center=(50.0, 58.0), radius=3.0),)})
    place = waiting_place(mission, (50.0, 51.0), PLAN, [])
    assert math.dist(place, (50.0, 58.0)) >= 3.0 + mission.body_radius


def test_robot_stays_if_no_waiting_place_is_clear() -> None:
    tight = Mission(shape="line", n_robots=3, places=2, arena=((43, 43), (57, 57)), center=(50, 50), spacing=10)
    others = [(50.0 + x, 50.0 + y) for x in (-6.0, -3.0, 0.0, 3.0, 6.0) for y in (-6.0, -3.0, 3.0, 6.0)]
    here = (50.0, 50.0)
    assert waiting_place(tight, here, Plan.of(tight.ideal or ()), others) == here
