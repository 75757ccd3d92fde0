"""Checks of a plan: objections with numbers, tolerance for rounded coordinates, and the class."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.distance import pdist

from llm_flock import shapes as formations
from llm_flock.formation import parse_program, program_points
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Drawing, Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion
from llm_flock.protocol._parts import Checker
from llm_flock.protocol._verification.plans import PlanClass, blocked_within, check_plan, check_proposal, plan_class
from llm_flock.protocol._verification.validator import Validator

SQUARE = Mission(shape="square", n_robots=8)
TEXT = Mission(shape="text:a ring", n_robots=4)


def ideal(mission: Mission, angle_rad: float = 0.0) -> np.ndarray:
    return formations.rotated(mission.ideal or (), mission.center, angle_rad)


def plan(points: Any) -> Plan:
    return Plan.of(np.asarray(points).tolist())


LEGAL = [
    ("triangle", 3), ("triangle", 6), ("square", 8), ("cross", 5), ("circle", 10), ("circle", 2), ("line", 6),
    ("wedge", 7), ("grid", 11), ("star", 10), ("polygon:5", 10),
]  # fmt: skip


@pytest.mark.parametrize(("shape", "n"), LEGAL)
@pytest.mark.parametrize("order", ["given", "shuffled"])
def test_every_shape_passes_turned_and_rounded_to_two_decimals(shape: str, n: int, order: str) -> None:
    mission = Mission(shape=shape, n_robots=n)
    rng = np.random.default_rng(3)
    for angle in np.linspace(0, 2 * math.pi, 7):
        points = ideal(mission, float(angle)).round(2)
        candidate = plan(points if order == "given" else rng.permutation(points))
        assert check_plan(mission, candidate) is None
        assert plan_class(mission, candidate) is PlanClass.EXACT


def test_places_above_each_other_are_farther_apart() -> None:
    tower: dict[str, Any] = {"center": (50,) * 3, "arena": ((0,) * 3, (100,) * 3), "n_robots": 2, "downwash": 2}
    mission = build_mission(shape="text:a tower", spacing=5, **tower)
    flat, high = plan([[47.5, 50, 50], [52.5, 50, 50]]), plan([[50, 50, 47.5], [50, 50, 52.5]])
    assert check_plan(mission, flat) is None and check_plan(mission.change(downwash=1), high) is None
    assert check_plan(mission, high) == (
        "points 0 and 1 are 2.5 apart (with differences of z divided by 2), at least 3 is required."
    )
    said = check_proposal(mission, flat, still=[(47.5, 50, 55)], position=(50, 50, 50))
    assert said is not None and said.startswith("point 0 is 2.5 from the robot that stands still")
    assert check_proposal(mission, flat, still=[(47.5, 50, 57)], position=(50, 50, 50)) is None


def test_whole_numbers_pass_mostly_and_are_of_a_lower_class() -> None:
    mission = Mission(shape="circle", n_robots=10)
    plans = [plan(ideal(mission, angle).round(0)) for angle in np.linspace(0, 0.6, 40)]
    classes = [plan_class(mission, p) for p in plans]
    assert classes.count(PlanClass.ACCEPTABLE) >= 30 and PlanClass.EXACT not in classes


def test_an_objection_names_the_fault_its_size_and_the_limit() -> None:
    points = ideal(SQUARE)
    moved = points.copy()
    moved[7] = moved[3] + (1.9, 0.0)
    assert check_plan(SQUARE, plan(points[:7])) == "the plan holds 7 points, 8 are required."
    off = check_plan(SQUARE, plan(points + (3.0, 4.0)))
    assert off == "the mean of its points is [53, 54], 5 away from [50, 50], where it must be."
    text = Mission(shape="text:a mess", n_robots=8)
    moved += np.array([50.0, 50.0]) - moved.mean(axis=0)
    assert check_plan(text, plan(moved)) == "points 3 and 7 are 1.9 apart, at least 3 is required."
    wide = check_plan(SQUARE, plan(50 + (points - 50) * 1.2))
    assert wide == "the point nearest to point 0 is point 1, 12 away; from 9 to 11 is required."
    far = Mission(shape="square", n_robots=8, arena=((35, 35), (65, 65)))
    shifted = points + (6.0, 0.0)
    outside = check_plan(far, plan(shifted))
    assert outside is not None and outside.endswith("is at [66, 60], outside the arena from [35, 35] to [65, 65].")


def test_the_right_spacing_in_another_shape_is_refused() -> None:
    line = Mission(shape="line", n_robots=8, arena=((0, 0), (100, 100)))
    reason = check_plan(SQUARE, plan(ideal(line)))
    assert reason is not None and "off the shape on average, 0.5 is the limit: this is not square" in reason
    assert plan_class(SQUARE, plan(ideal(line))) is PlanClass.REFUSED


def test_a_distorted_plan_is_refused() -> None:
    """The paper's first failure: stretched axes and normal noise of a fifth of the spacing."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        points = 50 + (ideal(SQUARE) - 50) * rng.uniform(0.6, 1.4, 2) + rng.normal(0, 2, (8, 2))
        assert check_plan(SQUARE, plan(points)) is not None


