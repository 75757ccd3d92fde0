"""Replanning for the robots that are alive."""

from __future__ import annotations

import pytest
from driven_agent import LINE, PLAN, DrivenAgent, make, says

from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._membership.team import MAX_WAIT, REPLAN_PATIENCE, Gaps


@pytest.mark.parametrize(("robot", "waits"), [(0, 1), (2, 2)])
def test_the_living_robot_with_the_lowest_id_replans_first(robot: int, waits: int) -> None:
    """Robot 1 is silent, so robot 2 counts as the second."""
    driven = DrivenAgent(make(robot, gaps="replan"), here=PLAN.points[robot])
    other = 2 - robot
    count = 0
    while len(driven.asked) < 2 and count < 40:
        count += 1
        beats = tuple(count + 1 if k == other else 2 * int(k == 1) for k in range(3))
        driven.round(says(other, beats))
        if len(driven.asked) < 2:  # it knows that the plan does not fit from when robot 1 counts as dead
            assert driven.agent.replans is (driven.number >= 4)
    assert driven.asked[1].question.mission.n_places == 2
    # Robot 1 is silent from round 4 on; then the plan must not fit for more than REPLAN_PATIENCE rounds and a rank.
    assert driven.number == 4 + REPLAN_PATIENCE + waits
    assert waits <= MAX_WAIT
    assert driven.agent.provenance is not None and driven.agent.provenance.epoch == 1


def test_robot_seeing_the_body_in_the_way_replans_at_once() -> None:
    driven = DrivenAgent(make(2, gaps="replan"), here=PLAN.points[2])
    body = {1: PLAN.points[1]}
    for number in range(1, 4 + REPLAN_PATIENCE + 1):
        assert len(driven.asked) <= 1
        driven.round(says(0, (number + 1, 2, 0)), sensed=body)
    assert len(driven.asked) == 2 and driven.asked[1].question.still == (PLAN.points[1],)


CROSS = Mission(shape="cross", n_robots=5, comm_range=60)


@pytest.mark.parametrize(("mission", "gaps"), [(LINE, "report"), (CROSS, "replan")])
def test_gaps_stay_if_to_be_reported_or_without_smaller_shape(mission: Mission, gaps: Gaps) -> None:
    """Robot 1 is heard of once; all others go on."""
    plan = Plan.of(mission.ideal or ())
    driven = DrivenAgent(make(mission=mission, gaps=gaps), here=plan.points[0], plan=plan)
    for number in range(1, 20):
        beats = (0, 2, *(number + 1 for _ in range(mission.n_robots - 2)))
        driven.round(says(2, beats, mission=mission))
    assert len(driven.asked) == 1 and driven.agent.plan == plan


def test_a_smaller_plan_is_followed_only_where_robots_may_replan() -> None:
    smaller = Plan.of(LINE.resized(2).ideal or ())
    origin = says(1, plan=smaller, epoch=1)
    choices: tuple[tuple[Gaps, bool], ...] = (("replan", True), ("report", False))
    for gaps, followed in choices:
        driven = DrivenAgent(make(gaps=gaps, verify=True))
        driven.begin()
        driven.comm_round(origin)
        assert (driven.agent.plan == smaller) is followed
    driven = DrivenAgent(make(gaps="replan", verify=True))
    driven.begin()
    driven.comm_round(says(1, plan=Plan.of([[50.0, 50.0], [90.0, 90.0]])))
    assert driven.agent.plan == PLAN and driven.agent.rejected["unverified_plan"] == 1
