"""The state machine: legal events, refused messages, notes, and the table that the docs draw."""

from __future__ import annotations

import pytest
from one_agent import BETTER, MISSION, PLAN, began, foreign, make, notes, origin, planned

from llm_flock.agent import IllegalEvent
from llm_flock.events import (
    TRANSITIONS,
    AgreementEnded,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    MissionGiven,
    MoveTo,
    Note,
    Origin,
    Phase,
    Planned,
    Received,
    Stopped,
)
from llm_flock.planner import NoAnswer, PlanAnswer, StepAnswer


def test_a_whole_round() -> None:
    agent = make()
    (ask,) = agent.handle(began(r1=(58.0, 50.0)))
    assert isinstance(ask, AskPlan) and ask.question.neighbors == ((58.0, 50.0),)
    assert agent.influence == pytest.approx(1 / 3)
    assert notes(agent.handle(Planned(PlanAnswer(plan=PLAN, slot=1)))) == ["proposed"]
    assert agent.goal == (50.0, 50.0)
    (said,) = agent.handle(CommRoundBegan())
    assert isinstance(said, Broadcast)
    assert agent.handle(Received(foreign(1, BETTER, origin(1)))) == []
    assert notes(agent.handle(CommRoundEnded())) == ["adopted"]
    assert agent.plan == BETTER
    (ask,) = agent.handle(AgreementEnded())
    assert isinstance(ask, AskStep) and ask.question.goal == agent.goal == (50.0, 45.0)
    (move,) = agent.handle(Decided(StepAnswer(waypoint=(50.0, 46.0))))
    assert move == MoveTo(waypoint=(50.0, 46.0), proposed=(50.0, 46.0), origin=Origin.MODEL)
    assert agent.handle(Arrived()) == [] and agent.phase is Phase.IDLE
    assert agent.handle(began(2)) == [] and agent.phase is Phase.AGREEING


def test_equal_standing_is_equal_bytes() -> None:
    agent = make()
    planned(agent)
    agent.handle(CommRoundBegan())  # the first of a round carries the heartbeats
    first, second = agent.handle(CommRoundBegan()), agent.handle(CommRoundBegan())
    assert first == second
    agent.handle(Received(foreign(1, BETTER, origin(1))))
    agent.handle(CommRoundEnded())
    assert agent.handle(CommRoundBegan()) != first


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"noise", "version"),
        (foreign(0, None, None), "own_id"),
        (foreign(1, None, None, mission_text='{"spacing": 12}'), "other_mission"),
        (foreign(1, None, None, mission_text='{"spacing": -1}'), "other_mission"),
        (foreign(1, None, None, mission_text='{"max_step": 9}'), "malformed"),
        (foreign(1, None, None, mission_text="circle"), "malformed"),
    ],
)
def test_a_refused_message_is_counted_and_changes_nothing(payload: bytes, reason: str) -> None:
    agent = make()
    planned(agent)
    agent.handle(CommRoundBegan())
    before = agent.handle(CommRoundBegan())
    (note,) = agent.handle(Received(payload))
    assert isinstance(note, Note) and note.kind == "rejected_message" and note.detail["reason"] == reason
    assert agent.handle(CommRoundEnded()) == []
    assert agent.handle(CommRoundBegan()) == before
    assert agent.rejected == {reason: 1}


def test_an_older_message_does_not_replace_a_newer_one() -> None:
    agent = make()
    agent.handle(began())
    agent.handle(Planned(NoAnswer(cause="timeout", reason="late")))
    agent.handle(Received(foreign(1, BETTER, origin(1), sequence=5)))
    agent.handle(Received(foreign(1, PLAN, origin(1), sequence=4)))
    agent.handle(CommRoundEnded())
    assert agent.plan == BETTER


