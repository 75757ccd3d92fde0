"""Obstacles: what is refused, how far away they are, and that convex pieces are the polygon."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llm_flock.errors import InputError
from llm_flock.mission import Mission, build_mission
from llm_flock.obstacles import Obstacle, clearance, contains, cross, is_simple, segment_clearance, signed_area

U_SHAPE = ((0.0, 0.0), (10.0, 0.0), (10.0, 8.0), (8.0, 8.0), (8.0, 2.0), (2.0, 2.0), (2.0, 8.0), (0.0, 8.0))
SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))


def star(seed: int) -> tuple[tuple[float, float], ...]:
    """A random simple polygon around the origin, in either orientation."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 14))
    angles = 2 * math.pi * (np.arange(n) + rng.uniform(0.1, 0.9, n)) / n
    radii = rng.uniform(1, 10, n)
    corners = tuple((float(r * math.cos(a)), float(r * math.sin(a))) for a, r in zip(angles, radii, strict=True))
    return corners if seed % 2 else corners[::-1]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_pieces_are_convex_and_make_up_the_polygon(seed: int) -> None:
    corners = star(seed)
    if not is_simple(corners):
        return  # three corners need not go round the origin
    obstacle = Obstacle(polygon=corners)
    area = abs(signed_area(corners))
    assert sum(signed_area(piece) for piece in obstacle.pieces) == pytest.approx(area)
    for piece in obstacle.pieces:
        turns = [cross(piece[k - 2], piece[k - 1], piece[k]) for k in range(len(piece))]
        assert min(turns) >= 0.0
    rng = np.random.default_rng(seed)
    for x, y in rng.uniform(-11, 11, (20, 2)).tolist():
        inside = any(contains(piece, (x, y)) for piece in obstacle.pieces)
        assert (obstacle.distance((x, y)) < 0) == inside
        nearest = min(obstacle.nearest((x, y)), key=lambda found: found.distance)
        assert nearest.distance == pytest.approx(obstacle.distance((x, y)))
        foot = (x - nearest.distance * nearest.outward[0], y - nearest.distance * nearest.outward[1])
        assert abs(obstacle.distance(foot)) < 1e-9


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_the_distance_of_a_way_is_that_of_its_nearest_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = star(seed)
    if not is_simple(corners):
        return
    ball = Obstacle(center=(1.0, -2.0), radius=2.0)
    for obstacle in (Obstacle(polygon=corners), ball):
        start, end = rng.uniform(-12, 12, (2, 2))
        sampled = min(obstacle.distance(tuple((start + s * (end - start)).tolist())) for s in np.linspace(0, 1, 160))
        exact = obstacle.segment_distance(tuple(start.tolist()), tuple(end.tolist()))
        assert exact <= max(sampled, 0.0) + 1e-9
        # Samples are at most 0.11 from the nearest point of the way.
        assert exact >= sampled - 0.11 if sampled > 0.0 else exact <= 0.0


def test_a_convex_polygon_is_one_piece_and_a_u_is_three() -> None:
    assert len(Obstacle(polygon=SQUARE).pieces) == len(Obstacle(polygon=SQUARE[::-1]).pieces) == 1
    assert len(Obstacle(polygon=U_SHAPE).pieces) == 3
    assert len(Obstacle(polygon=((0, 0), (5, 0), (10, 0), (10, 1), (0, 1))).pieces) == 1


def test_clearance_of_points_and_ways() -> None:
    both = (Obstacle(center=(0.0, 0.0), radius=2.0), Obstacle(polygon=((10.0, -1.0), (12.0, -1.0), (11.0, 5.0))))
    assert clearance((5.0, 0.0), both) == pytest.approx(3.0)
    assert clearance((1.0, 0.0), both) == pytest.approx(-1.0)
    assert clearance((5.0, 0.0), ()) == math.inf
    assert segment_clearance((-5.0, 3.0), (5.0, 3.0), both) == pytest.approx(1.0)
    assert segment_clearance((5.0, 0.0), (20.0, 0.0), both) == 0.0
    assert segment_clearance((11.0, 0.0), (20.0, 0.0), both) < 0.0


