"""Right of way: who asks, who steps aside and where to, and that courses move no robot too near another."""

from __future__ import annotations

import math
from itertools import groupby, pairwise

import numpy as np
import pytest
from rounds import observation
from safe_team import SAFE, SafeTeam

from llm_flock.arrays import Point, separation
from llm_flock.events import MoveTo, Note, Origin
from llm_flock.message import MAX_LEVEL, Course
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.protocol._motion.leg import Leg, leg_to
from llm_flock.protocol._motion.pilot import Observation, Pilot
from llm_flock.protocol._motion.right_of_way import BETWEEN, HEEDED_ROUNDS, KEPT, RISES, RightOfWay, outside, rank
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.protocol._parts import Parts, Safety
from llm_flock.runtime import parts_of
from llm_flock.runtime._config import build_config

MISSION = Mission(shape="text:any", n_robots=4)


def box(left: float, low: float, right: float, high: float) -> Obstacle:
    return Obstacle(polygon=((left, low), (right, low), (right, high), (left, high)))


NARROW = box(30, -5, 70, 48), box(30, 52, 70, 105)
BAY = box(30, -5, 70, 48), box(30, 52, 46, 105), box(54, 52, 70, 105), box(46, 57, 54, 105)


def course(*path: tuple[float, ...], level: int = 0, of: int = 0) -> Course:
    return Course(level=level, of=of, path=path)


def test_ranks_rise_with_the_level_then_with_lower_ids() -> None:
    assert rank(5, 1, 5) > rank(0, 0, 0) > rank(1, 0, 1)
    assert rank(1, 2, 1) > rank(0, 2, 1) > rank(3, 2, 1), (
        "its owner before those that pass it on, of these the lower id"
    )


GOAL = (80.0, 50.0)


@pytest.mark.no_cover
def test_level_rises_ever_slower_at_a_stand_and_falls_at_goal() -> None:
    right, levels = RightOfWay(0, MISSION), list[int]()
    right.count(GOAL, 30.0, 0.5)
    for _ in range(8 * RISES):
        right.count(GOAL, 30.0, 0.5)
        right.ask([GOAL])
        assert right.course is not None
        levels.append(right.course.level)
    assert [levels.index(level) + 1 for level in range(1, 5)] == [RISES, 2 * RISES, 4 * RISES, 8 * RISES]
    waited = right.waited
    right.count(GOAL, 20.0, 0.5)
    assert right.waited == waited and not right.stalled, "progress, but not there yet"
    for _ in range(RISES * 2**MAX_LEVEL):
        right.count(GOAL, 20.0, 0.5)
    right.ask([GOAL])
    assert right.course is not None and right.course.level == MAX_LEVEL and right.stalled
    right.count(GOAL, 0.4, 0.5)
    right.ask([GOAL])
    assert right.course is not None and right.course.level == 0 and right.waited == 0


def test_three_rounds_without_progress_are_a_stall() -> None:
    right = RightOfWay(0, MISSION)
    lefts = [30.0, 29.9, 29.8, 29.65, 29.0, 29.0, 29.0]
    stalled = list[bool]()
    for left in lefts:
        right.count(GOAL, left, 0.5)
        stalled.append(right.stalled)
    assert stalled == [False, False, False, False, False, False, False]
    right.count(GOAL, 29.0, 0.5)
    assert right.stalled
    right.count((20.0, 20.0), 60.0, 0.5)
    assert not right.stalled, "another goal"
    for left in (0.9, 0.85, 0.8, 0.75, 0.7):  # beside another robot, by halves or less
        right.count(GOAL, left, 0.5)
    assert not right.stalled