def test_without_a_plan_the_robot_holds_and_asks_again() -> None:
    agent = make()
    agent.handle(began())
    assert notes(agent.handle(Planned(NoAnswer(cause="server", reason="500")))) == ["no_plan"]
    assert agent.handle(CommRoundEnded()) == []
    note, move = agent.handle(AgreementEnded())
    assert isinstance(note, Note) and note.detail["cause"] == "no_goal"
    assert move == MoveTo(waypoint=(48.0, 50.0), proposed=None, origin=Origin.HOLD)
    assert agent.goal is None
    agent.handle(Arrived())
    (ask,) = agent.handle(began(2))
    assert isinstance(ask, AskPlan)


def test_a_silent_model_makes_the_robot_hold_and_note_why() -> None:
    agent = make()
    planned(agent)
    agent.handle(AgreementEnded())
    note, move = agent.handle(Decided(NoAnswer(cause="answer", reason="nothing usable")))
    assert note == Note("held", {"cause": "answer", "reason": "nothing usable"})
    assert isinstance(move, MoveTo) and move.origin is Origin.HOLD and move.waypoint == (48.0, 50.0)


def test_the_shield_alters_an_unsafe_step_and_notes_it() -> None:
    agent = make()
    agent.handle(began(r1=(52.0, 50.0)))
    agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
    agent.handle(AgreementEnded())
    note, move = agent.handle(Decided(StepAnswer(waypoint=(52.0, 50.0))))
    assert isinstance(note, Note) and note.kind == "shielded"
    assert isinstance(move, MoveTo) and move.origin is Origin.SHIELD
    assert move.waypoint == pytest.approx((48.5, 50.0))


def test_without_the_shield_the_model_is_obeyed_to_the_letter() -> None:
    agent = make(shield_on=False)
    planned(agent)
    agent.handle(AgreementEnded())
    (move,) = agent.handle(Decided(StepAnswer(waypoint=(99.0, 1.0))))
    assert move == MoveTo(waypoint=(99.0, 1.0), proposed=(99.0, 1.0), origin=Origin.MODEL)


def test_robot_without_shield_and_answer_holds_near_others() -> None:
    agent = make(shield_on=False)
    agent.handle(began(r1=(48.5, 50.0)))
    agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
    agent.handle(AgreementEnded())
    note, move = agent.handle(Decided(NoAnswer(cause="answer", reason="nothing usable")))
    assert note == Note("held", {"cause": "answer", "reason": "nothing usable"})
    assert move == MoveTo(waypoint=(48.0, 50.0), proposed=None, origin=Origin.HOLD)


def test_illegal_events_are_a_fault_of_the_runtime() -> None:
    with pytest.raises(IllegalEvent, match="Arrived in phase idle"):
        make().handle(Arrived())
    agent = make()
    agent.handle(Stopped())
    with pytest.raises(IllegalEvent, match="RoundBegan in phase stopped"):
        agent.handle(began())


def test_every_phase_but_the_last_can_be_left_and_is_reached() -> None:
    left = {phase for phase, _ in TRANSITIONS}
    reached = {phase for targets in TRANSITIONS.values() for phase in targets}
    assert left == set(Phase) - {Phase.STOPPED}
    assert reached == set(Phase)


def test_another_mission_makes_the_robot_plan_again() -> None:
    agent = make()
    planned(agent)
    for event in (AgreementEnded(), Decided(StepAnswer(waypoint=(48.0, 50.0))), Arrived()):
        agent.handle(event)
    new = MISSION.change(center=(60, 50), since=2)
    agent.handle(MissionGiven(mission=new, ordered_at=1))
    assert agent.mission == new and agent.plan is None and agent.claim.slot is None
    (ask,) = agent.handle(began(2))
    assert isinstance(ask, AskPlan) and ask.question.mission == new


@pytest.mark.parametrize(("kind", "detail"), [("unheard_of", {}), ("held", {"cause": "answer"}), ("killed", {"by": 1})])
def test_a_note_has_a_known_kind_and_its_details(kind: str, detail: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=f"no note '{kind}'"):
        Note(kind, detail)
