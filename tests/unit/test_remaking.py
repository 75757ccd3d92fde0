"""Plans that are remade for the team that is alive."""

from __future__ import annotations

import pytest
from one_flight import LINE, PLAN, Flight, make, says

from llm_flock.mission import Mission
from llm_flock.protocol.membership.replanning import MOST_WAIT, REPLAN_PATIENCE, Gaps
from llm_flock.protocol.plan import Plan


@pytest.mark.parametrize(("robot", "waits"), [(0, 1), (2, 2)])
def test_who_is_alive_and_has_the_lowest_id_remakes_the_plan_first(robot: int, waits: int) -> None:
    """Robot 1 is silent, so robot 2 counts as the second."""
    flight = Flight(make(robot, gaps="replan"), here=PLAN.points[robot])
    other = 2 - robot
    count = 0
    while len(flight.asked) < 2 and count < 40:
        count += 1
        beats = tuple(count + 1 if k == other else 2 * int(k == 1) for k in range(3))
        flight.round(says(other, beats))
    assert flight.asked[1].question.mission.n_places == 2
    # Robot 1 is silent from round 4 on; then the plan must not fit for more than REPLAN_PATIENCE rounds and a rank.
    assert flight.number == 4 + REPLAN_PATIENCE + waits
    assert waits <= MOST_WAIT
    assert flight.agent.provenance is not None and flight.agent.provenance.epoch == 1


def test_who_sees_the_body_that_is_in_the_way_remakes_the_plan_at_once_and_is_told_of_it() -> None:
    flight = Flight(make(2, gaps="replan"), here=PLAN.points[2])
    body = {1: PLAN.points[1]}
    for number in range(1, 4 + REPLAN_PATIENCE + 1):
        assert len(flight.asked) <= 1
        flight.round(says(0, (number + 1, 2, 0)), sensed=body)
    assert len(flight.asked) == 2 and flight.asked[1].question.still == (PLAN.points[1],)


CROSS = Mission(shape="cross", n_robots=5, comm_range=60)


@pytest.mark.parametrize(("mission", "gaps"), [(LINE, "report"), (CROSS, "replan")])
def test_gaps_are_kept_where_they_are_to_be_reported_and_where_no_smaller_shape_exists(
    mission: Mission, gaps: Gaps
) -> None:
    """Robot 1 is heard of once; all others go on."""
    plan = Plan.of(mission.ideal or ())
    flight = Flight(make(mission=mission, gaps=gaps), here=plan.points[0], plan=plan)
    for number in range(1, 20):
        beats = (0, 2, *(number + 1 for _ in range(mission.n_robots - 2)))
        flight.round(says(2, beats, mission=mission))
    assert len(flight.asked) == 1 and flight.agent.plan == plan


def test_a_smaller_plan_is_followed_only_where_plans_are_remade() -> None:
    smaller = Plan.of(LINE.resized(2).ideal or ())
    origin = says(1, plan=smaller)
    choices: tuple[tuple[Gaps, bool], ...] = (("replan", True), ("report", False))
    for gaps, followed in choices:
        flight = Flight(make(gaps=gaps, verify=True))
        flight.begin()
        flight.comm_round(origin)
        assert (flight.agent.plan == smaller) is followed
    flight = Flight(make(gaps="replan", verify=True))
    flight.begin()
    flight.comm_round(says(1, plan=Plan.of([[50.0, 50.0], [90.0, 90.0]])))
    assert flight.agent.plan == PLAN and flight.agent.rejected["unverified_plan"] == 1
