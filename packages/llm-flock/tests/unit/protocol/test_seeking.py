"""Where a robot without a plan waits to be found."""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np
import pytest
import scipy

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol._membership.search import ALONE, LONG, WAIT, Seeking, _lanes

SMALL = Mission(shape="triangle", n_robots=3)
MIDDLE = Mission(shape="circle", n_robots=10)
LARGE = Mission(shape="circle", n_robots=30, center=(75, 75), arena=((0, 0), (150, 150)))
WORDS = Mission(shape="text:a cloud", n_robots=3)


def visited(mission: Mission, robot: int, here: Point, rounds: int) -> list[int]:
    """Where it stayed, in order, if no robot is in its way: the index of a place, or -1 for the centre."""
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


def test_seeker_of_a_small_formation_waits_at_the_centre() -> None:
    assert visited(WORDS, 1, (5.0, 5.0), 60) == [-1], "the places of such a shape are unknown"
    seeking = Seeking(1)
    assert {seeking.target(SMALL, (5.0, 5.0)) for _ in range(60)} == {SMALL.center}


def test_seeker_visits_two_places_out_of_hearing_of_the_centre() -> None:
    assert visited(MIDDLE, 3, (5.0, 5.0), 60)[:3] == [-1, 3, 8]


def test_large_formation_is_searched_at_different_places_first() -> None:
    assert visited(LARGE, 0, (10.0, 75.0), 160)[:3] == [0, 15, -1]
    assert visited(LARGE, 20, (10.0, 75.0), 40)[0] == 20


@pytest.mark.parametrize(("liars", "silent", "lost"), [(0, 3, False), (1, 3, False), (2, 2, False), (2, 3, True)])
def test_robot_is_lost_when_liars_could_outnumber_honest(liars: int, silent: int, lost: bool) -> None:
    """Of seven it hears three: if two of these lie, it and the last one are too few to free a place by their words."""
    seeking = Seeking(0, liars)
    for _ in range(ALONE):
        seeking.count(range(1, 7 - silent), range(7 - silent, 7), (), 7)
    assert seeking.lost is lost
    unknown = Seeking(0, liars)
    for _ in range(ALONE):
        unknown.count(range(1, 7 - silent), (), range(7 - silent, 7), 7)
    assert unknown.lost is lost, "a robot that was never heard is no witness either"
    seeking.start_again()
    assert not seeking.lost


def test_seeker_waits_within_half_a_spacing() -> None:
    assert Seeking(0).target(SMALL, (50.0, 54.9)) is None


def test_seeker_waits_longer_at_each_further_point() -> None:
    """It waits for as long as other robots take to the point, and `WAIT` more rounds than at the point before."""
    seeking = Seeking(0)
    targets = [seeking.target(MIDDLE, MIDDLE.center) for _ in range(60)]
    rounds = [len(list(equal)) for _, equal in groupby(targets)]
    radius = max(math.dist(place, MIDDLE.center) for place in MIDDLE.ideal or ())
    near, across = math.ceil(radius / MIDDLE.max_step), math.ceil(2 * radius / MIDDLE.max_step)
    assert rounds[:4] == [near + WAIT, across + 2 * WAIT, across + 3 * WAIT, near + 4 * WAIT]


def test_seeker_moves_on_when_it_cannot_reach_a_point() -> None:
    seeking, away = Seeking(0), (50.0, 70.0)
    targets = [seeking.target(MIDDLE, away) for _ in range(60)]
    assert len({target for target in targets if target is not None}) == 3


@pytest.mark.parametrize(
    "mission",
    [
        SMALL,
        LARGE,
        Mission(n_robots=4, shape="square", comm_range=200.0),
        Mission(n_robots=4, shape="text:a pile", center=(50, 50, 20), arena=((0, 0, 0), (100, 80, 40))),
    ],
)
def test_robot_that_is_alone_for_long_passes_every_point(mission: Mission) -> None:
    seeking, here, flown = Seeking(1), mission.center, list[Point]()
    for _ in range(LONG + 1):
        seeking.count((), (), (0, 2, 3), mission.n_robots)
    for _ in range(900):
        target = seeking.target(mission, here) or here
        share = min(1.0, mission.max_step / max(math.dist(here, target), 1e-9))
        here = tuple(x + share * (t - x) for x, t in zip(here, target, strict=True))
        flown.append(here)
    low, high = mission.arena
    everywhere = np.random.default_rng(0).uniform(low, high, (500, mission.dim))
    assert scipy.spatial.distance.cdist(everywhere, np.array(flown)).min(axis=1).max() <= mission.comm_range


def test_robots_alone_fly_over_the_arena_in_opposite_directions() -> None:
    seekers = [Seeking(0), Seeking(1)]
    ends = list[Point | None]()
    for seeking in seekers:
        for _ in range(LONG + 1):
            seeking.count((), (), (0, 1, 2), 3)
        targets = [seeking.target(SMALL, SMALL.center) for _ in range(60)]
        ends.append(next(point for point in targets if point not in (None, SMALL.center)))
    assert ends[0] != ends[1] and math.dist(ends[0] or (), ends[1] or ()) > SMALL.comm_range


def test_lanes_keep_clear_of_obstacles() -> None:
    walled = Mission(n_robots=3, shape="triangle", obstacles=({"center": (12, 8), "radius": 6},))  # pyright: ignore[reportArgumentType]
    assert 0 < len(_lanes(walled)) < len(_lanes(SMALL))
