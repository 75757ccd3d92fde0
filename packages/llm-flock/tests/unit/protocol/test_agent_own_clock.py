"""A robot that keeps no common rounds: it communicates and senses while its model thinks and its body flies."""

from __future__ import annotations

from whole_agent import whole_agent

from llm_flock.agent import Agent
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Effect,
    HeartbeatDue,
    MissionGiven,
    MoveTo,
    Note,
    Origin,
    Phase,
    Planned,
    Received,
    RoundBegan,
    Sensed,
)
from llm_flock.message import decode
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, StepAnswer
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus
from llm_flock.protocol._membership.liveness import NO_PLAN

MISSION = Mission(shape="triangle", n_robots=3)
PLAN = Plan.of([[50.0, 50.0], [60.0, 50.0], [55.0, 58.66]])
BETTER = Plan.of([[50.0, 45.0], [60.0, 45.0], [55.0, 53.66]])
HERE = (48.0, 50.0)


def make(robot: int = 0) -> Agent:
    return whole_agent(robot, MISSION, ProvenanceConsensus(), AuctionAssignment(), shield_on=True, own_clock=True)


def seen(at: tuple[float, float] = HERE, **others: tuple[float, float]) -> Sensed:
    sensed = {int(name[1:]): x for name, x in others.items()}
    return Sensed(position=at, degree=len(sensed), sensed=sensed, observed=tuple(sensed.values()))


def began(number: int = 1, at: tuple[float, float] = HERE) -> RoundBegan:
    return RoundBegan(round=number, position=at, degree=0, sensed={}, observed=())


def said_by(robot: int, plan: Plan, *, degree: int) -> bytes:
    """What another robot says that has proposed a plan."""
    other = make(robot)
    others = {f"r{j}": (50.0 + j, 60.0) for j in range(3) if j != robot}
    other.handle(seen((50.0 + robot, 55.0), **dict(list(others.items())[:degree])))
    other.handle(HeartbeatDue(1))
    other.handle(began())
    other.handle(Planned(PlanAnswer(plan=plan, slot=robot)))
    (broadcast,) = other.handle(CommRoundBegan())
    assert isinstance(broadcast, Broadcast)
    return broadcast.payload


def kinds(effects: list[Effect]) -> list[str]:
    return [effect.kind for effect in effects if isinstance(effect, Note)]


def deciding(agent: Agent, plan: Plan = PLAN) -> Agent:
    agent.handle(seen())
    agent.handle(HeartbeatDue(1))
    agent.handle(began())
    agent.handle(Planned(PlanAnswer(plan=plan, slot=0)))
    (ask,) = agent.handle(AgreementEnded())
    assert isinstance(ask, AskStep)
    return agent


def test_robot_communicates_before_its_first_round() -> None:
    agent = make()
    agent.handle(seen())
    agent.handle(HeartbeatDue(1))
    agent.handle(Received(said_by(1, PLAN, degree=2)))
    assert "adopted" in kinds(agent.handle(CommRoundEnded()))
    assert agent.phase is Phase.IDLE and agent.plan == PLAN
    assert agent.handle(began()) == [] and agent.phase is Phase.AGREEING


def test_hearts_beat_by_periods_and_not_by_rounds() -> None:
    agent = make()
    agent.handle(seen())
    beats: list[int] = []
    for number in range(1, 4):
        agent.handle(HeartbeatDue(number))
        (broadcast,) = agent.handle(CommRoundBegan())
        assert isinstance(broadcast, Broadcast)
        said = decode(broadcast.payload, 3, 2).beats
        assert said is not None
        beats.append(said[0])
        agent.handle(began(number))
        agent.handle(Planned(NoAnswer(cause="answer", reason="none")))
        agent.handle(AgreementEnded())
        agent.handle(Arrived())
    assert beats == [4 + NO_PLAN, 8 + NO_PLAN, 12 + NO_PLAN]


def test_a_plan_that_was_overtaken_is_dropped() -> None:
    agent = make()
    agent.handle(seen())
    agent.handle(HeartbeatDue(1))
    (ask,) = agent.handle(began())
    assert isinstance(ask, AskPlan)
    agent.handle(Received(said_by(2, BETTER, degree=2)))
    agent.handle(CommRoundEnded())
    assert agent.phase is Phase.PLANNING and agent.plan == BETTER
    assert agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0))) == [Note("stale_answer", {"about": "plan"})]
    assert agent.plan == BETTER and agent.phase is Phase.AGREEING


def test_a_step_is_asked_for_again_when_its_plan_has_changed() -> None:
    agent = deciding(make())
    agent.handle(Received(said_by(2, BETTER, degree=2)))
    effects = agent.handle(CommRoundEnded())
    assert kinds(effects)[-1] == "stale_question"
    assert isinstance(effects[-1], AskStep) and effects[-1].question.plan == BETTER
    (move,) = agent.handle(Decided(StepAnswer(waypoint=HERE)))
    assert isinstance(move, MoveTo) and agent.phase is Phase.MOVING


def test_an_answer_about_a_mission_of_before_is_dropped() -> None:
    agent = deciding(make())
    agent.handle(MissionGiven(mission=MISSION.change(center=[40.0, 40.0]), ordered_at=1))
    assert agent.ordered_at == 1 and agent.authorization == b"", "without keys nothing is signed"
    effects = agent.handle(Decided(StepAnswer(waypoint=(50.0, 50.0))))
    assert kinds(effects) == ["stale_answer", "held"]
    assert isinstance(effects[-1], MoveTo) and effects[-1].origin is Origin.HOLD and agent.phase is Phase.MOVING


def test_step_is_shielded_by_the_newest_observation() -> None:
    agent = deciding(make())
    agent.handle(seen(r1=(53.0, 50.0)))
    effects = agent.handle(Decided(StepAnswer(waypoint=(50.0, 50.0))))
    (move,) = [effect for effect in effects if isinstance(effect, MoveTo)]
    assert move.origin is Origin.SHIELD and move.waypoint[0] <= 49.0 + 1e-9


def test_robot_communicates_while_it_flies() -> None:
    agent = deciding(make())
    agent.handle(Decided(StepAnswer(waypoint=(50.0, 50.0))))
    agent.handle(Received(said_by(2, BETTER, degree=2)))
    assert "adopted" in kinds(agent.handle(CommRoundEnded())) and agent.phase is Phase.MOVING
    agent.handle(Arrived())
    assert agent.phase is Phase.IDLE