def test_there_is_a_way_out_from_the_boundary_and_the_centre() -> None:
    (on_side,) = Obstacle(polygon=SQUARE).nearest((2.0, 1.0))
    assert (on_side.distance, on_side.outward) == (0.0, (1.0, 0.0))
    (middle,) = Obstacle(center=(5.0, 5.0), radius=2.0).nearest((5.0, 5.0))
    assert (middle.distance, middle.outward) == (-2.0, (1.0, 0.0))


@pytest.mark.parametrize(
    ("obstacle", "field", "words"),
    [
        ({"center": (1, 1)}, "obstacles", "either center and radius, or polygon"),
        ({"center": (1, 1), "radius": 1, "polygon": SQUARE}, "obstacles", "either"),
        ({}, "obstacles", "either"),
        ({"center": (1, 1), "radius": 0}, "obstacles.0.radius", "more than 0"),
        ({"center": (1, math.nan), "radius": 1}, "obstacles.0.center.1", "finite"),
        ({"center": (1, 1, 1), "radius": 1}, "obstacles", "2 coordinates"),
        ({"polygon": SQUARE[:2]}, "obstacles", "3 or more corners"),
        ({"polygon": ((0, 0), (1, 1), (2, 2))}, "obstacles", "an area"),
        ({"polygon": ((0, 0), (2, 2), (2, 0), (0, 2))}, "obstacles", "cross themselves"),
        ({"polygon": ((0, 0), (4, 0), (4, 4), (2, 0), (0, 4))}, "obstacles", "cross themselves"),
        ({"polygon": ((0, 0), (4, 0), (2, 0), (2, 3))}, "obstacles", "cross themselves"),
        ({"polygon": ((0, 0), (4, 0), (4, 0), (2, 3))}, "obstacles", "cross themselves"),
        ({"center": (50, 50), "radius": 30}, "obstacles", "at least safe_distance / 2 = 1.5"),
        ({"colour": "red"}, "obstacles.0.colour", "unknown field 'colour' in obstacles.0"),
    ],
)
def test_bad_obstacles_are_refused(obstacle: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        build_mission(obstacles=[obstacle])
    assert caught.value.field == field
    assert words in caught.value.says


def test_more_than_can_be_examined_in_a_round_is_refused_at_once() -> None:
    """20,000 corners took longer than anybody waited."""
    with pytest.raises(InputError, match="at most 128 corners"):
        Obstacle(polygon=tuple((float(k), float(k * k % 997)) for k in range(20_000)))
    disc = {"center": (5.0, 5.0), "radius": 0.1}
    with pytest.raises(InputError, match=r"501 obstacles with 0 corners.*at most 500 obstacles"):
        build_mission(obstacles=[disc] * 501)
    ring = [(5 + math.cos(k / 16), 5 + math.sin(k / 16)) for k in range(100)]
    with pytest.raises(InputError, match=r"1100 corners.*at most 1,024 corners in all"):
        build_mission(obstacles=[{"polygon": ring}] * 11)


def test_a_mission_takes_obstacles_that_leave_its_shape_room() -> None:
    inside = build_mission(obstacles=[{"center": (50, 50), "radius": 5}])
    assert inside.digest != Mission().digest
    assert build_mission(**inside.model_dump()) == inside
    # In the reference orientation a robot of the triangle would stand on it.
    corner = Mission(shape="triangle", n_robots=3).ideal
    assert corner is not None
    build_mission(shape="triangle", n_robots=3, obstacles=[{"center": corner[0], "radius": 1}])
    build_mission(shape="text:a smile", n_robots=3, obstacles=[{"center": (50, 50), "radius": 40}])
