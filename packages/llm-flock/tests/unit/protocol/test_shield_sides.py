"""Sides of cells, case by case; what holds for all of them is in the property tests."""

import math

import pytest

from llm_flock.protocol._motion.projection import HalfSpace, nearest_move
from llm_flock.protocol._motion.shield_async import Sighting, project_async
from llm_flock.shield import project, separation_half_spaces

AHEAD = (1.0, 0.0, 0.0)


def test_move_keeping_a_side_in_space_is_within_the_limit() -> None:
    side = HalfSpace(AHEAD, -1.0)
    assert nearest_move((0.0, 2.0, 0.0), [side], 6.0) == pytest.approx((-1.0, 2.0, 0.0))
    move = nearest_move((0.0, 9.0, 0.0), [side], 6.0)
    assert move == pytest.approx((-1.0, math.sqrt(35.0), 0.0), abs=1e-6)
    move = nearest_move((3.0, 9.0, 0.0), [HalfSpace(AHEAD, 1.0)], 6.0)
    assert move == pytest.approx((1.0, math.sqrt(35.0), 0.0), abs=1e-6)


def test_in_space_a_wish_that_keeps_all_sides_is_granted() -> None:
    assert nearest_move((-2.0, 1.0, 0.5), [HalfSpace(AHEAD, -1.0)], 6.0) == (-2.0, 1.0, 0.5)


def test_a_body_on_the_own_spot_gives_no_side() -> None:
    here = (1.0, 2.0)
    assert separation_half_spaces(here, [here], safe_distance=3.0, max_step=6.0) == []
    others = [here, (4.0, 2.0), (90.0, 2.0)]
    assert len(separation_half_spaces(here, others, safe_distance=3.0, max_step=6.0)) == 1


def test_walls_are_sides_too() -> None:
    def wall(longest: float) -> list[HalfSpace]:
        return [HalfSpace((1.0, 0.0), min(2.0, longest))]

    assert project((0.0, 0.0), (5.0, 0.0), [], safe_distance=3.0, max_step=6.0) == (5.0, 0.0)
    assert project((0.0, 0.0), (5.0, 0.0), [], safe_distance=3.0, max_step=6.0, also=wall) == pytest.approx((2.0, 0.0))


def reached(other: Sighting, goal: float) -> float:
    """How far a robot at the origin may fly along the first axis."""
    to = project_async((0.0, 0.0), (goal, 0.0), [other], safe_distance=3.0, speed=2.0, period_s=0.5)
    assert to[1] == pytest.approx(0.0)
    return to[0]


def test_old_sighting_leaves_only_standing_still() -> None:
    assert reached(Sighting(position=(4.0, 0.0), age_s=2.0), 9.0) == 0.0


def test_far_body_gives_no_side_near_one_leaves_rest_of_way() -> None:
    assert reached(Sighting(position=(5.5, 0.0), age_s=0.0), 9.0) == 1.0
    assert reached(Sighting(position=(4.5, 0.0), age_s=0.0), 9.0) == pytest.approx(0.5)


def test_robot_may_only_move_away_from_one_that_is_too_near() -> None:
    near = Sighting(position=(2.0, 0.0), age_s=0.0)
    assert reached(near, 9.0) == pytest.approx(-0.5)
    assert reached(near, -9.0) == pytest.approx(-1.0)
