"""Path lengths to a place: straight where it is near, along the formation where it is far."""

import math
from itertools import permutations

import pytest

from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.protocol._path_length import BESIDE, FAR, MAX_PLACES, REACH, next_stop, path_lengths, ways, ways_to

ROW = Plan.of([[0, 0], [10, 0], [20, 0], [30, 0]])


def test_length_to_a_near_place_is_its_distance() -> None:
    assert path_lengths((3.0, 4.0), ROW, [0], 10.0) == pytest.approx([5.0])
    assert path_lengths((12.0, 9.0), ROW, [1], 10.0) == pytest.approx([math.hypot(2.0, 9.0)])


def test_length_of_a_lone_hop_grows_with_its_square() -> None:
    assert path_lengths((-60.0, 0.0), ROW, [0], 10.0) == pytest.approx([60.0 * 60.0 / (REACH * 10.0)])


def test_a_far_place_is_reached_along_the_row() -> None:
    assert path_lengths((0.0, 0.0), ROW, [3], 10.0) == pytest.approx([30.0])


def test_across_a_ring_the_way_follows_it() -> None:
    ring = Plan.of([[100 * math.cos(k * math.tau / 60), 100 * math.sin(k * math.tau / 60)] for k in range(60)])
    chord = math.dist(ring.points[0], ring.points[1])
    assert path_lengths(ring.points[0], ring, [30], chord) == pytest.approx([30 * chord])
    assert path_lengths(ring.points[0], ring, [45], chord) == pytest.approx([15 * chord])


def test_path_lengths_are_the_shortest_of_all_orders_of_places() -> None:
    plan = Plan.of([[0, 0], [13, 4], [22, -9], [40, 1], [47, 20]])

    def hop(a: tuple[float, ...], b: tuple[float, ...]) -> float:
        return math.dist(a, b) * max(1.0, math.dist(a, b) / (REACH * 10.0))

    here = (-8.0, 5.0)
    for slot in range(5):
        others = [a for a in range(5) if a != slot]
        orders = (order for n in range(5) for order in permutations(others, n))
        stops = ([here, *(plan.points[a] for a in order), plan.points[slot]] for order in orders)
        cheapest = min(sum(map(hop, way, way[1:])) for way in stops)
        assert path_lengths(here, plan, [slot], 10.0) == pytest.approx([cheapest])


@pytest.mark.parametrize("obstacles", [(), (Obstacle(center=(5.0, 5.0), radius=2.0),)])
def test_lengths_to_a_few_places_equal_those_to_all_exactly(obstacles: tuple[Obstacle, ...]) -> None:
    plan = Plan.of([[10.0 + 10.0 / (k + 3), 9.0 + k / 7.0] for k in range(30)])
    here = (1 / 3, 2 / 7)
    roadmap = Mission(shape="line", n_robots=4, obstacles=obstacles).roadmap
    assert ways_to(here, plan, range(30), roadmap) == ways(here, plan.array, roadmap).tolist()


def test_in_very_large_plans_the_way_is_straight() -> None:
    row = Plan.of([[10.0 * k, 0.0] for k in range(MAX_PLACES + 1)])
    assert path_lengths((0.0, 0.0), row, [MAX_PLACES], 10.0) == pytest.approx([10.0 * MAX_PLACES])
    assert path_lengths((0.0, 900.0), row, [0], 10.0) == pytest.approx([900.0])


RING = Plan.of([[100 * math.cos(k * math.tau / 60), 100 * math.sin(k * math.tau / 60)] for k in range(60)])
CHORD = math.dist(RING.points[0], RING.points[1])


def test_a_near_place_is_flown_to_straight() -> None:
    assert next_stop(RING.points[0], RING, int(FAR), (0.0, 0.0), CHORD) is None


def test_a_far_place_is_flown_to_beside_the_places_between() -> None:
    stop = next_stop(RING.points[0], RING, 20, (0.0, 0.0), CHORD)
    assert stop is not None
    assert math.hypot(*stop) == pytest.approx(100.0 - BESIDE * CHORD)
    assert min(math.dist(stop, RING.points[k]) for k in (2, 3, 4)) == pytest.approx(BESIDE * CHORD)
    assert math.dist(stop, RING.points[20]) < math.dist(RING.points[0], RING.points[20])


def test_first_place_from_afar_is_where_cheapest_way_begins() -> None:
    stop = next_stop((40.0, 0.0), RING, 15, (0.0, 0.0), CHORD)
    assert stop is not None and stop[0] > 80.0 and 0.0 <= stop[1] < 60.0


def test_place_where_the_cheapest_way_begins_is_flown_straight() -> None:
    assert next_stop((10.0, 0.0), RING, 0, (0.0, 0.0), CHORD) is None


def test_in_plans_of_very_many_places_the_way_is_straight() -> None:
    row = Plan.of([[10.0 * k, 0.0] for k in range(MAX_PLACES + 1)])
    assert next_stop((0.0, 0.0), row, MAX_PLACES, (0.0, 0.0), 10.0) is None


def test_paths_lead_round_obstacles() -> None:
    """A wall between two of four places in a row: the way from one side to the other is longer."""
    row = Plan.of([(20.0 + 10.0 * k, 50.0) for k in range(4)])
    wall = Obstacle(polygon=((34.0, 40.0), (36.0, 40.0), (36.0, 60.0), (34.0, 60.0)))
    roadmap = Mission(shape="line", n_robots=4, obstacles=(wall,), center=(35.0, 80.0)).roadmap
    assert path_lengths((20.0, 50.0), row, [1], 10.0, roadmap) == pytest.approx([10.0])
    (past,) = path_lengths((20.0, 50.0), row, [2], 10.0, roadmap)
    assert past > 2 * math.hypot(15.0, 11.5)
