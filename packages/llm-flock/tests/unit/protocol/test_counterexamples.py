"""Where the paper's rule does not settle, and the same under the default rules (docs/explanation/theory.md, section 4).

Both teams are made of the real agents, from the same positions and with the same proposals, by the presets of the
command line.
"""

import math
from itertools import pairwise

import pytest
from driven_team import DrivenTeam, turned

from llm_flock.arrays import Point
from llm_flock.events import Origin
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._verification.plans import check_plan

FOR_EVER = 100
"""Ticks; nothing changes from one to the next in what is shown to last, so any number would do."""

THREE = Mission(shape="triangle", n_robots=3)
IN_RANGE: tuple[Point, ...] = ((40.0, 40.0), (50.0, 40.0), (45.0, 48.0))


def settle(team: DrivenTeam, comm_rounds: int = FOR_EVER) -> None:
    for _ in range(comm_rounds):
        team.comm_round()


def one_plan_and_distinct_places(team: DrivenTeam) -> bool:
    return len(set(team.plans)) == 1 and None not in team.plans and set(team.slots) == set(range(len(team.agents)))


def test_equal_influences_never_resolve() -> None:
    """Three robots in range of each other all have influence 2/3: none outranks another."""
    plans = turned(THREE, 3)
    paper = DrivenTeam(THREE, "paper", plans)
    paper.begin(IN_RANGE)
    assert [agent.influence for agent in paper.agents] == [2 / 3] * 3
    settle(paper)
    assert paper.plans == plans

    flock = DrivenTeam(THREE, "flock", plans)
    flock.begin(IN_RANGE)
    settle(flock, 1)
    assert flock.plans == [plans[2]] * 3
    settle(flock, 9)
    assert one_plan_and_distinct_places(flock)


HUBS: tuple[Point, ...] = (
    (29.0, 50.0),  # 0: hub with three neighbours
    (43.0, 50.0),  # 1: hears hub 0 and robot 2
    (57.0, 50.0),  # 2: hears hub 3 and robot 1
    (71.0, 50.0),  # 3: hub with four neighbours
    (22.0, 62.0),
    (22.0, 38.0),
    (71.0, 64.0),
    (71.0, 36.0),
    (85.0, 50.0),
)


def test_two_hubs_never_agree_on_one_plan() -> None:
    """One is strictly more influential, and the graph is connected; but robots 1 and 2 each listen to their own hub."""
    nine = Mission(shape="circle", n_robots=9)
    plans = turned(nine, 9)
    paper = DrivenTeam(nine, "paper", plans)
    paper.begin(HUBS)
    assert [agent.degree for agent in paper.agents] == [3, 2, 2, 4, 1, 1, 1, 1, 1]
    settle(paper)
    left, right = {0, 1, 4, 5}, {2, 3, 6, 7, 8}
    assert {paper.plans[i] for i in left} == {plans[0]}
    assert {paper.plans[i] for i in right} == {plans[3]}

    flock = DrivenTeam(nine, "flock", plans)
    flock.begin(HUBS)
    settle(flock, 5)
    assert set(flock.plans) == {plans[3]}, "the plan of the most influential proposer"
    settle(flock, FOR_EVER)
    assert one_plan_and_distinct_places(flock)


def shuttle(rounds: int) -> list[float]:
    """Robot 2 flies between the two groups, one step of at most 6 units a round."""
    there = [33.0 + 34.0 * k / 6 for k in range(6)]
    back = [67.0 - 34.0 * k / 6 for k in range(6)]
    return [(there + back)[k % 12] for k in range(rounds)]


def groups(x: float) -> list[Point]:
    """Hub 0 with robot 3 on the left, hub 1 with robot 4 on the right, robot 2 at x between them."""
    return [(20.0, 50.0), (80.0, 50.0), (x, 50.0), (8.0, 50.0), (92.0, 50.0)]