def test_points_of_another_dimension_or_not_finite_are_refused() -> None:
    points = ideal(SQUARE).tolist()
    assert check_plan(SQUARE, Plan.of([[*row, 0.0] for row in points])) == "point 0 has 3 numbers, 2 are required."
    points[2][1] = math.nan
    reason = check_plan(SQUARE, Plan.of(points))
    assert reason is not None and reason.startswith("point 2 is [") and "finite" in reason


def test_coincident_points_are_named() -> None:
    text = Mission(shape="text:a heap", n_robots=3)
    reason = check_plan(text, plan([[45.0, 50.0], [45.0, 50.0], [60.0, 50.0]]))
    assert reason == "points 0 and 1 are 0 apart, at least 3 is required."


def test_free_text_is_checked_by_spacing_and_centre_not_exact() -> None:
    ring = 50 + 10 / math.sqrt(2) * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    assert check_plan(TEXT, plan(ring)) is None and plan_class(TEXT, plan(ring)) is PlanClass.ACCEPTABLE
    assert check_plan(TEXT, plan(50 + (ring - 50) * 2)) is not None


def test_given_points_are_compared_with_themselves_not_spacing() -> None:
    mission = build_mission(points=((0, 0), (4, 0), (0, 25)), spacing=10.0)
    assert check_plan(mission, plan(ideal(mission, 1.0).round(2))) is None
    assert check_plan(mission, plan(50 + (ideal(mission) - 50) * 1.3)) is not None


def test_rounding_is_forgiven_where_spacing_is_safe_distance() -> None:
    mission = Mission(shape="circle", n_robots=7, spacing=3.0)
    assert all(check_plan(mission, plan(ideal(mission, a).round(2))) is None for a in np.linspace(0, 1, 20))


def with_room(mission: Mission, points: Any, verify: bool = True) -> Plan:
    """A plan as a robot proposes it after its model has answered with these points."""
    question = PlanQuestion(mission=mission, robot=0, round=1, position=(5.0, 5.0), neighbors=())
    validator = Validator(shield_on=True) if verify else Checker()
    answer = PlanAnswer(plan=plan(points), slot=0)
    proposed = validator.plan(question, answer)
    assert not isinstance(proposed, NoAnswer)
    return proposed.plan


@pytest.mark.parametrize("angle", [0.1, 0.7, 1.0])
def test_plan_rounded_too_tight_is_enlarged_before_proposal(angle: float) -> None:
    mission = Mission(shape="grid", n_robots=16, spacing=3.0)
    rounded = ideal(mission, angle).round(2)
    assert pdist(rounded).min() < 3.0
    proposed = with_room(mission, rounded)
    assert 3.0 <= pdist(proposed.array).min() < 3.0001
    assert np.abs(proposed.array - rounded).max() < 0.02
    assert proposed.array.mean(axis=0) == pytest.approx(rounded.mean(axis=0))
    assert with_room(mission, proposed.array) == proposed
    assert with_room(mission, rounded, verify=False) == plan(rounded)


