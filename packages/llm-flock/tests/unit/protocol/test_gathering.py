"""The gathering of a team in pieces before its robots fly to far places."""

import math
import statistics

import pytest

import llm_flock
from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._membership.rendezvous import CLOSE, FEW, WAIT, Gathering, heard_when_turned

LINE = Mission(shape="line", n_robots=7)
NAMED = Plan.of(LINE.ideal or ())
PLAN = Plan.of((y, x) for x, y in NAMED.points)  # turned by a quarter
END = max(range(7), key=lambda a: math.dist(PLAN.points[a], LINE.center))
MIDDLE = min(range(7), key=lambda a: math.dist(PLAN.points[a], LINE.center))
MOST = math.ceil(FEW * 7 + 1e-9)
FAR = (95.0, 50.0)


def target(
    gathering: Gathering, here: Point, *, strangers: int = 6, alone: bool = True, slot: int = END, plan: Plan = PLAN
) -> Point | None:
    return gathering.target(LINE, plan, slot, here, strangers=strangers, alone=alone)


@pytest.mark.parametrize(
    ("shape", "n", "far"),
    [("line", 3, 0), ("line", 7, 4), ("line", 9, 6), ("cross", 5, 0), ("circle", 10, 0), ("circle", 20, 0)]
    + [("square", 8, 0), ("square", 40, 0), ("triangle", 6, 0), ("grid", 16, 0)],
)
def test_only_places_unheard_in_another_orientation_are_far(shape: str, n: int, far: int) -> None:
    mission = Mission(shape=shape, n_robots=n, arena=((-100, -100), (200, 200)))
    plan = Plan.of(mission.ideal or ())
    assert sum(not heard_when_turned(mission, plan, slot) for slot in range(n)) == far


def test_robot_that_heard_few_gathers_near_centre_on_its_side() -> None:
    near = (50.0 + CLOSE * LINE.spacing, 50.0)
    assert target(Gathering(), FAR) == pytest.approx(near)
    assert target(Gathering(), near, alone=False) == pytest.approx(near)
    assert target(Gathering(), (50.0, 50.0), alone=False) == (50.0, 50.0)
    assert target(Gathering(), FAR, slot=MIDDLE) is None, "there the others hear it anyway"


def test_robot_whose_plan_is_not_turned_flies_to_its_place() -> None:
    off = 0.08 * LINE.spacing
    assert target(Gathering(), FAR, plan=NAMED) is None, "other models have probably named the same places"
    assert target(Gathering(), FAR, plan=Plan.of((x + off, y) for x, y in NAMED.points)) is None
    assert target(Gathering(), FAR, plan=Plan.of((x + 2 * off, y) for x, y in NAMED.points)) is not None
    assert target(Gathering(), FAR, plan=Plan.of(NAMED.points[:6]), slot=0) is not None, "another team's plan"


def test_robot_that_heard_most_flies_to_its_place_unless_alone() -> None:
    assert target(Gathering(), FAR, strangers=MOST, alone=False) is not None
    assert target(Gathering(), FAR, strangers=MOST - 1, alone=False) is None
    assert target(Gathering(), FAR, strangers=MOST - 1, alone=True) is not None
    assert target(Gathering(), FAR, strangers=0, alone=True) is None


def test_robot_alone_at_the_centre_crosses_over_and_then_stops() -> None:
    gathering, near, beyond = Gathering(), (53.0, 50.0), (47.0, 50.0)
    assert target(gathering, near) == pytest.approx(beyond)
    assert target(gathering, (50.0, 50.0)) == pytest.approx(beyond)
    assert target(gathering, beyond, alone=False) == pytest.approx(beyond), "its own side by now"
    stays = [target(gathering, beyond) for _ in range(WAIT)]
    assert stays[:-2] == [pytest.approx(beyond)] * (WAIT - 2)
    assert stays[-1] is None
    assert target(gathering, beyond, strangers=5) == pytest.approx((53.0, 50.0)), "news: it gathers again"


def test_robot_that_cannot_reach_the_centre_stops_as_well() -> None:
    gathering, rounds = Gathering(), 0
    while target(gathering, FAR) is not None:
        rounds += 1
    reach = max(math.dist(place, LINE.center) for place in PLAN.points)
    assert rounds == math.ceil((math.dist(FAR, LINE.center) + reach) / LINE.max_step) + WAIT + 1


@pytest.mark.no_cover
def test_sparse_formations_form_soon() -> None:
    """Without gathering the mean was 1.65 times the lower bound in these flights."""
    ratios = list[float]()
    for seed in range(8):
        found = llm_flock.run(LINE, seed=seed, start="separated").summary
        assert found.formed and found.rounds_to_formed and found.lower_bound_rounds
        ratios.append(found.rounds_to_formed / found.lower_bound_rounds)
    assert statistics.mean(ratios) < 1.45
