"""The agent's place: claimed, lost, waited for, and looked for."""

from __future__ import annotations

import math

from one_agent import BETTER, MISSION, PLAN, foreign, make, notes, origin, planned
from tables import told
from whole_agent import whole_agent

from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskStep,
    CommRoundEnded,
    Decided,
    MoveTo,
    Note,
    Origin,
    Planned,
    Received,
    RoundBegan,
)
from llm_flock.message import Message, Provenance, encode
from llm_flock.planner import PlanAnswer, StepAnswer
from llm_flock.protocol._agreement.assignment import IndexAssignment
from llm_flock.protocol._agreement.consensus import NoConsensus
from llm_flock.protocol._membership.search import ALONE


def test_baseline_keeps_the_index_of_its_own_model() -> None:
    agent = whole_agent(0, MISSION, NoConsensus(), IndexAssignment(), shield_on=False)
    planned(agent)
    agent.handle(Received(foreign(1, BETTER, origin(1))))
    agent.handle(CommRoundEnded())
    assert (agent.plan, agent.claim.slot) == (PLAN, 1)
    (ask,) = agent.handle(AgreementEnded())
    assert isinstance(ask, AskStep) and ask.question.goal == PLAN.points[1]


def test_a_lost_auction_is_noted() -> None:
    agent = make()
    planned(agent)
    rival = encode(
        Message(
            sender=1,
            sequence=0,
            degree=2,
            plan=PLAN,
            provenance=origin(1),
            slot=0,
            **told(((0, 0.0, 1), (0, 0.0, -1), (0, 0.0, -1))),
        )
    )
    agent.handle(Received(rival))
    (note,) = agent.handle(CommRoundEnded())
    assert note == Note("claimed", {"slot": 2, "before": 0})


def test_claims_on_another_plan_are_not_merged() -> None:
    """Slot 0 of another plan is another place: losing that one means nothing here."""
    agent = make(2)
    planned(agent)
    before = agent.claim
    won = ((9, 0.0, 1), (9, 0.0, 0), (0, 0.0, -1))
    weak = Provenance(mission=0, mission_digest=MISSION.digest, epoch=0, degree=0, proposer=0, sequence=0)
    standing = Message(sender=1, sequence=0, degree=0, plan=BETTER, provenance=weak, slot=0, **told(won))
    agent.handle(Received(encode(standing)))
    agent.handle(CommRoundEnded())
    assert agent.plan == PLAN, "the other plan ranks lower"
    assert (agent.claim.slot, agent.claim.table) == (before.slot, before.table)


def test_with_every_slot_lost_the_robot_waits_out_of_the_way() -> None:
    agent = make(2)
    planned(agent)
    won = ((9, 0.0, 0), (9, 0.0, 1), (9, 0.0, 0))
    agent.handle(
        Received(encode(Message(sender=1, sequence=0, degree=2, plan=PLAN, provenance=origin(1), slot=0, **told(won))))
    )
    agent.handle(CommRoundEnded())
    assert agent.claim.slot is None
    (ask,) = agent.handle(AgreementEnded())
    assert isinstance(ask, AskStep) and ask.question.slot is None, "it stands where another one has to go"
    assert min(math.dist(ask.question.goal, x) for x in PLAN.points) >= 2 * MISSION.safe_distance
    agent.handle(Decided(StepAnswer(waypoint=ask.question.goal)))
    agent.handle(Arrived())
    agent.handle(RoundBegan(round=2, position=ask.question.goal, degree=0, sensed={}, observed=()))
    note, _ = agent.handle(AgreementEnded())
    assert isinstance(note, Note) and "taken by others" in note.detail["reason"]


def test_robot_without_place_that_hears_none_seeks_the_others() -> None:
    """A liar told it that every place is taken, and it is out of reach of all: what it knows will stay old."""
    agent = make(2)
    planned(agent)
    won = ((9, 0.0, 0), (9, 0.0, 1), (9, 0.0, 0))
    message = Message(sender=1, sequence=0, degree=2, plan=PLAN, provenance=origin(1), slot=0, **told(won))
    agent.handle(Received(encode(message)))
    agent.handle(CommRoundEnded())
    here, moves = (12.0, 12.0), list[MoveTo]()

    def flown(number: int, sensed: dict[int, tuple[float, ...]]) -> MoveTo:
        *_, last = agent.handle(AgreementEnded())
        if isinstance(last, AskStep):
            *_, last = agent.handle(Decided(StepAnswer(waypoint=here)))
        assert isinstance(last, MoveTo)
        agent.handle(Arrived())
        agent.handle(RoundBegan(round=number, position=here, degree=len(sensed), sensed=sensed, observed=()))
        return last

    assert agent.claim.slot is None
    moves = [flown(number, {}) for number in range(2, 12)]
    seeks = [move.origin is Origin.GEOMETRY for move in moves]
    assert seeks.index(True) == ALONE - 1 and all(seeks[ALONE - 1 :])
    assert math.dist(moves[-1].waypoint, MISSION.center) < math.dist(here, MISSION.center) - 5.0
    agent.handle(Received(encode(message), 1))
    flown(12, {1: (20.0, 12.0)})
    assert flown(13, {1: (20.0, 12.0)}).waypoint == here, "in touch, it waits for what the others say"


def test_a_robot_at_its_place_goes_to_look_for_the_others() -> None:
    """No other was ever heard: two places are vacant as far as robot 0 knows."""
    agent = make()
    goals: list[tuple[float, ...]] = []
    kinds: list[str] = []
    for number in range(1, 12):
        here = (50.0, 50.0) if number < 8 else goals[-1]
        agent.handle(RoundBegan(round=number, position=here, degree=0, sensed={}, observed=()))
        if number == 1:
            agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
        *said, ask = agent.handle(AgreementEnded())
        assert isinstance(ask, AskStep)
        kinds += notes(said)
        goals.append(ask.question.goal)
        agent.handle(Decided(StepAnswer(waypoint=here)))
        agent.handle(Arrived())
    assert goals[0] == (50.0, 50.0)
    assert set(goals[1:]) >= {(55.0, 58.66), (60.0, 50.0)}
    assert kinds[0] == "search"
