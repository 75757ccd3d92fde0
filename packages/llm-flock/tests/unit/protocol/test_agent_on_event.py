"""A robot that is asked on events only: what it remembers, when it asks, and that no step escapes checks and shield."""

from __future__ import annotations

import math
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rounds import round_began
from whole_agent import whole_agent

from llm_flock import shield
from llm_flock.agent import Agent
from llm_flock.arrays import Point
from llm_flock.events import AgreementEnded, Arrived, AskStep, Decided, Effect, MoveTo, Note, Origin, Phase, Planned
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, StepAnswer, StepQuestion
from llm_flock.protocol._agreement.assignment import IndexAssignment
from llm_flock.protocol._agreement.consensus import NoConsensus
from llm_flock.protocol._motion.pilot import Observation, Pilot
from llm_flock.protocol._motion.right_of_way import STALLED
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.protocol._parts import Parts
from llm_flock.protocol._verification.steps import judge
from llm_flock.protocol._verification.validator import Validator

MISSION = Mission(shape="triangle", n_robots=3)
PLAN = Plan.of(MISSION.ideal or ())
GOAL = PLAN.points[0]
START = (GOAL[0], GOAL[1] + 18.0)
WAY = tuple((GOAL[0], GOAL[1] + left) for left in (12.0, 6.0, 0.0))


def make(*, verify: bool = True, shield_on: bool = True) -> Agent:
    return whole_agent(0, MISSION, NoConsensus(), IndexAssignment(), shield_on=shield_on, verify=verify, on_event=True)


def begin(agent: Agent, position: Point, sensed: dict[int, Point] | None = None) -> list[Effect]:
    """One round up to the step: the effects of the end of the agreement."""
    if agent.phase is Phase.MOVING:
        agent.handle(Arrived())
    agent.handle(round_began(1, position, sensed))
    if agent.phase is Phase.PLANNING:
        agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
    return agent.handle(AgreementEnded())


def move(effects: list[Effect]) -> MoveTo:
    assert isinstance(effects[-1], MoveTo)
    return effects[-1]


def given_way(agent: Agent, way: tuple[Point, ...] = WAY) -> Agent:
    """The agent at START, answered with a path whose first step it has flown."""
    (ask,) = begin(agent, START)
    assert isinstance(ask, AskStep) and ask.question.horizon == 20
    effects = agent.handle(Decided(StepAnswer(waypoint=way[0], path=way[1:])))
    assert move(effects) == MoveTo(waypoint=way[0], proposed=way[0], origin=Origin.MODEL)
    assert not agent.on_path
    return agent


@pytest.mark.parametrize("verify", [True, False])
@pytest.mark.parametrize("shield_on", [True, False])
def test_path_is_flown_to_the_goal_and_held_without_a_question(verify: bool, shield_on: bool) -> None:
    agent = given_way(make(verify=verify, shield_on=shield_on))
    here = WAY[0]
    for waypoint in (*WAY[1:], GOAL, GOAL):
        assert move(begin(agent, here)) == MoveTo(waypoint=waypoint, proposed=waypoint, origin=Origin.MODEL)
        assert agent.on_path
        here = waypoint


def test_a_surprise_is_noted_and_asked_about() -> None:
    agent = given_way(make())
    note, ask = begin(agent, WAY[0], {1: (WAY[1][0] + 2.0, WAY[1][1])})
    assert note == Note("asked_again", {"reason": "neighbour"})
    assert isinstance(ask, AskStep) and ask.question.position == WAY[0] and not agent.on_path


def test_change_by_the_shield_is_remembered() -> None:
    agent = make()
    begin(agent, START, {1: (START[0] + 0.1, START[1] - 4.0)})
    flown = move(agent.handle(Decided(StepAnswer(waypoint=WAY[0], path=WAY[1:]))))
    assert flown.origin is Origin.SHIELD
    note, _ = begin(agent, flown.waypoint)
    assert note == Note("asked_again", {"reason": "altered"})


def test_a_failed_question_is_asked_again_in_the_next_round() -> None:
    agent = make()
    begin(agent, START)
    agent.handle(Decided(NoAnswer(cause="timeout", reason="late")))
    note, ask = begin(agent, START)
    assert note == Note("asked_again", {"reason": "no_answer"}) and isinstance(ask, AskStep)


def test_a_waypoint_that_does_not_pass_any_more_is_asked_about() -> None:
    agent = given_way(make(), (WAY[0], (WAY[0][0] + 6.0, WAY[0][1])))
    note, _ = begin(agent, WAY[0])
    assert note == Note("asked_again", {"reason": "unfit"})
    careless = given_way(make(verify=False), (WAY[0], (WAY[0][0] + 6.0, WAY[0][1])))
    assert move(begin(careless, WAY[0])).waypoint == (WAY[0][0] + 6.0, WAY[0][1])