def test_plan_with_or_without_room_to_grow_is_unchanged() -> None:
    for mission in (Mission(shape="grid", n_robots=16, spacing=3.01), Mission(shape="line", n_robots=1, spacing=3.0)):
        rounded = ideal(mission).round(2)
        assert with_room(mission, rounded) == plan(rounded)
    between_walls = Mission(shape="line", n_robots=3, spacing=3.0, arena=((46.99, 0.0), (53.01, 100.0)))
    tight = plan([(46.94, 50.0), (50.0, 50.0), (52.95, 50.0)])
    assert check_plan(between_walls, tight) is None
    assert with_room(between_walls, tight.array) == tight


def test_space_and_a_single_robot() -> None:
    corners = ((0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10))
    space = build_mission(points=corners, center=(50, 50, 50), arena=((0, 0, 0), (100, 100, 100)))
    assert plan_class(space, plan(space.ideal)) is PlanClass.EXACT
    one = Mission(shape="line", n_robots=1)
    assert plan_class(one, plan([[50.0, 50.1]])) is PlanClass.ACCEPTABLE
    assert check_plan(one, plan([[50.0, 51.0]])) is not None


@pytest.mark.parametrize("shape", ["circle", "square", "grid"])
def test_plan_of_a_hundred_robots_is_checked_fast_in_any_order(shape: str) -> None:
    mission = Mission(shape=shape, n_robots=100, center=(300, 300), arena=((0, 0), (600, 600)))
    points = np.random.default_rng(1).permutation(formations.rotated(mission.ideal or (), (300, 300), 1.0)).round(2)
    assert plan_class(mission, plan(points)) is PlanClass.EXACT


def test_a_plan_has_as_many_places_as_the_mission_asks_for() -> None:
    mission = Mission(shape="square", n_robots=6, places=4)
    assert mission.ideal is not None
    assert check_plan(mission, Plan.of(mission.ideal)) is None
    assert "4 are required" in (check_plan(mission, Plan.of(SQUARE.ideal or ())) or "")


def test_a_proposal_keeps_its_places_off_bodies_that_stand_still() -> None:
    here = plan(ideal(SQUARE))
    x, y = here.points[3]
    reach = blocked_within(SQUARE)
    assert reach == pytest.approx(2.5)
    fault = check_proposal(SQUARE, here, [(x + 1.0, y)], (5.0, 5.0))
    assert fault is not None and fault.startswith("point 3 is 1 from the robot that stands still at")
    assert check_proposal(SQUARE, here, [(x + reach + 0.01, y)], (5.0, 5.0)) is None
    assert check_proposal(SQUARE, plan(ideal(SQUARE)[:7]), [], (5.0, 5.0)) == "the plan holds 7 points, 8 are required."


def test_the_plan_of_a_program_is_checked_by_its_points() -> None:
    mission = Mission(shape="text:a kite", n_robots=4)
    kite = parse_program({"draw": [{"points": [[0, 0], [2, 3], [0, 5], [-2, 3]], "closed": True}]})
    points = program_points(kite, 4, 2, mission.spacing) + np.array(mission.center)
    drawn = Drawing(program=kite.text, places=4, spacing=mission.spacing, center=mission.center)
    assert Plan(drawing=drawn).points == Plan.of(points.tolist()).points
    assert check_plan(mission, Plan(drawing=drawn)) is None
    assert "away from [50, 50]" in str(check_plan(mission, Plan(drawing=replace(drawn, center=(9.0, 50.0)))))
    assert "apart, at least 3" in str(check_plan(mission, Plan(drawing=replace(drawn, scale=0.1))))
    turned = Plan(drawing=replace(drawn, turn_rad=np.pi))
    assert np.allclose(turned.array, 100.0 - points, atol=1e-6)


def test_parts_of_a_described_shape_may_be_apart() -> None:
    pairs = [(45.0, 50.0), (55.0, 50.0), (45.0, 64.0), (55.0, 64.0)]
    centred = plan(np.array(pairs) - np.array([0.0, 7.0]))
    assert check_plan(TEXT, centred) is None
    spread = plan((np.array(pairs) - np.array([50.0, 57.0])) * 1.6 + np.array([50.0, 50.0]))
    assert "from 9 to 15 is required" in str(check_plan(TEXT, spread))