def test_rounds_within_a_heartbeat_period_count_once() -> None:
    """A robot that a body stops at once has many short rounds; others fly on meanwhile."""
    right, other = RightOfWay(0, MISSION), RightOfWay(1, MISSION)
    for k in range(4 * (RISES + 1)):
        right.count(GOAL, 30.0, 0.5, k // 4)
    assert right.waited == RISES and right.stalled
    right.ask([GOAL])
    assert right.course is not None and right.course.level == 1
    kept = list[bool]()
    for k in range(12):
        right.count(GOAL, 30.0, 0.5, 100 + k // 4)
        right.go_on_asking([GOAL])
        kept.append(right.course is not None)
    assert kept == [True] * 4 + [False] * 8
    sensed, asked = {0: (46.0, 50.0)}, {0: course((64.0, 50.0))}
    heeded = 0
    for k in range(4 * 2 * HEEDED_ROUNDS):
        other.count(GOAL, 0.0, 0.5, k // 4)
        heeded += bool(other.ways(sensed, asked))
    assert heeded == 4 * HEEDED_ROUNDS


def test_bodies_not_in_step_get_wider_ways_and_block_earlier() -> None:
    here, stop = (50.0, 50.0), (80.0, 50.0)
    beside, leg = (53.8, 52.6), Leg(goal=(51.5, 49.0), stop=(51.5, 49.0), left=1.8)
    for apart, blocked in ((None, False), (5.3, True)):
        safety = ShieldedSafety(0, MISSION, 0.0, apart)
        steps = [safety.step(observation(here, {1: beside}), leg.stop, leg, 0.5) for _ in range(5)]
        assert {step.waypoint for step in steps} == {leg.stop}, "the cell keeps them apart, and is the same"
        assert (safety.course is not None) == blocked
        right = RightOfWay(1, MISSION, apart)
        right.count(GOAL, 30.0, 0.5)
        (way,) = right.ways({0: here}, {0: course(stop)})
        assert way.covers((60.0, 54.0)) == blocked


def test_a_course_is_kept_for_a_while_after_the_way_is_free() -> None:
    right = RightOfWay(0, MISSION)
    right.ask([GOAL])
    kept = 0
    for _ in range(5):
        right.count(GOAL, 30.0, 0.5)
        right.go_on_asking([GOAL])
        kept += right.course is not None
    assert kept == KEPT - 1
    right.ask([])
    assert right.course is None, "a robot without a way asks for none"


def test_only_ways_of_higher_rank_of_robots_in_sight_count() -> None:
    right = RightOfWay(1, MISSION)
    right.count(GOAL, 30.0, 0.5)
    sensed = {0: (40.0, 50.0), 2: (60.0, 50.0), 3: (50.0, 40.0)}
    east = (70.0, 50.0)
    asked = {0: course(east), 2: course(east, of=2), 3: course(east, level=1, of=3), 9: course(east, level=9, of=9)}
    assert [way.robot for way in right.ways(sensed, asked)] == [3, 0]
    above, beside = right.ways(sensed, asked)
    assert above.width > beside.width and beside.covers((50.0, 51.0)) and not beside.covers((50.0, 53.0))
    assert outside([beside], (50.0, 51.0), (50.0, 52.0)) and not outside([beside], (50.0, 53.0), (50.0, 51.0))


def test_a_robot_in_the_way_steps_aside_and_passes_the_right_on() -> None:
    safety, here = ShieldedSafety(1, MISSION, 0.0), (50.0, 50.0)
    sensed = {0: (46.0, 50.0)}
    leg = Leg(goal=(20.0, 50.0), stop=(20.0, 50.0), left=30.0)
    step = safety.step(observation(here, sensed, courses={0: course((64.0, 50.0))}), (44.0, 50.0), leg, 0.5)
    assert step.origin is Origin.YIELD and step.notes == (Note("gives_way", {"to": 0}),)
    assert abs(step.waypoint[1] - 50.0) > 2.0
    assert safety.course is not None and safety.course.of == 0
    step = safety.step(observation(here, sensed, courses={0: course((64.0, 50.0))}), (44.0, 50.0), leg, 0.5)
    assert step.notes == (), "noted once"


def test_robot_at_its_place_steps_aside_and_one_beside_waits() -> None:
    here, sensed = (50.0, 50.0), {0: (46.0, 50.0)}
    held = ShieldedSafety(1, MISSION, 0.0).stay(observation(here, sensed, courses={0: course((64.0, 50.0))}))
    assert held.origin is Origin.YIELD and math.dist(held.waypoint, here) > 1.0
    beside, across = (50.0, 54.0), Leg(goal=(50.0, 40.0), stop=(50.0, 40.0), left=14.0)
    safety, courses = ShieldedSafety(1, MISSION, 0.0), {0: course((64.0, 50.0))}
    step = safety.step(observation(beside, sensed, courses=courses), (50.0, 48.0), across, 0.5)
    assert step.origin is Origin.YIELD and 52.8 <= step.waypoint[1] < 54.0


def test_robot_with_a_way_out_flies_on_and_passes_the_right_on() -> None:
    here, sensed = (50.0, 50.0), {0: (46.0, 50.0)}
    for goal, flies_on in (((50.0, 80.0), True), ((60.0, 50.0), False), ((30.0, 60.0), False)):
        safety = ShieldedSafety(1, MISSION, 0.0)
        leg = Leg(goal=goal, stop=goal, left=math.dist(here, goal))
        wish = tuple(x + 6.0 * (y - x) / leg.left for x, y in zip(here, goal, strict=True))
        step = safety.step(observation(here, sensed, courses={0: course((64.0, 50.0))}), wish, leg, 0.5)
        assert (step.origin is Origin.YIELD) is not flies_on
        assert safety.course is not None and safety.course.of == 0 and (safety.course.path[-1][1] > 60.0) is flies_on


def test_robot_in_a_bay_lets_an_oncoming_one_pass() -> None:
    """The next corner of its way is free, but beyond it the way leads past the other."""
    here, sensed = (51.5, 52.2), {0: (60.0, 49.6)}
    mission = Mission(shape="text:any", n_robots=2, obstacles=BAY)
    asked = {0: course((42.0, 49.6), level=1)}
    for goal, comes_out in (((80.0, 50.0), False), ((20.0, 50.0), True)):
        leg = leg_to(mission, here, goal)
        step = ShieldedSafety(1, mission, 0.0).step(observation(here, sensed, courses=asked), leg.stop, leg, 0.5)
        assert leg.stop[1] < 50.6 and (step.origin is not Origin.YIELD) is comes_out
        assert (step.waypoint[1] < here[1]) is comes_out


def test_nowhere_to_go() -> None:
    """Walls all round: the robot flies on as its shield lets it."""
    cell = box(40, 40, 60, 48.4), box(40, 51.6, 60, 60), box(40, 48, 47, 52), box(53, 48, 60, 52)
    mission = Mission(shape="text:any", n_robots=2, obstacles=cell)
    safety = ShieldedSafety(1, mission, 0.0)
    step = safety.stay(observation((50.0, 50.0), {0: (46.0, 50.0)}, courses={0: course((64.0, 50.0))}))
    assert step.origin is Origin.HOLD and safety.course is None
    leg = Leg(goal=(49.0, 50.0), stop=(49.0, 50.0), left=1.0)
    step = safety.step(
        observation((50.0, 50.0), {0: (46.0, 50.0)}, courses={0: course((64.0, 50.0))}), (49.0, 50.0), leg, 0.5
    )
    assert step.origin is Origin.SHIELD and safety.course is not None and safety.course.of == 0


def test_without_right_of_way_a_blocked_robot_asks_for_nothing() -> None:
    for without, asks in ((None, True), ("right-of-way", False)):
        config = build_config(without=without)
        safety = parts_of(config, config.protocol.rules(), 1).safety
        here, there = (50.0, 50.0), (60.0, 50.0)
        for _ in range(6):
            leg = leg_to(config.mission, here, there)
            safety.step(observation(here, {0: (53.0, 50.0), 2: (53.0, 53.1), 3: (53.0, 46.9)}), there, leg, 0.5)
        assert (safety.course is not None) is asks


def test_way_to_a_refuge_passes_no_oncoming_robot() -> None:
    right = RightOfWay(1, MISSION)
    sensed = {0: (46.0, 50.0)}
    (way,) = right.ways(sensed, {0: course((64.0, 50.0))})
    for goal in ((20.0, 50.0), (20.0, 60.0), (80.0, 50.0)):
        refuge = right.refuge((50.0, 50.0), goal, [way], [way], sensed.values())
        assert refuge is not None and not way.covers(refuge) and refuge[0] > 46.0


def heeds(right: RightOfWay, sensed: dict[int, Point]) -> bool:
    """A round of a robot at its place, in which robot 0 asks for the way over it."""
    right.count(GOAL, 0.0, 0.5)
    return bool(right.ways(sensed, {0: course((64.0, 50.0))}))


@pytest.mark.parametrize("moves", [0.0, 6.0])
def test_request_for_the_way_is_heeded_for_a_while_only(moves: float) -> None:
    """Wherever it is, also out of sight for a while; with a new mission everybody is heeded again."""
    right = RightOfWay(1, MISSION)
    heeded = [heeds(right, {0: (46.0 - moves * (k % 2), 50.0)}) for k in range(9 * HEEDED_ROUNDS)]
    periods = [(on, len([*group])) for on, group in groupby(heeded)]
    rests = (False, 2 * HEEDED_ROUNDS), (False, 4 * HEEDED_ROUNDS)
    assert periods == [(True, HEEDED_ROUNDS), rests[0], (True, HEEDED_ROUNDS), rests[1], (True, HEEDED_ROUNDS)]
    assert not heeds(right, {0: (46.0, 50.0)})
    assert not heeds(right, {}) and not heeds(right, {0: (46.0, 50.0)})
    right.begin_mission()
    assert heeds(right, {0: (46.0, 50.0)})


def test_repeated_requests_for_the_way_are_heeded_no_longer() -> None:
    """Who makes way loses sight of the one that asks; the rounds between count, a few of them at a time."""
    for every, count in (
        (2, HEEDED_ROUNDS // 2),
        (BETWEEN, HEEDED_ROUNDS // BETWEEN),
        (3 * BETWEEN, HEEDED_ROUNDS // BETWEEN),
    ):
        right = RightOfWay(1, MISSION)
        seen = [heeds(right, {} if k % every else {0: (46.0, 50.0)}) for k in range(2 * HEEDED_ROUNDS * BETWEEN)]
        first = range(0, len(seen), every)
        assert all(seen[k] for k in first[:count]) and not seen[first[count + 1]]


@pytest.mark.parametrize("shield_on", [True, False])
def test_pilot_heeds_all_robots_again_after_a_new_mission(shield_on: bool) -> None:
    parts = Parts(safety=ShieldedSafety(1, MISSION, 0.0) if shield_on else Safety())
    pilot = Pilot(1, MISSION, parts, noise_bound=0.0, on_event=False, fallback="hold")
    courses = {0: course((64.0, 50.0))}
    scene = Observation(round=1, position=(50.0, 50.0), sensed={0: (46.0, 50.0)}, observed=(), courses=courses)

    def yields() -> bool:
        moved = pilot.hold(scene, "no_goal", "")[-1]
        return isinstance(moved, MoveTo) and moved.origin is Origin.YIELD

    assert [yields() for _ in range(33)] == [shield_on] * 32 + [False]
    pilot.begin_mission()
    assert yields() == shield_on


@pytest.mark.parametrize("dim", [2, 3])
def test_dead_bodies_are_on_the_map(dim: int) -> None:
    rest = (50.0,) * (dim - 1)
    mission = Mission(shape="text:any", n_robots=4, center=(50.0,) * dim, arena=((0.0,) * dim, (100.0,) * dim))
    here, goal, body = (40.0, *rest), (70.0, *rest), (50.0, *rest)
    leg = leg_to(mission, here, goal, still=(body,))
    assert leg.stop != goal and leg.left > 30.0
    assert (
        min(math.dist(body, [a + k / 50 * (b - a) for a, b in zip(here, leg.stop, strict=True)]) for k in range(51))
        >= SAFE
    )
    assert leg_to(mission, here, goal).stop == goal


def test_uncertainty_widens_ways_round_obstacles_and_bodies() -> None:
    """As wide as cells need at a quarter of the longest step; where nothing stands they stay straight."""
    mission = Mission(shape="text:any", n_robots=4, obstacles=NARROW)
    here, goal, noise = (20.0, 80.0), (80.0, 80.0), 0.2
    corners = [leg_to(mission, here, goal, noise=e).stop for e in (0.0, noise)]
    off = [NARROW[1].nearest(corner)[0].distance for corner in corners]
    assert off[0] < SAFE / 2 * 1.5 and off[1] - off[0] > noise * 3.0
    assert leg_to(MISSION, here, goal, noise=noise).stop == goal
    for error, margin in ((noise, 2 * noise * 3.0), (0.0, 0.0)):
        right = ShieldedSafety(0, mission, error)._right_of_way
        assert right.passing_distance == pytest.approx(SAFE + margin)


@pytest.mark.no_cover
def test_robot_beside_a_corner_asks_though_its_step_is_short() -> None:
    """Of two that meet at the bay's edge the one of higher rank must not wait for the other."""
    team = SafeTeam([[51.04, 50.0], [54.04, 50.0]], [[80.0, 50.0], [22.0, 50.0]], *BAY)
    assert team.fly(100) is not None
    assert team.smallest >= SAFE - 1e-6 and team.clearance >= SAFE / 2 - 1e-6


@pytest.mark.parametrize(
    ("obstacles", "most"),
    [pytest.param(BAY, 90, id="bay"), pytest.param(NARROW, 150, id="no bay", marks=pytest.mark.no_cover)],
)
def test_head_on_in_a_corridor_one_robot_wide(obstacles: tuple[Obstacle, ...], most: int) -> None:
    """With fixed goals one of them has to go back, into the bay or all the way."""
    ends = [[20.0, 50.0], [80.0, 50.0]]
    team = SafeTeam(ends, ends[::-1], *obstacles)
    assert team.fly(most) is not None
    assert team.smallest >= SAFE - 1e-6 and team.clearance >= SAFE / 2 - 1e-6


class Lossy(SafeTeam):
    """A team of which each loses three courses in ten."""

    rng = np.random.default_rng(0)

    def heard(self, receiver: int, sender: int) -> bool:
        return bool(self.rng.random() < 0.7)


@pytest.mark.no_cover
@pytest.mark.parametrize("kind", [SafeTeam, Lossy])
@pytest.mark.parametrize(("spacing", "most"), [(6.0, 150), (8.0, 100)])
def test_a_full_grid_changes_all_its_places(kind: type[SafeTeam], spacing: float, most: int) -> None:
    grid = 50 + spacing * (np.array([[i, j] for i in range(4) for j in range(4)]) - 1.5)
    team = kind(grid, grid[np.random.default_rng(1).permutation(16)])
    assert team.fly(most) is not None
    assert team.smallest >= SAFE - 1e-6


@pytest.mark.no_cover
def test_two_layers_change_places() -> None:
    layer = [[44.0 + 6 * i, 44.0 + 6 * j] for i in range(3) for j in range(3)]
    low, high = [[*x, 40.0] for x in layer], [[*x, 46.0] for x in layer]
    team = SafeTeam([*low, *high], [*high, *low])
    assert team.fly(30) is not None
    assert team.smallest >= SAFE - 1e-6


@pytest.mark.no_cover
@pytest.mark.parametrize("seed", range(3))
def test_false_claims_cannot_break_the_safe_distance(seed: int) -> None:
    """Members that lie ask for anything, in anybody's name."""
    rng = np.random.default_rng(seed)
    grid = 50 + 5.0 * (np.array([[i, j] for i in range(3) for j in range(3)]) - 1.0)
    team = SafeTeam(grid, grid[rng.permutation(9)])
    for _ in range(20):
        lies = {
            int(j): course(
                *(tuple(rng.uniform(0, 100, 2).tolist()) for _ in range(rng.integers(1, 4))),
                level=int(rng.integers(0, MAX_LEVEL + 1)),
                of=int(rng.integers(0, 9)),
            )
            for j in rng.choice(9, 4, replace=False)
        }
        team.courses.update(lies)
        team.round()
    assert team.smallest >= SAFE - 1e-6


@pytest.mark.parametrize(("downwash", "straight"), [(1.0, True), (2.0, False), (3.0, False)])
def test_ways_lead_round_the_ellipsoid_of_a_dead_robot(downwash: float, straight: bool) -> None:
    mission = Mission(shape="sphere", n_robots=12, downwash=downwash)
    dead, here, goal = (50.0, 50.0, 50.0), (40.0, 50.0, 54.5), (60.0, 50.0, 54.5)
    stops: list[Point] = [here]
    while stops[-1] != goal and len(stops) < 20:
        stops.append(leg_to(mission, stops[-1], goal, still=(dead,)).stop)
    assert (len(stops) == 2) is straight and stops[-1] == goal
    way = [np.array(a) + s * (np.array(b) - np.array(a)) for a, b in pairwise(stops) for s in np.linspace(0, 1, 41)]
    assert min(separation(tuple(x), dead, downwash) for x in way) >= 3.0 * 0.97
