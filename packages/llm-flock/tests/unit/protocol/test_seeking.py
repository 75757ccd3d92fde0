"""Where a robot without a plan waits to be found."""

from __future__ import annotations

import math

import pytest

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol._membership.search import ALONE, WAIT, Seeking

SMALL = Mission(shape="triangle", n_robots=3)
MIDDLE = Mission(shape="circle", n_robots=10)
LARGE = Mission(shape="circle", n_robots=30, center=(75, 75), arena=((0, 0), (150, 150)))
WORDS = Mission(shape="text:a cloud", n_robots=3)


def visited(mission: Mission, robot: int, here: Point, rounds: int) -> list[int]:
    """Where it stayed, in order, if nobody is in its way: the index of a place, or -1 for the centre."""
    points = {-1: mission.center, **dict(enumerate(mission.ideal or ()))}
    seeking, stays = Seeking(robot), list[int]()
    for _ in range(rounds):
        target = seeking.target(mission, here)
        if target is None:
            near = min(points, key=lambda k: math.dist(points[k], here))
            assert math.dist(points[near], here) <= 0.5 * mission.spacing
            if not stays or stays[-1] != near:
                stays.append(near)
        elif math.dist(here, target) <= mission.max_step:
            here = target
        else:
            share = mission.max_step / math.dist(here, target)
            here = tuple(x + share * (t - x) for x, t in zip(here, target, strict=True))
    return stays


def test_in_a_small_formation_it_waits_at_the_centre() -> None:
    assert visited(WORDS, 1, (5.0, 5.0), 60) == [-1], "nobody knows where its places are"
    seeking = Seeking(1)
    assert {seeking.target(SMALL, (5.0, 5.0)) for _ in range(60)} == {SMALL.center}


def test_seeker_visits_two_places_out_of_hearing_of_the_centre() -> None:
    assert visited(MIDDLE, 3, (5.0, 5.0), 60)[:3] == [-1, 3, 8]


def test_large_formation_is_searched_at_different_places_first() -> None:
    assert visited(LARGE, 0, (10.0, 75.0), 160)[:3] == [0, 15, -1]
    assert visited(LARGE, 20, (10.0, 75.0), 40)[0] == 20


@pytest.mark.parametrize(("liars", "silent", "lost"), [(0, 3, False), (1, 3, False), (2, 2, False), (2, 3, True)])
def test_it_is_out_of_touch_where_liars_could_outweigh_honest(liars: int, silent: int, lost: bool) -> None:
    """Of seven it hears three: if two of these lie, it and the last one are too few to free a place by their words."""
    seeking = Seeking(0, liars)
    for _ in range(ALONE):
        seeking.count(range(1, 7 - silent), range(7 - silent, 7), (), 7)
    assert seeking.lost is lost
    unknown = Seeking(0, liars)
    for _ in range(ALONE):
        unknown.count(range(1, 7 - silent), (), range(7 - silent, 7), 7)
    assert unknown.lost is lost, "whoever was never heard of is no witness either"
    seeking.start_again()
    assert not seeking.lost


def test_it_waits_near_enough_and_longer_each_time() -> None:
    beside = (50.0, 54.9)
    seeking = Seeking(0)
    assert seeking.target(SMALL, beside) is None, "half a spacing is near enough"
    far = Seeking(0)
    targets = [far.target(MIDDLE, (50.0, 50.0)) for _ in range(40)]
    first = next(k for k, target in enumerate(targets) if target is not None)
    assert first == math.ceil(16.2 / 6.0) + WAIT, "it stays for as long as others take, and a little longer"


def test_a_crowd_that_keeps_it_away_does_not_keep_it_for_ever() -> None:
    seeking, away = Seeking(0), (50.0, 70.0)
    targets = [seeking.target(MIDDLE, away) for _ in range(60)]
    assert len({target for target in targets if target is not None}) == 3
