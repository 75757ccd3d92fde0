"""What a mission refuses, and that it says field, value and what is allowed."""

import math
from typing import Any

import pytest
from pydantic import ValidationError

from llm_flock.errors import InputError
from llm_flock.mission import Mission, build_mission


@pytest.mark.parametrize(
    ("fields", "field", "words"),
    [
        ({"n_robots": 0}, "n_robots", "at least 1"),
        ({"n_robots": -3}, "n_robots", "at least 1"),
        ({"n_robots": 2.5}, "n_robots", "whole number"),
        ({"spacing": math.nan}, "spacing", "finite"),
        ({"spacing": math.inf}, "spacing", "finite"),
        ({"spacing": 0}, "spacing", "at least 0.001"),
        ({"spacing": 9e-4, "safe_distance": 9e-4}, "spacing", "at least 0.001"),
        ({"safe_distance": 9e-4}, "safe_distance", "at least 0.001"),
        ({"comm_range": 1e-5}, "comm_range", "at least 0.001"),
        ({"sense_range": 1e-300}, "sense_range", "at least 0.001"),
        ({"center": (50, -1.1e6)}, "center.1", "at least -1000000"),
        ({"arena": ((0, 0), (100, 1e7))}, "arena.1.1", "at most 1000000"),
        ({"points": ((0, 0), (1e300, 0))}, "points.1.0", "at most 1000000"),
        ({"points": 5}, "points", "a list"),
        ({"points": [1, 2]}, "points.0", "a list"),
        ({"points": "ab"}, "points", "a list"),
        ({"points": []}, "points", "at least one point"),
        ({"n_robots": 2001}, "n_robots", "at most 2000"),
        ({"spacing": 2.9}, "spacing", "at least safe_distance = 3"),
        ({"max_step": -1}, "max_step", "at least 0.001"),
        ({"center": (50, math.nan)}, "center.1", "finite"),
        ({"center": (50,)}, "center", "2 or 3 coordinates"),
        ({"center": (150, 50)}, "center", "inside the arena"),
        ({"arena": ((0, 0), (100, 0))}, "arena", "lower < upper"),
        ({"arena": ((0, 0, 0), (100, 100, 100))}, "arena", "two corners of 2 numbers"),
        ({"shape": "blob"}, "shape", "circle"),
        ({"shape": "triangle", "n_robots": 4}, "n_robots", "a triangle takes 3, 6, 9, 12, ... robots"),
        ({"shape": "square", "n_robots": 6}, "n_robots", "a square takes 4, 8, 12, 16, ... robots"),
        ({"shape": "circle", "n_robots": 60}, "arena", "at least 95.5"),
        ({"n_robots": 600}, "n_robots", "at most"),
        ({"shape": "points"}, "points", "the shape is 'points'"),
        ({"points": ((0, 0), (1, 1)), "n_robots": 2}, "shape", "at least safe_distance = 3"),
        ({"points": ((0, 0, 0), (9, 9, 9)), "n_robots": 2}, "points", "2 coordinates in each row"),
        ({"points": ((0, 0), (9, 9)), "n_robots": 3, "places": 4}, "places", "2"),
        ({"places": 0}, "places", "at least 1"),
        ({"n_robots": 4, "places": 94}, "places", "at most 93 for 4 robots"),
        ({"shape": "triangle", "n_robots": 3, "places": 4}, "places", "a triangle takes 3, 6, 9, 12, ... places"),
        ({"shape": "circle", "n_robots": 3, "places": 60}, "arena", "of 60 places"),
        ({"velocity": (1, 2, 3)}, "velocity", "2 numbers"),
        ({"velocity": (3, 0.1)}, "velocity", "at most max_step / 2 = 3 per round"),
        ({"velocity": (math.nan, 0)}, "velocity.0", "finite"),
        ({"since": -1}, "since", "at least 0"),
        ({"colour": "red"}, "colour", "unknown field 'colour'; expected one of shape, n_robots"),
    ],
)
def test_bad_values_name_field_value_and_what_is_allowed(fields: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        build_mission(**fields)
    assert caught.value.field == field
    assert words in caught.value.says
    assert str(caught.value).startswith((f"{field} = ", f"{field}: ", f"unknown field '{field}'"))


def test_the_defaults_are_the_papers() -> None:
    mission = Mission()
    assert (mission.spacing, mission.safe_distance, mission.max_step, mission.comm_range) == (10, 3, 6, 15)
    assert mission.arena == ((0, 0), (100, 100)) and mission.center == (50, 50)


def test_a_mission_is_frozen_and_its_digest_is_its_content() -> None:
    mission = Mission()
    with pytest.raises(ValidationError, match="frozen"):
        mission.n_robots = 3
    assert mission.digest == Mission().digest != Mission(n_robots=9).digest
    assert len(mission.digest) == 16


def test_the_shield_needs_to_see_far_enough() -> None:
    Mission().check_sensing()
    with pytest.raises(InputError, match=r"sense_range = 14.9.*at least safe_distance \+ 2 \* max_step = 15"):
        Mission(sense_range=14.9).check_sensing()
    with pytest.raises(InputError, match="sense_range"):
        Mission(comm_range=10).check_sensing()
    Mission(comm_range=10, sense_range=15).check_sensing()


def test_downwash_makes_the_safe_distance_an_ellipsoid() -> None:
    sphere, tall = (Mission(shape="sphere", n_robots=12, downwash=downwash) for downwash in (1.0, 2.0))
    assert sphere == Mission(shape="sphere", n_robots=12) != tall
    assert "downwash" not in sphere.model_dump() and build_mission(**tall.model_dump()) == tall
    assert (tall.separation((50, 50, 40), (50, 50, 50)), tall.height_apart) == (5.0, 6.0)
    assert tall.start_volume(1) == pytest.approx(2 * sphere.start_volume(1))
    with pytest.raises(InputError, match=r"sense_range = 15.*safe_distance \* downwash \+ 2 \* max_step = 18"):
        tall.check_sensing()
    tall.change(sense_range=18).check_sensing()


def test_downwash_is_refused_where_it_cannot_be_kept() -> None:
    with pytest.raises(InputError, match=r"downwash = 2.*1 in the plane"):
        build_mission(downwash=2)
    with pytest.raises(InputError, match=r"downwash = 4.*at most 3\.7"):
        build_mission(shape="sphere", n_robots=12, downwash=4)
    tower: dict[str, Any] = {"points": [[0, 0, 0], [0, 0, 5]], "center": [50] * 3, "arena": [[0] * 3, [100] * 3]}
    build_mission(**tower)
    with pytest.raises(InputError, match=r"3 apart \(with differences of z divided by 2\), not 2\.5"):
        build_mission(**tower, downwash=2)


def test_points_say_how_many_and_where() -> None:
    mission = build_mission(points=((0, 0), (10, 0), (5, 9)))
    assert (mission.shape, mission.n_robots) == ("points", 3)
    assert mission.ideal is not None and sum(x for x, _ in mission.ideal) == pytest.approx(150)


def test_free_text_has_no_ideal() -> None:
    assert build_mission(shape="text:a smiling face", n_robots=12).ideal is None


def test_three_dimensions_are_taken_with_given_points() -> None:
    mission = build_mission(
        points=((0, 0, 0), (10, 0, 0), (0, 10, 5)), center=(50, 50, 50), arena=((0, 0, 0), (100, 100, 100))
    )
    assert mission.dim == 3 and mission.ideal is not None and len(mission.ideal[0]) == 3


def test_the_shape_goes_by_places_and_the_team_by_robots() -> None:
    spares, gaps = Mission(n_robots=5, places=3), Mission(n_robots=3, places=5)
    assert (Mission().n_places, spares.n_places, gaps.n_places) == (10, 3, 5)
    for mission in (spares, gaps):
        assert mission.ideal is not None and len(mission.ideal) == mission.n_places
    three = build_mission(points=((0, 0), (10, 0), (5, 9)), n_robots=5)
    assert (three.n_robots, three.n_places) == (5, 3)
    assert build_mission(points=((0, 0), (10, 0), (5, 9)), places=3).n_robots == 3


def test_moving_centre_is_given_for_the_end_of_a_round() -> None:
    mission = Mission(shape="line", n_robots=3, velocity=(2, -1), since=5)
    assert mission.ideal is not None and mission.digest
    assert mission.drift(0) == mission.drift(5) == (0, 0)
    assert mission.drift(9) == (8, -4)
    later = mission.at(9)
    assert later.center == (58, 46) and (later.velocity, later.since) == ((2, -1), 9)
    assert later.digest != mission.digest and later == Mission(**later.model_dump()) and later.at(9) == later
    assert later.ideal is not None and later.ideal[1] == (58, 46)
    assert later.at(11).center == mission.at(11).center == (62, 44)
    assert mission.at(3) == mission
    still = Mission()
    assert still.at(100) is still and still.drift(100) == (0, 0)


def test_formation_stops_as_a_whole_before_touching_a_wall() -> None:
    mission = Mission(shape="line", n_robots=3, velocity=(2, 0))  # reaches 10 to both sides
    assert mission.drift(19) == (38, 0) and mission.drift(20) == mission.drift(1000) == (40, 0)
    assert mission.at(1000).center == (90, 50)
    assert mission.at(1000) == mission.at(20) and mission.at(20).velocity is None
    assert Mission(shape="line", n_robots=3, velocity=(2, -2.2)).drift(1000) == pytest.approx((40 / 1.1, -40))
    words = Mission(shape="text:a heap", n_robots=3, velocity=(0, -2.5))
    assert words.at(1000).center == (50, 0)
    assert Mission(velocity=(0, 0)).at(7).center == (50, 50)


def test_a_mission_is_resized_where_the_shape_allows_it() -> None:
    mission = Mission(shape="square", n_robots=8)
    four = mission.resized(4)
    assert (four.n_robots, four.n_places) == (8, 4) and mission.resized(8) is mission
    assert four.resized(8) == mission and four.resized(8).digest == mission.digest
    with pytest.raises(InputError, match="places = 6: a square takes 4, 8, 12, 16"):
        mission.resized(6)
    with pytest.raises(InputError, match="arena"):
        mission.resized(80)
    passing = mission.change(obstacles=[{"center": (80, 50), "radius": 6}], velocity=(2, 0)).at(15)
    assert passing.resized(4).n_places == 4, "that obstacles are in the way now is no matter of size"


def test_a_changed_mission_is_validated_as_a_whole() -> None:
    mission = Mission(n_robots=4)
    assert mission.change(shape="square", center=(60, 50)) == Mission(shape="square", n_robots=4, center=(60, 50))
    custom = mission.change(points=((0, 0), (10, 0)))
    assert (custom.shape, custom.n_robots, custom.n_places) == ("points", 4, 2)
    assert custom.change(points=((0, 0), (10, 0), (20, 0), (30, 0))).places is None
    assert custom.change(shape="circle").points is None
    with pytest.raises(InputError, match="a triangle takes 3, 6"):
        mission.change(shape="triangle")
    with pytest.raises(InputError, match="center"):
        mission.change(center=(99, 50))


def test_an_unknown_field_is_named_in_one_line() -> None:
    with pytest.raises(InputError, match=r"^unknown field 'sh\\+npe'; did you mean 'shape'\?$"):
        build_mission(**{"sh\npe": "circle"})