def plans_of_the_shuttle(preset: str, rounds: int) -> tuple[DrivenTeam, list[Plan], list[Plan | None]]:
    five = Mission(shape="circle", n_robots=5)
    plans = turned(five, 5)
    team = DrivenTeam(five, preset, plans)
    held: list[Plan | None] = []
    for x in shuttle(rounds):
        team.begin(groups(x))
        team.comm_round()
        held.append(team.agents[2].plan)
        team.end()
    return team, plans, held


@pytest.mark.no_cover
def test_plans_go_round_because_influence_belongs_to_the_carrier() -> None:
    """Plan A replaces plan B on one side, B replaces A on the other: no order of the plans, so no end."""
    paper, plans, held = plans_of_the_shuttle("paper", 10 * 12)
    changes = [b for a, b in pairwise(held) if a != b]
    assert changes == [plans[1], plans[0]] * 9 + [plans[1]]
    assert len(set(paper.plans)) == 2

    flock, plans, held = plans_of_the_shuttle("flock", 2 * 12)
    changes = [b for a, b in pairwise(held) if a != b]
    assert len(changes) <= 1
    assert len(set(flock.plans)) == 1, "the shuttle has carried the higher plan to the other side"


def test_two_robots_take_the_same_goal() -> None:
    """Both adopt the plan of the robot between them, both are nearest to its upper point, and neither learns of it."""
    apart: tuple[Point, ...] = ((42.0, 75.0), (50.0, 68.0), (58.0, 75.0))
    upright = Plan.of(THREE.ideal or ())
    top = max(range(3), key=lambda a: upright.points[a][1])
    plans = [turned(THREE, 1)[0], upright, turned(THREE, 2)[1]]
    paper = DrivenTeam(THREE, "paper-literal", plans)
    paper.begin(apart)
    settle(paper)
    assert paper.plans == [upright] * 3
    assert paper.slots[0] == paper.slots[2] == top

    shared = DrivenTeam(THREE, "paper", plans)
    shared.begin(apart)
    settle(shared)
    assert shared.slots[0] == shared.slots[2], "out of range of each other"
    shared.end()
    shared.begin([(43.0, 75.0), (50.0, 68.0), (57.0, 75.0)])
    settle(shared)
    assert shared.plans == [upright] * 3
    assert one_plan_and_distinct_places(shared), "the higher id yields"

    flock = DrivenTeam(THREE, "flock", plans)
    flock.begin(apart)
    settle(flock, 10)
    assert flock.plans == [upright] * 3
    assert one_plan_and_distinct_places(flock)


def test_the_most_influential_robot_spreads_a_hallucinated_plan() -> None:
    """Three points on a line, far from the centre, from the robot that both others hear."""
    path: tuple[Point, ...] = ((36.0, 50.0), (50.0, 50.0), (64.0, 50.0))
    wrong = Plan.of([[0.0, 0.0], [1.0, 0.0], [90.0, 0.0]])
    assert check_plan(THREE, wrong) is not None
    good = turned(THREE, 3)
    plans = [good[0], wrong, good[2]]
    paper = DrivenTeam(THREE, "paper", plans)
    paper.begin(path)
    settle(paper)
    assert paper.plans == [wrong] * 3

    flock = DrivenTeam(THREE, "flock", plans)
    flock.begin(path)
    settle(flock, 10)
    assert flock.plans == [good[2]] * 3
    assert one_plan_and_distinct_places(flock)


@pytest.mark.parametrize("wish", [(88.0, 40.0), (50.0, 40.0)], ids=["48 units away", "on another robot"])
def test_a_step_that_is_too_long_or_collides_is_flown(wish: Point) -> None:
    plans = turned(THREE, 3)
    paper = DrivenTeam(THREE, "paper", plans)
    paper.begin(IN_RANGE)
    move = paper.end({0: wish})[0]
    assert (move.waypoint, move.origin) == (wish, Origin.MODEL)

    flock = DrivenTeam(THREE, "flock", plans)
    flock.begin(IN_RANGE)
    flown = flock.end({0: wish})[0].waypoint
    assert math.dist(flown, IN_RANGE[0]) <= THREE.max_step
    assert min(math.dist(flown, other) for other in IN_RANGE[1:]) >= THREE.safe_distance