def test_a_robot_that_lost_its_goal_starts_afresh() -> None:
    agent = given_way(make())
    agent._agreement.claim = type(agent.claim)(slot=None)
    assert move(begin(agent, WAY[0])).origin is Origin.HOLD
    agent._agreement.claim = type(agent.claim)(slot=0)
    (ask,) = begin(agent, WAY[0])
    assert isinstance(ask, AskStep)


def test_in_every_round_by_default() -> None:
    agent = whole_agent(0, MISSION, NoConsensus(), IndexAssignment(), shield_on=True)
    for _ in range(3):
        (ask,) = begin(agent, START)
        assert isinstance(ask, AskStep) and ask.question.horizon == 1
        agent.handle(Decided(StepAnswer(waypoint=START)))


PROJECT = shield.project
coordinate = st.floats(-15.0, 15.0)
place = st.tuples(coordinate, coordinate).map(lambda x: (GOAL[0] + x[0], GOAL[1] + x[1]))


@settings(max_examples=150, deadline=None)
@given(
    way=st.lists(place, min_size=1, max_size=6),
    crowd=st.lists(st.dictionaries(st.integers(1, 2), place, max_size=2), min_size=1, max_size=8),
    start=place,
)
def test_no_step_is_flown_unverified_or_unshielded(
    way: list[Point], crowd: list[dict[int, Point]], start: Point
) -> None:
    """With any path and any other robots near, a step is a fit wish that went through the shield, or a hold."""
    agent, here = make(), start
    for sensed in crowd:
        projected: list[Point] = []

        def spied(*args: Any, into: list[Point] = projected, **named: Any) -> Point:
            into.append(PROJECT(*args, **named))
            return into[-1]

        with patch.object(shield, "project", spied):
            effects = begin(agent, here, sensed)
            if isinstance(effects[-1], AskStep):
                effects = agent.handle(Decided(StepAnswer(waypoint=way[0], path=tuple(way[1:]))))
        step = move(effects)
        assert math.dist(here, step.waypoint) <= MISSION.max_step * (1 + 1e-9)
        if step.origin is Origin.HOLD:
            assert step.waypoint == here
        else:
            assert step.waypoint in projected
        if step.proposed is not None and step.origin is Origin.MODEL:
            question = StepQuestion(
                mission=MISSION,
                robot=0,
                round=1,
                position=here,
                neighbors=tuple(sensed.values()),
                plan=PLAN,
                slot=0,
            )
            fit = judge(question, StepAnswer(waypoint=step.proposed), shield_on=True).fit
            assert fit is not None and fit.waypoint == step.waypoint
        here = step.waypoint


def test_shield_measures_arrival_by_current_mission_spacing() -> None:
    """Kept 0.8 units from its goal by a body, a robot has arrived for a spacing of 20 units, and is blocked for 10."""
    goal = PLAN.points[0]
    here, body = (goal[0] - 0.8, *goal[1:]), (goal[0] - 0.8 + MISSION.safe_distance, *goal[1:])
    scene = Observation(round=1, position=here, sensed={1: body}, observed=(body,))
    for mission, blocked in ((MISSION, True), (MISSION.change(spacing=20.0), False)):
        parts = Parts(safety=ShieldedSafety(0, MISSION, 0.0))
        pilot = Pilot(0, MISSION, parts, noise_bound=0.0, on_event=False, fallback="hold")
        effects: list[Effect] = []
        for _ in range(STALLED + 1):
            pilot.decide(scene, mission, PLAN, 0, None)
            effects += pilot.take(StepAnswer(waypoint=goal))
        assert any(isinstance(effect, Note) and effect.kind == "deadlock" for effect in effects) is blocked
        assert (pilot.course is not None) is blocked


def test_a_step_that_ends_beside_a_corner_is_flown_to_the_corner() -> None:
    """From beside it the way on may not be free, and a model that rounds would give the same answer again and again."""
    disc = Obstacle(center=(50.0, 50.0), radius=6.0)
    mission = MISSION.change(obstacles=(disc,), shape="text:any")
    parts = Parts(safety=ShieldedSafety(0, mission, 0.0), verifier=Validator(shield_on=True))
    pilot = Pilot(0, mission, parts, noise_bound=0.0, on_event=False, fallback="breaker")
    plan = Plan.of([(58.0, 44.0), *PLAN.points[1:]])
    scene = Observation(round=1, position=(50.0, 59.5), sensed={}, observed=())
    (ask,) = pilot.decide(scene, mission, plan, 0, None)
    assert isinstance(ask, AskStep) and ask.question.corner is not None
    corner = ask.question.corner
    beside = (corner[0] + 0.1, corner[1] + 0.1)
    flown = move(pilot.take(StepAnswer(waypoint=beside)))
    assert math.dist(beside, corner) < 0.5 and flown.waypoint == pytest.approx(corner)
    assert flown.origin is Origin.CLIPPED
