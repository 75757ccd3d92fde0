"""Verification: a plan or step that fails is neither followed nor forwarded nor flown."""

from __future__ import annotations

import pytest
from one_agent import MISSION, PLAN, began, foreign, make, origin
from whole_agent import whole_agent

from llm_flock.agent import Agent
from llm_flock.events import (
    AgreementEnded,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    MoveTo,
    Note,
    Origin,
    Planned,
    Received,
)
from llm_flock.message import Provenance, decode
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, StepAnswer
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus

IDEAL = Plan.of(MISSION.ideal or ())
TURNED = Plan.of([[50.0, 44.23], [45.0, 52.89], [55.0, 52.89]])
CRUDE = Plan.of([[50.3, 44.2], [44.7, 52.9], [55.0, 53.2]])


def checking(robot: int = 0, *, shield_on: bool = True) -> Agent:
    return whole_agent(robot, MISSION, ProvenanceConsensus(), AuctionAssignment(), shield_on=shield_on, verify=True)


def deciding(agent: Agent, plan: Plan = IDEAL) -> Agent:
    """The agent at (48, 50) with a goal, waiting for the answer to its step question."""
    agent.handle(began())
    agent.handle(Planned(PlanAnswer(plan=plan, slot=0)))
    agent.handle(AgreementEnded())
    return agent


def test_an_own_plan_that_fails_is_not_followed() -> None:
    agent = checking()
    agent.handle(began())
    (note,) = agent.handle(Planned(PlanAnswer(plan=PLAN, slot=1)))
    assert isinstance(note, Note) and note.kind == "no_plan" and note.detail["cause"] == "unverified"
    assert "mean of its points" in note.detail["reason"]
    assert agent.plan is None


def test_a_received_plan_that_fails_dies_with_its_author() -> None:
    agent = checking()
    agent.handle(began())
    agent.handle(Planned(PlanAnswer(plan=IDEAL, slot=0)))
    agent.handle(CommRoundBegan())
    for k in range(3):
        effects = agent.handle(Received(foreign(1, PLAN, origin(2), sequence=k)))
        if k == 0:
            (note,) = effects
            assert isinstance(note, Note) and note.kind == "rejected_message"
            assert note.detail["reason"] == "unverified_plan" and "mean of its points" in note.detail["detail"]
        else:
            assert effects == [], "noted once"
        assert agent.handle(CommRoundEnded()) == []
        (said,) = agent.handle(CommRoundBegan())
        assert isinstance(said, Broadcast) and decode(said.payload, 3, 2).plan_digest == IDEAL.digest
    assert agent.plan == IDEAL
    assert agent.rejected == {"unverified_plan": 3}, "counted each time"


def test_robot_without_plan_adopts_no_bad_one_names_fallback() -> None:
    agent = checking()
    agent.handle(began())
    agent.handle(Planned(NoAnswer(cause="answer", reason="none")))
    agent.handle(Received(foreign(1, PLAN, origin(1))))
    assert agent.handle(CommRoundEnded()) == [] and agent.plan is None
    agent.handle(Received(foreign(2, IDEAL, origin(2))))
    fallback, adopted, _ = agent.handle(CommRoundEnded())
    assert fallback == Note("fallback", {"question": "plan", "by": "neighbour", "cause": "answer", "reason": "none"})
    assert adopted == Note("adopted", {"plan": IDEAL.digest, "from": 2})


def test_an_exact_plan_beats_a_crude_one_of_higher_influence() -> None:
    agent = checking(2)
    agent.handle(began(r1=(58.0, 50.0)))
    agent.handle(Planned(PlanAnswer(plan=CRUDE, slot=0)))
    assert agent.plan == CRUDE
    low = Provenance(mission=0, mission_digest=MISSION.digest, epoch=0, degree=0, proposer=0, sequence=0)
    agent.handle(Received(foreign(1, CRUDE, origin(1))))
    agent.handle(Received(foreign(0, TURNED, low)))
    agent.handle(CommRoundEnded())
    assert agent.plan == TURNED
    agent.handle(Received(foreign(1, CRUDE, origin(1), sequence=1)))
    assert agent.handle(CommRoundEnded()) == []


@pytest.mark.parametrize("accepted", [True, False])
def test_overshooting_answer_counts_as_clipped_to_the_goal(accepted: bool) -> None:
    agent = deciding(checking())
    assert agent.goal is not None
    (x, y), (gx, gy) = agent.position, agent.goal
    beyond = (x + 1.9 * (gx - x), y + 1.9 * (gy - y))
    answer = StepAnswer(waypoint=beyond) if accepted else NoAnswer(cause="answer", reason="3 tries", waypoint=beyond)
    note, move = agent.handle(Decided(answer))
    assert note == Note("clipped", {"proposed": beyond, "flown": (gx, gy)})
    assert move == MoveTo(waypoint=(gx, gy), proposed=beyond, origin=Origin.CLIPPED)


@pytest.mark.parametrize(
    ("answer", "cause"),
    [
        (StepAnswer(waypoint=(20.0, 50.0)), "unverified"),
        (NoAnswer(cause="answer", reason="3 tries", waypoint=(20.0, 50.0)), "answer"),
        (NoAnswer(cause="server", reason="500"), "server"),
    ],
)
def test_a_step_that_cannot_be_mended_makes_the_robot_hold(answer: StepAnswer | NoAnswer, cause: str) -> None:
    agent = deciding(checking())
    note, move = agent.handle(Decided(answer))
    assert isinstance(note, Note) and note.kind == "held" and note.detail["cause"] == cause
    assert isinstance(move, MoveTo) and move.origin is Origin.HOLD and move.waypoint == (48.0, 50.0)


def test_without_verification_a_rejected_waypoint_is_not_flown() -> None:
    agent = deciding(make())
    _, move = agent.handle(Decided(NoAnswer(cause="answer", reason="3 tries", waypoint=(49.0, 50.0))))
    assert isinstance(move, MoveTo) and move.origin is Origin.HOLD
