"""The state machine: legal events, refused messages, notes, and the table that the docs draw."""

import pytest

from llm_flock.mission import Mission
from llm_flock.protocol.agent import Agent, IllegalEvent
from llm_flock.protocol.assignment import AuctionAssignment, IndexAssignment
from llm_flock.protocol.consensus import NoConsensus, PedigreeConsensus
from llm_flock.protocol.events import (
    TRANSITIONS,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    Decided,
    Effect,
    MoveTo,
    NegotiationEnded,
    Note,
    Origin,
    Phase,
    Planned,
    Received,
    RoundBegan,
    Stopped,
    TickBegan,
    TickEnded,
)
from llm_flock.protocol.messages import Message, Pedigree, encode
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, StepAnswer

MISSION = Mission(shape="triangle", n_robots=3)
PLAN = Plan.of([[50.0, 50.0], [60.0, 50.0], [55.0, 58.66]])
BETTER = Plan.of([[50.0, 45.0], [60.0, 45.0], [55.0, 53.66]])


def make(robot: int = 0, *, shield_on: bool = True) -> Agent:
    return Agent(robot, MISSION, PedigreeConsensus(), AuctionAssignment(), shield_on=shield_on)


def began(round_number: int = 1, **sensed: tuple[float, float]) -> RoundBegan:
    others = {int(name[1:]): x for name, x in sensed.items()}
    return RoundBegan(round=round_number, position=(48.0, 50.0), sensed=others, observed=tuple(others.values()))


def origin(proposer: int, digest: str = MISSION.digest) -> Pedigree:
    return Pedigree(mission=0, mission_digest=digest, epoch=0, neighbors=2, proposer=proposer, sequence=0)


def foreign(sender: int, plan: Plan | None, pedigree: Pedigree | None, sequence: int = 0) -> bytes:
    return encode(Message(sender=sender, sequence=sequence, neighbors=2, plan=plan, pedigree=pedigree))


def planned(agent: Agent) -> list[Effect]:
    agent.handle(began())
    return agent.handle(Planned(PlanAnswer(plan=PLAN, slot=1)))


def notes(effects: list[Effect]) -> list[str]:
    return [e.kind for e in effects if isinstance(e, Note)]


def test_a_whole_round() -> None:
    agent = make()
    (ask,) = agent.handle(began(r1=(58.0, 50.0)))
    assert isinstance(ask, AskPlan) and ask.question.neighbors == ((58.0, 50.0),)
    assert agent.influence == pytest.approx(1 / 3)
    assert notes(agent.handle(Planned(PlanAnswer(plan=PLAN, slot=1)))) == ["proposed"]
    assert agent.goal == (50.0, 50.0)
    (said,) = agent.handle(TickBegan())
    assert isinstance(said, Broadcast)
    assert agent.handle(Received(foreign(1, BETTER, origin(1)))) == []
    assert notes(agent.handle(TickEnded())) == ["adopted"]
    assert agent.plan == BETTER
    (ask,) = agent.handle(NegotiationEnded())
    assert isinstance(ask, AskStep) and ask.question.goal == agent.goal == (50.0, 45.0)
    (move,) = agent.handle(Decided(StepAnswer(waypoint=(50.0, 46.0))))
    assert move == MoveTo(waypoint=(50.0, 46.0), proposed=(50.0, 46.0), origin=Origin.MODEL)
    assert agent.handle(Arrived()) == [] and agent.phase is Phase.IDLE
    assert agent.handle(began(2)) == [] and agent.phase is Phase.NEGOTIATING


def test_equal_standing_is_equal_bytes() -> None:
    agent = make()
    planned(agent)
    first, second = agent.handle(TickBegan()), agent.handle(TickBegan())
    assert first == second
    agent.handle(Received(foreign(1, BETTER, origin(1))))
    agent.handle(TickEnded())
    assert agent.handle(TickBegan()) != first


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"noise", "malformed"),
        (foreign(0, None, None), "own_id"),
        (foreign(1, PLAN, origin(1, "f" * 16)), "other_mission"),
    ],
)
def test_a_refused_message_is_counted_and_changes_nothing(payload: bytes, reason: str) -> None:
    agent = make()
    planned(agent)
    before = agent.handle(TickBegan())
    (note,) = agent.handle(Received(payload))
    assert isinstance(note, Note) and note.kind == "rejected_message" and note.detail["reason"] == reason
    assert agent.handle(TickEnded()) == []
    assert agent.handle(TickBegan()) == before
    assert agent.rejected == {reason: 1}


def test_an_older_message_does_not_replace_a_newer_one() -> None:
    agent = make()
    agent.handle(began())
    agent.handle(Planned(NoAnswer(cause="timeout", reason="late")))
    agent.handle(Received(foreign(1, BETTER, origin(1), sequence=5)))
    agent.handle(Received(foreign(1, PLAN, origin(1), sequence=4)))
    agent.handle(TickEnded())
    assert agent.plan == BETTER


