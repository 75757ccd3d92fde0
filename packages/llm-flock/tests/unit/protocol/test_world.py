"""Plans and the world: places at obstacles, in rooms without an entrance, and geometry that fits its plans in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy
from effort import cases
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion
from llm_flock.protocol._geometry import geometric_plan
from llm_flock.protocol._verification.plans import check_plan, check_proposal
from llm_flock.roadmap import free_regions, region_of


def circle(*obstacles: Any, **fields: Any) -> Mission:
    return Mission(shape="circle", n_robots=10, obstacles=obstacles, **fields)


def disc(x: float, y: float, radius: float) -> Any:
    return {"center": (x, y), "radius": radius}


def box(left: float, low: float, right: float, high: float) -> Any:
    return {"polygon": ((left, low), (right, low), (right, high), (left, high))}


def asked(mission: Mission, position: Point = (90.0, 90.0), **fields: Any) -> PlanQuestion:
    return PlanQuestion(mission=mission, robot=3, round=1, position=position, neighbors=(), **fields)


IDEAL = Plan.of(circle().ideal or ())
FIRST = IDEAL.points[0]


def test_no_place_lies_at_an_obstacle_and_the_reason_says_which() -> None:
    mission = circle(disc(FIRST[0], FIRST[1], 0.5))
    assert check_plan(mission, IDEAL) == (
        f"point 0 is inside the disc around [{FIRST[0]:.4g}, 50], at least 1.5 is required."
    )
    beside = circle(disc(FIRST[0] + 1.7, FIRST[1], 0.5))
    assert check_plan(beside, IDEAL) == (
        f"point 0 is 1.2 from the disc around [{FIRST[0] + 1.7:.4g}, 50], at least 1.5 is required."
    )
    wall = circle(box(FIRST[0] + 1.2, 40, FIRST[0] + 3, 60))
    reason = check_plan(wall, IDEAL)
    assert reason is not None and reason.startswith("point 0 is 1.2 from the polygon with a corner at [")


def test_a_rounded_place_that_a_robot_still_reaches_is_accepted() -> None:
    """A robot stops at 1.5 units from the obstacle, at most a fifth of a unit from its place, and has arrived."""
    gaps = (1.31, 1.29)
    missions = [circle(disc(FIRST[0] + gap + 0.5, FIRST[1], 0.5)) for gap in gaps]
    assert [check_plan(mission, IDEAL) is None for mission in missions] == [True, False]


def test_a_formation_that_travels_passes_obstacles() -> None:
    travels = circle(disc(FIRST[0], FIRST[1], 0.5), velocity=(1.0, 0.0))
    assert check_plan(travels, IDEAL) is None
    answer = geometric_plan(asked(travels))
    assert isinstance(answer, PlanAnswer) and answer.plan == IDEAL


WALL = box(48, 0, 52, 100)
"""From one side of the arena to the other."""


def test_a_plan_on_both_sides_of_a_wall_is_refused() -> None:
    gap = Mission(shape="line", n_robots=2, obstacles=(box(48, 0, 52, 40), box(48, 44, 52, 100)))
    line = Plan.of([(45.0, 50.0), (55.0, 50.0)])
    assert check_plan(gap, line) is None, "a gap of 4 units for bodies of 3"
    # As if it had been made for a team that is there already: such a mission is refused.
    fields = {name: getattr(gap, name) for name in Mission.model_fields}
    fields["obstacles"] = tuple(map(_obstacle, (box(48, 0, 52, 40), box(48, 42.9, 52, 100))))
    closed = Mission.model_construct(**fields)
    assert check_plan(closed, line) == "there is no way from point 0 to point 1: obstacles are in between."


@pytest.mark.parametrize(("width", "passable"), [(2.9, False), (2.9999, False), (3.0001, True), (3.1, True)])
def test_a_gap_is_passable_if_it_is_wider_than_a_body(width: float, passable: bool) -> None:
    mission = Mission(
        shape="line", n_robots=2, center=(25, 50), obstacles=(box(48, 0, 52, 40), box(48, 40 + width, 52, 100))
    )
    assert (len(mission.regions_of([(10.0, 50.0), (90.0, 50.0)])) == 1) is passable


def test_robot_proposes_no_plan_out_of_its_reach() -> None:
    mission = Mission(shape="line", n_robots=2, center=(25, 50), obstacles=(WALL,))
    line = Plan.of(mission.ideal or ())
    assert check_proposal(mission, line, [], (10.0, 10.0)) is None
    assert check_proposal(mission, line, [], (90.0, 10.0)) == (
        "there is no way from [90, 10], where you are, to its points: obstacles are in between."
    )
    assert check_proposal(mission, line, [], (47.5, 10.0)) is None, "a start too near the wall is still on its side"
    answer = geometric_plan(asked(mission, (90.0, 10.0)))
    assert isinstance(answer, NoAnswer) and "there is no way" in answer.reason


def test_geometry_turns_and_shifts_its_plan_until_it_fits() -> None:
    turned = circle(disc(FIRST[0], FIRST[1], 0.5))
    shifted = Mission(
        shape="line", n_robots=2, center=(50, 50), obstacles=tuple(_ring(6.3, 24, 0.2)), safe_distance=2.0
    )
    for mission in (turned, shifted):
        answer = geometric_plan(asked(mission))
        assert isinstance(answer, PlanAnswer) and check_plan(mission, answer.plan) is None
        assert min(clearance(x, mission.obstacles) for x in answer.plan.points) >= mission.body_radius - 1e-6
    assert geometric_plan(asked(turned)) == geometric_plan(asked(turned))


def _ring(radius: float, count: int, size: float) -> list[Any]:
    """Small discs around the centre, with one gap."""
    angles = [2 * math.pi * k / count for k in range(1, count - 1)]
    return [disc(50 + radius * math.cos(a), 50 + radius * math.sin(a), size) for a in angles]


def test_geometry_says_why_nothing_fits() -> None:
    body = asked(circle(), still=tuple(x for x in IDEAL.points))
    crowded = [*_everywhere(), *body.still]
    answer = geometric_plan(asked(circle(), still=tuple(crowded)))
    assert isinstance(answer, NoAnswer) and "the first was refused: point" in answer.reason
    words = geometric_plan(asked(Mission(shape="text:a cloud", n_robots=3)))
    assert isinstance(words, NoAnswer) and "a cloud" in words.reason


def _everywhere() -> list[Point]:
    """Bodies along the circle on which the places lie."""
    radius = math.dist(FIRST, (50.0, 50.0))
    angles = np.linspace(0, 2 * math.pi, 60, endpoint=False).tolist()
    return [(50 + radius * math.cos(a), 50 + radius * math.sin(a)) for a in angles]


def test_a_mission_without_room_is_refused_at_once() -> None:
    with pytest.raises(InputError, match="a way between any two"):
        Mission(shape="line", n_robots=2, obstacles=(box(44, 0, 56, 100),))


def test_in_space_nothing_is_sealed() -> None:
    ball = {"center": (50, 50, 50), "radius": 3}
    space = Mission(points=((0, 0, 0), (20, 0, 0)), center=(50, 50, 50), arena=((0, 0, 0), (99, 99, 99)), spacing=20)
    mission = space.change(obstacles=[ball])
    assert mission.regions_of([(1.0, 1.0, 1.0), (90.0, 90.0, 90.0)]) == frozenset()
    reason = check_plan(mission, Plan.of([(50.0, 50.0, 54.0), (50.0, 50.0, 46.0)]))
    assert reason is not None and "from the ball around [50, 50, 50]" in reason


SIDE = 24
"""Sides of the field on which regions are compared with a grid of four cells a unit."""

WAYS = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)])


@pytest.mark.no_cover
@cases(40)
@given(
    discs=st.lists(
        st.tuples(st.floats(0, 24), st.floats(0, 24), st.floats(0.3, 4.0)).map(lambda d: disc(*d)), max_size=9
    )
)
def test_regions_agree_with_a_flood_of_a_grid(discs: list[Any]) -> None:
    """What a flood over free cells connects is one region; a grid may miss a narrow gap, but never make a way."""
    arena, radius = ((0.0, 0.0), (24.0, 24.0)), 1.0
    shapes = Mission(
        shape="line", n_robots=1, arena=((0, 0), (24, 24)), center=(12, 12), spacing=2, safe_distance=2
    ).model_copy(update={"obstacles": tuple(map(_obstacle, discs))})
    regions = free_regions(arena, shapes.obstacles, radius)
    line = np.linspace(0.0, float(SIDE), 4 * SIDE + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    free = np.ones(x.shape, dtype=bool)
    for d in discs:
        free &= np.hypot(x - d["center"][0], y - d["center"][1]) - d["radius"] >= radius + line[1]
    rooms, count = scipy.ndimage.label(free)
    for room in range(1, count + 1):
        inside = np.argwhere(rooms == room)
        # Its outermost cells in eight directions, and one in ten of all.
        cells = [*(inside[np.argmax(inside @ way)] for way in WAYS), *inside[::10]]
        assert len({region_of((float(line[i]), float(line[j])), regions) for i, j in cells}) == 1
    assert region_of((0.0, 0.0), ()) == -1


def _obstacle(fields: dict[str, Any]) -> Any:
    from llm_flock.obstacles import Obstacle

    return Obstacle(**fields)
