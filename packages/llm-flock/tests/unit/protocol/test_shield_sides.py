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


@pytest.mark.parametrize(("downwash", "height", "out_of_step"), [(1.0, 2.5, 0.5), (2.0, 1.0, 0.0)])
def test_above_each_other_robots_keep_more_distance(downwash: float, height: float, out_of_step: float) -> None:
    """Both may use half of what is left: of 8 - 3, or of 8 - 2 * 3 with the downwash."""
    here, aside, above = (0.0, 0.0, 0.0), (8.0, 0.0, 0.0), (0.0, 0.0, 8.0)
    up = project(here, (0.0, 0.0, 6.0), [above], safe_distance=3.0, max_step=6.0, downwash=downwash)
    assert up == pytest.approx((0.0, 0.0, height))
    side = project(here, (6.0, 0.0, 0.0), [aside], safe_distance=3.0, max_step=6.0, downwash=downwash)
    assert side == pytest.approx((2.5, 0.0, 0.0))
    seen = [Sighting(position=above, age_s=0.0)]
    to = project_async(here, (0.0, 0.0, 4.0), seen, safe_distance=3.0, speed=0.5, period_s=9.0, downwash=downwash)
    assert to == pytest.approx((0.0, 0.0, out_of_step))


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
