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
        ({"n_robots": 0}, "n_robots", "greater than or equal to 1"),
        ({"n_robots": -3}, "n_robots", "greater than or equal to 1"),
        ({"n_robots": 2.5}, "n_robots", "integer"),
        ({"spacing": math.nan}, "spacing", "finite"),
        ({"spacing": math.inf}, "spacing", "finite"),
        ({"spacing": 0}, "spacing", "greater than or equal to 0.001"),
        ({"spacing": 9e-4, "safe_distance": 9e-4}, "spacing", "greater than or equal to 0.001"),
        ({"safe_distance": 9e-4}, "safe_distance", "greater than or equal to 0.001"),
        ({"comm_range": 1e-5}, "comm_range", "greater than or equal to 0.001"),
        ({"sense_range": 1e-300}, "sense_range", "greater than or equal to 0.001"),
        ({"center": (50, -1.1e6)}, "center.1", "greater than or equal to -1000000"),
        ({"arena": ((0, 0), (100, 1e7))}, "arena.1.1", "less than or equal to 1000000"),
        ({"points": ((0, 0), (1e300, 0))}, "points.1.0", "less than or equal to 1000000"),
        ({"points": 5}, "points", "valid tuple"),
        ({"points": [1, 2]}, "points.0", "valid tuple"),
        ({"points": "ab"}, "points", "valid tuple"),
        ({"points": []}, "points", "at least one point"),
        ({"n_robots": 2001}, "n_robots", "less than or equal to 2000"),
        ({"spacing": 2.9}, "spacing", "at least safe_distance = 3"),
        ({"max_step": -1}, "max_step", "greater than or equal to 0.001"),
        ({"center": (50, math.nan)}, "center.1", "finite"),
        ({"center": (50,)}, "center", "2 or 3 coordinates"),
        ({"center": (150, 50)}, "center", "inside the arena"),
        ({"arena": ((0, 0), (100, 0))}, "arena", "lower < upper"),
        ({"arena": ((0, 0, 0), (100, 100, 100))}, "arena", "two corners of 2 numbers"),
        ({"shape": "blob"}, "shape", "circle"),
        ({"shape": "triangle", "n_robots": 4}, "n_robots", "divisible by 3"),
        ({"shape": "square", "n_robots": 6}, "n_robots", "divisible by 4"),
        ({"shape": "circle", "n_robots": 60}, "arena", "at least 95.5"),
        ({"n_robots": 600}, "n_robots", "at most"),
        ({"shape": "points"}, "points", "shape 'points'"),
        ({"points": ((0, 0), (1, 1)), "n_robots": 2}, "shape", "at least safe_distance = 3"),
        ({"points": ((0, 0, 0), (9, 9, 9)), "n_robots": 2}, "points", "2 coordinates in each row"),
        ({"points": ((0, 0), (9, 9)), "n_robots": 3}, "n_robots", "2"),
        ({"colour": "red"}, "colour", "not permitted"),
    ],
)
def test_bad_values_name_field_value_and_what_is_allowed(fields: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        build_mission(**fields)
    assert caught.value.field == field
    assert words in caught.value.allowed
    assert str(caught.value).startswith(f"{field} = ")


def test_the_defaults_are_the_papers() -> None:
    mission = Mission()
    assert (mission.spacing, mission.safe_distance, mission.max_step, mission.comm_range) == (10, 3, 6, 15)
    assert mission.arena == ((0, 0), (100, 100)) and mission.center == (50, 50)


def test_a_mission_is_frozen_and_its_digest_is_its_content() -> None:
    mission = Mission()
    with pytest.raises(ValidationError):
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
