"""Ways round obstacles: clear of them, as short as can be, and none where there is none."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle, clearance, segment_clearance
from llm_flock.roadmap import HOP, MARGIN, Roadmap

RADIUS = 1.5
PLANE = ((0.0, 0.0), (100.0, 100.0))
SPACE = ((0.0, 0.0, 0.0), (100.0, 100.0, 100.0))
DISC = Obstacle(center=(50.0, 50.0), radius=10.0)
OUTLINE = ((30, 30), (70, 30), (70, 34), (34, 34), (34, 66), (70, 66), (70, 70), (30, 70))
POCKET = Obstacle(polygon=OUTLINE)
"""Open to the right."""


def wall(x: float, low: float, high: float) -> Obstacle:
    return Obstacle(polygon=((x, low), (x + 3.0, low), (x + 3.0, high), (x, high)))


def way(roadmap: Roadmap, here: Point, goal: Point) -> list[Point]:
    """Every stop from here to the goal."""
    stops = [here]
    while stops[-1] != goal:
        stops.append(roadmap.next_stop(stops[-1], goal))
        assert len(stops) < 60, "it goes round in circles"
    return stops


def flown(stops: list[Point]) -> float:
    return sum(math.dist(a, b) for a, b in itertools.pairwise(stops))


def round_a_disc(here: Point, goal: Point, radius: float) -> float:
    """Length of the shortest way past a disc at (50, 50) from and to points opposite to each other."""
    one, two = math.dist(here, (50.0, 50.0)), math.dist(goal, (50.0, 50.0))
    arc = math.pi - math.acos(radius / one) - math.acos(radius / two)
    return math.sqrt(one**2 - radius**2) + math.sqrt(two**2 - radius**2) + radius * arc


def test_a_clear_way_is_straight() -> None:
    roadmap = Roadmap(PLANE, [DISC], RADIUS)
    assert roadmap.next_stop((10.0, 10.0), (90.0, 10.0)) == (90.0, 10.0)
    assert roadmap.length((10.0, 10.0), (90.0, 10.0)) == 80.0


def test_past_a_disc_the_way_is_the_shortest() -> None:
    here, goal = (20.0, 50.0), (80.0, 50.0)
    exact = Roadmap(PLANE, [DISC], RADIUS, exact=True)
    shortest = round_a_disc(here, goal, 11.5)
    assert exact.length(here, goal) == pytest.approx(shortest, rel=0.004)
    stops = way(Roadmap(PLANE, [DISC], RADIUS), here, goal)
    assert flown(stops) <= 1.03 * shortest and len(stops) <= 5


def test_through_a_gap_out_of_a_pocket_and_through_a_maze() -> None:
    gap = Roadmap(PLANE, [wall(48.0, -1.0, 46.9), wall(48.0, 53.1, 101.0)], RADIUS)
    assert len(way(gap, (20.0, 20.0), (80.0, 60.0))) <= 4
    out = way(Roadmap(PLANE, [POCKET], RADIUS), (45.0, 50.0), (20.0, 50.0))
    assert out[1][0] > 70.0, "first out at the open side"
    maze = Roadmap(PLANE, [wall(20.0, -1.0, 80.0), wall(45.0, 20.0, 101.0), wall(70.0, -1.0, 80.0)], RADIUS)
    stops = way(maze, (5.0, 5.0), (95.0, 5.0))
    assert len(stops) <= 8
    assert maze.length((5.0, 5.0), (95.0, 5.0)) == pytest.approx(flown(stops) + 2.0 * HOP * RADIUS * (len(stops) - 2))


def test_a_corner_that_is_as_good_as_reached_leads_on() -> None:
    roadmap = Roadmap(PLANE, [DISC], RADIUS)
    goal = (70.0, 50.5)
    corner = roadmap.next_stop((30.0, 50.0), goal)
    beside = corner[0] - 0.015, corner[1] - 0.015
    assert corner != goal and roadmap.next_stop(beside, goal) == roadmap.next_stop(corner, goal) != corner


def test_a_wall_across_the_whole_arena_leaves_no_way() -> None:
    roadmap = Roadmap(PLANE, [wall(55, -5, 105)], RADIUS)
    assert roadmap.next_stop((20.0, 50.0), (80.0, 50.0)) == (80.0, 50.0)
    assert roadmap.length((20.0, 50.0), (80.0, 50.0)) == math.inf


def test_a_gap_that_is_too_narrow_is_no_way() -> None:
    narrow = Roadmap(PLANE, [wall(48.0, -1.0, 48.6), wall(48.0, 51.4, 101.0)], RADIUS)
    assert narrow.length((20.0, 50.0), (80.0, 50.0)) == math.inf
    assert narrow.next_stop((20.0, 50.0), (80.0, 50.0)) == (80.0, 50.0)
    lengths = narrow.lengths((20.0, 50.0), np.array([[80.0, 50.0], [20.0, 80.0]]))
    assert lengths.tolist() == [math.inf, 30.0]


def test_lengths_of_ways_from_many_places_to_one() -> None:
    roadmap = Roadmap(PLANE, [DISC], RADIUS)
    starts = np.array([[x, y] for x in (5.0, 35.0, 70.0) for y in (5.0, 50.0, 95.0)])
    for goal in ((80.0, 55.0), (95.0, 5.0)):
        found = roadmap.lengths_to(starts, goal)
        assert found.tolist() == pytest.approx([roadmap.length(tuple(start), goal) for start in starts.tolist()])
    assert roadmap.lengths_to(np.empty((0, 2)), (80.0, 55.0)).shape == (0,)


@pytest.mark.parametrize("off", [0.0, 0.01, 1.0])
def test_a_body_at_a_wall_or_too_near_one_finds_its_way_round(off: float) -> None:
    roadmap = Roadmap(PLANE, [wall(48.0, 20.0, 80.0)], RADIUS)
    here = (48.0 - RADIUS + off, 52.0)
    stops = way(roadmap, here, (70.0, 50.0))
    assert len(stops) <= 4 and stops[1][1] > 80.0


def test_a_goal_inside_an_obstacle_is_headed_for() -> None:
    roadmap = Roadmap(PLANE, [DISC], RADIUS)
    assert roadmap.next_stop((20.0, 50.0), (50.0, 50.0)) == (50.0, 50.0)


def test_round_a_ball_in_space() -> None:
    ball = Obstacle(center=(50.0, 50.0, 50.0), radius=10.0)
    roadmap = Roadmap(SPACE, [ball], RADIUS)
    here, goal = (20.0, 50.0, 50.0), (80.0, 50.0, 50.0)
    stops = way(roadmap, here, goal)
    assert flown(stops) <= 1.06 * round_a_disc(here[:2], goal[:2], 11.5)
    assert min(segment_clearance(a, b, [ball]) for a, b in itertools.pairwise(stops)) >= RADIUS - 1e-6


spots = st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 100.0))
discs = st.lists(st.tuples(spots, st.floats(0.5, 12.0)), min_size=1, max_size=8)


@example(found=[((93.5, 50.0), 8.0)], here=(87.0, 58.0), goal=(65.5, 0.0))
@example(found=[((0.0, 2.0), 1.0), ((0.0, 53.5), 2.0)], here=(0.0, 50.0), goal=(0.0, 58.0))
@example(found=[((0.0, 2.0), 1.0), ((0.0, 60.75), 1.125)], here=(0.0, 58.125), goal=(0.0, 64.0))
@example(found=[((0.0, 2.0), 1.0), ((0.0, 53.5), 2.5)], here=(0.0, 49.0), goal=(0.0, 59.0))
@given(found=discs, here=spots, goal=spots)
def test_every_leg_is_clear_and_no_way_beats_the_straight_line(
    found: list[tuple[Point, float]], here: Point, goal: Point
) -> None:
    obstacles = [Obstacle(center=center, radius=radius) for center, radius in found]
    assume(min(clearance(here, obstacles), clearance(goal, obstacles)) >= RADIUS)
    roadmap = Roadmap(PLANE, obstacles, RADIUS)
    length = roadmap.length(here, goal)
    if not math.isfinite(length):
        assert roadmap.next_stop(here, goal) == goal
        return
    stops = way(roadmap, here, goal)
    legs = list(itertools.pairwise(stops))
    assert all(segment_clearance(a, b, obstacles) >= RADIUS - 1e-6 for a, b in legs)
    assert flown(stops) >= math.dist(here, goal) - 1e-9
    # Every corner counts in the length, also one at either end that is as good as reached and so passed by.
    extra = 2.0 * HOP * RADIUS * len(stops) + 4.0 * MARGIN * RADIUS
    assert flown(stops) <= length + 1e-6 <= flown(stops) + extra + 1e-6
    lengths = roadmap.lengths(here, np.array([goal]))
    assert lengths[0] == pytest.approx(length)
    mission = Mission(shape="text:any", n_robots=1, obstacles=tuple(obstacles))
    shortest = float(mission.shortest_ways(np.array([here]), np.array([goal]))[0, 0])
    assert shortest <= flown(stops) * (1.0 + MARGIN)


@pytest.mark.parametrize("out", [0.0, 0.001, 0.02, 0.1, 0.5, 0.8])
def test_robot_close_to_an_obstacle_finds_a_way_round_it(out: float) -> None:
    disc, apart = Obstacle(center=(50.0, 50.0), radius=10.0), 10.0 + RADIUS + out
    roadmap = Roadmap(PLANE, [disc], RADIUS)
    for k in range(90):
        angle = 2.0 * math.pi * k / 90
        here = (50.0 + apart * math.cos(angle), 50.0 + apart * math.sin(angle))
        goal = (50.0 - 20.0 * math.cos(angle), 50.0 - 20.0 * math.sin(angle))
        stops = way(roadmap, here, goal)
        assert all(segment_clearance(a, b, [disc]) >= RADIUS - 1e-6 for a, b in itertools.pairwise(stops))
        assert flown(stops) <= 1.25 * round_a_disc((50.0 - apart, 50.0), (70.0, 50.0), 10.0 + RADIUS)


def test_without_obstacles_there_is_no_roadmap() -> None:
    assert Mission().roadmap is None
    apart = Mission().shortest_ways(np.array([[0.0, 0.0]]), np.array([[3.0, 4.0], [0.0, 1.0]]))
    assert apart.tolist() == [[5.0, 1.0]]
