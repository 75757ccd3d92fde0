"""The state machine: legal events, refused messages, notes, and the table that the docs draw."""

import math

import pytest

from llm_flock.mission import Mission
from llm_flock.protocol.agent import Agent, IllegalEvent
from llm_flock.protocol.assignment import IndexAssignment
from llm_flock.protocol.auction import AuctionAssignment
from llm_flock.protocol.consensus import NoConsensus, PedigreeConsensus
from llm_flock.protocol.events import (
    TRANSITIONS,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    Decided,
    Effect,
    MissionGiven,
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
from llm_flock.protocol.judge import REMEMBERED, Judge
from llm_flock.protocol.messages import Message, Pedigree, Stamp, decode, encode
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, StepAnswer

MISSION = Mission(shape="triangle", n_robots=3)
PLAN = Plan.of([[50.0, 50.0], [60.0, 50.0], [55.0, 58.66]])
BETTER = Plan.of([[50.0, 45.0], [60.0, 45.0], [55.0, 53.66]])


def make(robot: int = 0, *, shield_on: bool = True) -> Agent:
    return Agent(robot, MISSION, PedigreeConsensus(), AuctionAssignment(), shield_on=shield_on)


def began(round_number: int = 1, **sensed: tuple[float, float]) -> RoundBegan:
    others = {int(name[1:]): x for name, x in sensed.items()}
    return RoundBegan(
        round=round_number,
        position=(48.0, 50.0),
        neighbors=len(others),
        sensed=others,
        observed=tuple(others.values()),
    )


def origin(proposer: int, digest: str = MISSION.digest) -> Pedigree:
    return Pedigree(mission=0, mission_digest=digest, epoch=0, neighbors=2, proposer=proposer, sequence=0)


def foreign(
    sender: int, plan: Plan | None, pedigree: Pedigree | None, sequence: int = 0, mission_text: str | None = None
) -> bytes:
    """A message; one that says a mission claims a stamp that is higher than any and stands for something else."""
    message = Message(
        sender=sender,
        sequence=sequence,
        neighbors=2,
        plan=plan,
        pedigree=pedigree,
        mission=Stamp(0 if mission_text is None else 7, "0" * 16),
        mission_text=mission_text,
    )
    return encode(message)


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
    agent.handle(TickBegan())  # the first of a round carries the heartbeats
    first, second = agent.handle(TickBegan()), agent.handle(TickBegan())
    assert first == second
    agent.handle(Received(foreign(1, BETTER, origin(1))))
    agent.handle(TickEnded())
    assert agent.handle(TickBegan()) != first


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
    agent.handle(TickBegan())
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
    (ask,) = agent.handle(NegotiationEnded())
    assert isinstance(ask, AskStep) and ask.question.goal == PLAN.points[1]


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


def test_claims_on_another_plan_are_not_merged() -> None:
    """Slot 0 of another plan is another place: losing that one means nothing here."""
    agent = make(2)
    planned(agent)
    before = agent.claim
    won = ((9, 0.0, 1), (9, 0.0, 0), (0, 0.0, -1))
    weak = Pedigree(mission=0, mission_digest=MISSION.digest, epoch=0, neighbors=0, proposer=0, sequence=0)
    standing = Message(sender=1, sequence=0, neighbors=0, plan=BETTER, pedigree=weak, slot=0, table=won)
    agent.handle(Received(encode(standing)))
    agent.handle(TickEnded())
    assert agent.plan == PLAN, "the other plan ranks lower"
    assert (agent.claim.slot, agent.claim.table) == (before.slot, before.table)


def test_with_every_slot_lost_the_robot_waits_out_of_the_way() -> None:
    agent = make(2)
    planned(agent)
    won = ((9, 0.0, 0), (9, 0.0, 1), (9, 0.0, 0))
    agent.handle(
        Received(encode(Message(sender=1, sequence=0, neighbors=2, plan=PLAN, pedigree=origin(1), slot=0, table=won)))
    )
    agent.handle(TickEnded())
    assert agent.claim.slot is None
    (ask,) = agent.handle(NegotiationEnded())
    assert isinstance(ask, AskStep) and ask.question.slot is None, "it stands where another one has to go"
    assert min(math.dist(ask.question.goal, x) for x in PLAN.points) >= 2 * MISSION.safe_distance
    agent.handle(Decided(StepAnswer(waypoint=ask.question.goal)))
    agent.handle(Arrived())
    agent.handle(RoundBegan(round=2, position=ask.question.goal, neighbors=0, sensed={}, observed=()))
    note, _ = agent.handle(NegotiationEnded())
    assert isinstance(note, Note) and "taken by others" in note.detail["reason"]


def test_a_robot_at_its_place_goes_to_look_for_the_others() -> None:
    """Nobody was ever heard: two places are vacant as far as robot 0 knows."""
    agent = make()
    goals: list[tuple[float, ...]] = []
    kinds: list[str] = []
    for number in range(1, 12):
        here = (50.0, 50.0) if number < 8 else goals[-1]
        agent.handle(RoundBegan(round=number, position=here, neighbors=0, sensed={}, observed=()))
        if number == 1:
            agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
        *said, ask = agent.handle(NegotiationEnded())
        assert isinstance(ask, AskStep)
        kinds += notes(said)
        goals.append(ask.question.goal)
        agent.handle(Decided(StepAnswer(waypoint=here)))
        agent.handle(Arrived())
    assert goals[0] == (50.0, 50.0)
    assert set(goals[1:]) >= {(55.0, 58.66), (60.0, 50.0)}
    assert kinds[0] == "search"


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


# Verification: whatever fails is neither followed nor forwarded nor flown.

IDEAL = Plan.of(MISSION.ideal or ())
TURNED = Plan.of([[50.0, 44.23], [45.0, 52.89], [55.0, 52.89]])
CRUDE = Plan.of([[50.3, 44.2], [44.7, 52.9], [55.0, 53.2]])


def checking(robot: int = 0, *, shield_on: bool = True) -> Agent:
    return Agent(robot, MISSION, PedigreeConsensus(), AuctionAssignment(), shield_on=shield_on, verify=True)


def deciding(agent: Agent, plan: Plan = IDEAL) -> Agent:
    """The agent at (48, 50) with a goal, waiting for the answer to its step question."""
    agent.handle(began())
    agent.handle(Planned(PlanAnswer(plan=plan, slot=0)))
    agent.handle(NegotiationEnded())
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
    agent.handle(TickBegan())
    for k in range(3):
        effects = agent.handle(Received(foreign(1, PLAN, origin(2), sequence=k)))
        if k == 0:
            (note,) = effects
            assert isinstance(note, Note) and note.kind == "rejected_message"
            assert note.detail["reason"] == "unverified_plan" and "mean of its points" in note.detail["detail"]
        else:
            assert effects == [], "noted once"
        assert agent.handle(TickEnded()) == []
        (said,) = agent.handle(TickBegan())
        assert isinstance(said, Broadcast) and decode(said.payload, 3, 2).plan_digest == IDEAL.digest
    assert agent.plan == IDEAL
    assert agent.rejected == {"unverified_plan": 3}


def test_a_robot_without_a_plan_takes_over_no_bad_one_and_names_its_fallback() -> None:
    agent = checking()
    agent.handle(began())
    agent.handle(Planned(NoAnswer(cause="answer", reason="none")))
    agent.handle(Received(foreign(1, PLAN, origin(1))))
    assert agent.handle(TickEnded()) == [] and agent.plan is None
    agent.handle(Received(foreign(2, IDEAL, origin(2))))
    fallback, adopted, _ = agent.handle(TickEnded())
    assert fallback == Note("fallback", {"question": "plan", "by": "neighbour", "cause": "answer", "reason": "none"})
    assert adopted == Note("adopted", {"plan": IDEAL.digest, "from": 2})


def test_an_exact_plan_beats_a_crude_one_of_higher_influence() -> None:
    agent = checking(2)
    agent.handle(began(r1=(58.0, 50.0)))
    agent.handle(Planned(PlanAnswer(plan=CRUDE, slot=0)))
    assert agent.plan == CRUDE
    low = Pedigree(mission=0, mission_digest=MISSION.digest, epoch=0, neighbors=0, proposer=0, sequence=0)
    agent.handle(Received(foreign(1, CRUDE, origin(1))))
    agent.handle(Received(foreign(0, TURNED, low)))
    agent.handle(TickEnded())
    assert agent.plan == TURNED
    agent.handle(Received(foreign(1, CRUDE, origin(1), sequence=1)))
    assert agent.handle(TickEnded()) == []


@pytest.mark.parametrize("accepted", [True, False])
def test_an_overshooting_answer_is_clipped_to_the_goal_and_counted_as_the_shields_work(accepted: bool) -> None:
    agent = deciding(checking())
    assert agent.goal is not None
    (x, y), (gx, gy) = agent.position, agent.goal
    beyond = (x + 1.9 * (gx - x), y + 1.9 * (gy - y))
    answer = StepAnswer(waypoint=beyond) if accepted else NoAnswer(cause="answer", reason="3 tries", waypoint=beyond)
    note, move = agent.handle(Decided(answer))
    assert note == Note("shielded", {"proposed": beyond, "flown": (gx, gy)})
    assert move == MoveTo(waypoint=(gx, gy), proposed=beyond, origin=Origin.SHIELD)


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


def test_a_fallback_is_noted_and_counted_as_one() -> None:
    failure = NoAnswer(cause="answer", reason="3 tries")
    agent = checking()
    agent.handle(began())
    note, proposed = agent.handle(Planned(PlanAnswer(plan=IDEAL, slot=0, instead_of=failure)))
    assert note == Note("fallback", {"question": "plan", "by": "geometry", "cause": "answer", "reason": "3 tries"})
    assert isinstance(proposed, Note) and proposed.kind == "proposed"
    agent.handle(NegotiationEnded())
    assert agent.goal is not None
    note, move = agent.handle(Decided(StepAnswer(waypoint=agent.goal, instead_of=failure)))
    assert isinstance(note, Note) and note.kind == "fallback" and note.detail["question"] == "step"
    assert isinstance(move, MoveTo) and move.origin is Origin.FALLBACK


def test_refused_plans_do_not_fill_the_memory() -> None:
    judge = Judge(MISSION, verify=True, shield_on=True)
    plans = [Plan.of([[float(k), 0.0]]) for k in range(REMEMBERED + 1)]
    assert all(judge.is_new(plan) for plan in plans)
    assert not judge.is_new(plans[-1]) and judge.is_new(plans[0])


def test_another_mission_makes_the_robot_plan_anew() -> None:
    agent = make()
    planned(agent)
    for event in (NegotiationEnded(), Decided(StepAnswer(waypoint=(48.0, 50.0))), Arrived()):
        agent.handle(event)
    new = MISSION.change(center=(60, 50), since=2)
    agent.handle(MissionGiven(mission=new))
    assert agent.mission == new and agent.plan is None and agent.claim.slot is None
    (ask,) = agent.handle(began(2))
    assert isinstance(ask, AskPlan) and ask.question.mission == new