def test_without_a_plan_the_robot_holds_and_asks_again() -> None:
    agent = make()
    agent.handle(began())
    assert notes(agent.handle(Planned(NoAnswer(cause="server", reason="500")))) == ["no_plan"]
    assert agent.handle(TickEnded()) == []
    note, move = agent.handle(NegotiationEnded())
    assert isinstance(note, Note) and note.detail["cause"] == "no_goal"
    assert move == MoveTo(waypoint=(48.0, 50.0), proposed=None, origin=Origin.HOLD)
    assert agent.goal is None
    agent.handle(Arrived())
    (ask,) = agent.handle(began(2))
    assert isinstance(ask, AskPlan)


def test_a_silent_model_makes_the_robot_hold_and_says_why() -> None:
    agent = make()
    planned(agent)
    agent.handle(NegotiationEnded())
    note, move = agent.handle(Decided(NoAnswer(cause="answer", reason="nothing usable")))
    assert note == Note("held", {"cause": "answer", "reason": "nothing usable"})
    assert isinstance(move, MoveTo) and move.origin is Origin.HOLD and move.waypoint == (48.0, 50.0)


def test_the_shield_alters_an_unsafe_step_and_says_so() -> None:
    agent = make()
    agent.handle(began(r1=(52.0, 50.0)))
    agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
    agent.handle(NegotiationEnded())
    note, move = agent.handle(Decided(StepAnswer(waypoint=(52.0, 50.0))))
    assert isinstance(note, Note) and note.kind == "shielded"
    assert isinstance(move, MoveTo) and move.origin is Origin.SHIELD
    assert move.waypoint == pytest.approx((48.5, 50.0))


def test_without_the_shield_the_model_is_obeyed_to_the_letter() -> None:
    agent = make(shield_on=False)
    planned(agent)
    agent.handle(NegotiationEnded())
    (move,) = agent.handle(Decided(StepAnswer(waypoint=(99.0, 1.0))))
    assert move == MoveTo(waypoint=(99.0, 1.0), proposed=(99.0, 1.0), origin=Origin.MODEL)


def test_without_the_shield_a_robot_without_an_answer_holds_whoever_is_near() -> None:
    agent = make(shield_on=False)
    agent.handle(began(r1=(48.5, 50.0)))
    agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
    agent.handle(NegotiationEnded())
    note, move = agent.handle(Decided(NoAnswer(cause="answer", reason="nothing usable")))
    assert note == Note("held", {"cause": "answer", "reason": "nothing usable"})
    assert move == MoveTo(waypoint=(48.0, 50.0), proposed=None, origin=Origin.HOLD)


def test_baseline_keeps_the_index_of_its_own_model() -> None:
    agent = Agent(0, MISSION, NoConsensus(), IndexAssignment(), shield_on=False)
    planned(agent)
    agent.handle(Received(foreign(1, BETTER, origin(1))))
    agent.handle(TickEnded())
    assert (agent.plan, agent.claim.slot) == (PLAN, 1)


def test_a_lost_auction_is_noted() -> None:
    agent = make()
    planned(agent)
    rival = encode(
        Message(
            sender=1,
            sequence=0,
            neighbors=2,
            plan=PLAN,
            pedigree=origin(1),
            slot=0,
            table=((0, 0.0, 1), (0, 0.0, -1), (0, 0.0, -1)),
        )
    )
    agent.handle(Received(rival))
    (note,) = agent.handle(TickEnded())
    assert note == Note("claimed", {"slot": 2, "before": 0})


def test_with_every_slot_lost_the_robot_holds() -> None:
    agent = make(2)
    planned(agent)
    won = ((9, 0.0, 0), (9, 0.0, 1), (9, 0.0, 0))
    agent.handle(
        Received(encode(Message(sender=1, sequence=0, neighbors=2, plan=PLAN, pedigree=origin(1), slot=0, table=won)))
    )
    agent.handle(TickEnded())
    note, _ = agent.handle(NegotiationEnded())
    assert isinstance(note, Note) and "claimed by others" in note.detail["reason"]


def test_illegal_events_are_a_fault_of_the_runtime() -> None:
    with pytest.raises(IllegalEvent, match="Arrived in phase idle"):
        make().handle(Arrived())
    agent = make()
    agent.handle(Stopped())
    with pytest.raises(IllegalEvent):
        agent.handle(began())


def test_every_phase_but_the_last_can_be_left_and_is_reached() -> None:
    left = {phase for phase, _ in TRANSITIONS}
    reached = {phase for targets in TRANSITIONS.values() for phase in targets}
    assert left == set(Phase) - {Phase.STOPPED}
    assert reached == set(Phase)
