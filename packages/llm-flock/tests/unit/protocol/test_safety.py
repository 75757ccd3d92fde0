"""Safe motion of whole teams: what blocks them, what they do about it, and starts that are too near."""

import math

import numpy as np
import pytest
from rounds import observation
from safe_team import SAFE, SafeTeam

from llm_flock.events import Note, Origin
from llm_flock.message import Course
from llm_flock.mission import Mission, build_mission
from llm_flock.obstacles import Obstacle
from llm_flock.protocol._motion.leg import Leg
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.shield import spread_coincident

MISSION = Mission(shape="line", n_robots=3)


def ring(n: int, radius: float, turn: float = 0.0) -> np.ndarray:
    angles = turn + 2 * math.pi * np.arange(n) / n
    return 50 + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def test_room_is_what_others_leave_of_a_straight_step() -> None:
    here, there = (50.0, 50.0), (60.0, 50.0)
    leg = Leg(goal=there, stop=there, left=10.0)

    def room(*bodies: tuple[float, float], courses: dict[int, Course] | None = None) -> float:
        safety, scene = ShieldedSafety(1, MISSION, 0.0), observation(here, dict(enumerate(bodies, 2)))
        if courses:
            safety.step(observation(here, dict(enumerate(bodies, 2)), courses=courses), there, leg, 0.5)
        return safety.room(scene, leg)

    assert room() == pytest.approx(6.0) and room((55.0, 50.0)) == pytest.approx(1.0)
    assert room((47.0, 50.0)) == pytest.approx(6.0), "a body behind leaves all of it"
    assert room((46.0, 50.0), courses={2: Course(level=2, of=0, path=((64.0, 50.0),))}) == 0.0, "it gives way"


@pytest.mark.parametrize("dim", [2, 3])
def test_two_robots_that_meet_head_on_pass_each_other(dim: int) -> None:
    rest = [50.0] * (dim - 1)
    ends = [[20.0, *rest], [80.0, *rest]]
    team = SafeTeam(ends, ends[::-1])
    assert team.fly(30) is not None
    assert team.kinds["deadlock"] == 2 and team.smallest >= SAFE - 1e-6


@pytest.mark.parametrize("n", [3, 4, 5, 6, 8])
def test_ring_swapping_places_across_the_middle_comes_through(n: int) -> None:
    starts = ring(n, 20.0)
    team = SafeTeam(starts, 100 - starts)
    assert team.fly(60) is not None
    assert team.smallest >= SAFE - 1e-6


def test_through_a_ring_that_stands_around_the_goal() -> None:
    """Straight ahead stands one of six that do not move."""
    stands = ring(6, 10.0)
    team = SafeTeam([[80.0, 50.0], *stands], [[50.0, 50.0], *stands])
    assert team.fly(40) is not None
    assert team.kinds["deadlock"] >= 1 and team.smallest >= SAFE - 1e-6


def test_three_bodies_in_contact_change_places() -> None:
    touching = ring(3, SAFE / math.sqrt(3))
    team = SafeTeam(touching, np.roll(touching, 1, axis=0))
    assert team.fly(60) is not None
    assert team.smallest >= SAFE - 1e-6


@pytest.mark.parametrize(
    "obstacle",
    [
        Obstacle(center=(50.0, 50.0), radius=6.0),
        Obstacle(polygon=((48.0, 30.0), (52.0, 30.0), (52.0, 70.0), (48.0, 70.0))),
        Obstacle(
            polygon=(
                (30.0, 30.0),
                (60.0, 30.0),
                (60.0, 70.0),
                (30.0, 70.0),
                (30.0, 66.0),
                (56.0, 66.0),
                (56.0, 34.0),
                (30.0, 34.0),
            )
        ),
    ],
    ids=["disc", "wall", "dead-end"],
)
def test_round_an_obstacle_exactly_in_line(obstacle: Obstacle) -> None:
    start = [40.0, 50.0]
    team = SafeTeam([start], [[80.0, 50.0]], obstacle)
    assert team.fly(60) is not None
    assert team.kinds["deadlock"] == 0
    assert team.clearance >= SAFE / 2 - 1e-6


def test_between_two_discs_a_robot_keeps_to_its_way() -> None:
    """A whole step would slide off the way, to where the last corner comes next again."""
    discs = Obstacle(center=(92.47, 53.22), radius=1.209), Obstacle(center=(85.62, 49.97), radius=2.893)
    team = SafeTeam([[91.423795, 50.000112]], [[82.51, 60.67]], *discs)
    assert team.fly(12) is not None
    assert team.kinds["deadlock"] == 0 and team.clearance >= SAFE / 2 - 1e-6


def test_a_robot_that_obstacles_alone_slow_down_asks_for_nothing() -> None:
    disc = Obstacle(center=(50.0, 50.0), radius=6.0)
    mission = Mission(shape="text:any", n_robots=2, obstacles=(disc,))
    leg = Leg(goal=(60.0, 57.6), stop=(60.0, 57.6), left=20.0)
    safety = ShieldedSafety(0, mission, 0.0)
    step = safety.step(observation((40.0, 57.6), {}), (45.7, 57.6), leg, 0.5)
    assert safety.course is None and step.waypoint[0] > 41.0
    aside, scene = (42.0, 50.0), observation((40.0, 57.6), {1: (43.0, 57.6)})
    kept = safety._on_its_way(scene, leg.stop, (45.7, 57.6), aside)
    assert kept == aside, "no step leads on, however short"


@pytest.mark.parametrize("spacing", [SAFE, 1.05 * SAFE])
@pytest.mark.parametrize("seed", range(4))
def test_a_line_as_tight_as_the_safe_distance_fills_up(spacing: float, seed: int) -> None:
    """Beside another robot, a place is approached by halves."""
    starts = np.array([[30.0 + 6.0 * k, 20.0] for k in range(7)])
    starts += np.random.default_rng(seed).uniform(-1.4, 1.4, starts.shape)
    team = SafeTeam(starts, [[40.0 + spacing * k, 60.0] for k in range(7)])
    assert team.fly(40) is not None
    assert team.smallest >= SAFE - 1e-6


def test_a_goal_inside_an_obstacle_is_not_reached() -> None:
    team = SafeTeam([[30.0, 50.0]], [[50.0, 50.0]], Obstacle(center=(50.0, 50.0), radius=6.0))
    assert team.fly(80) is None
    assert team.kinds["deadlock"] == 0 and team.clearance >= SAFE / 2 - 1e-6


def test_robots_on_one_spot_leave_in_directions_of_their_own() -> None:
    here = (10.0, 10.0)
    views = [spread_coincident(i, here, {j: here for j in range(4) if j != i} | {9: (15.0, 10.0)}) for i in range(4)]
    for i, view in enumerate(views):
        assert view[9] == (15.0, 10.0)
        for j in range(4):
            if j != i:
                seen, back = np.array(view[j]) - here, np.array(views[j][i]) - here
                assert np.linalg.norm(seen) > 0 and seen == pytest.approx(-back)
    assert spread_coincident(0, here, {1: (12.0, 10.0)}) == {1: (12.0, 10.0)}


def test_without_a_wish_a_robot_stays_but_for_one_too_near() -> None:
    safety = ShieldedSafety(0, Mission(), 0.0)
    assert safety.stay(observation((50.0, 50.0), {1: (53.0, 50.0)})).origin is Origin.HOLD
    flight = safety.stay(observation((50.0, 50.0), {1: (51.0, 50.0)}))
    assert flight.origin is Origin.SHIELD and flight.waypoint[0] <= 49.0
    assert flight.notes == (Note("separating", {"nearest": 1.0, "makes_way": False}),)
    way = safety.stay(observation((50.0, 50.0), {1: (54.0, 50.0), 2: (55.0, 50.0)}))
    assert way.notes[0].detail["makes_way"] is True and way.waypoint[0] < 50.0


def test_a_wish_beyond_a_wall_ends_at_the_wall() -> None:
    safety = ShieldedSafety(0, Mission(), 0.0)
    leg = Leg(goal=(104.0, 50.0), stop=(104.0, 50.0), left=6.0)
    step = safety.step(observation((98.0, 50.0), {}), (104.0, 50.0), leg, 0.5)
    assert step.origin is Origin.SHIELD and step.waypoint == pytest.approx((100.0, 50.0))
    leg = Leg(goal=(-12.0, 50.0), stop=(-12.0, 50.0), left=3.0)
    outside = safety.step(observation((-9.0, 50.0), {}), (-12.0, 50.0), leg, 0.5)
    assert outside.waypoint == pytest.approx((-9.0 + Mission().max_step, 50.0)), "one full step back"


def test_distance_within_the_noise_is_no_crowd() -> None:
    safety = ShieldedSafety(0, Mission(), 0.1)
    assert safety.stay(observation((50.0, 50.0), {1: (52.85, 50.0)})).origin is Origin.HOLD
    assert safety.stay(observation((50.0, 50.0), {1: (52.75, 50.0)})).origin is Origin.SHIELD


def test_paper_and_baseline_know_nothing_of_it() -> None:
    """Obstacles and right of way belong to the shield, which both presets leave off."""
    from llm_flock.runtime._rules import PRESETS

    assert [PRESETS[name]["shield"] for name in ("flock", "paper", "baseline")] == [True, False, False]
    assert build_mission().obstacles == ()
