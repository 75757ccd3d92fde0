"""The rendezvous of a large team in pieces: a circle that is the same for every turn of its shape."""

import math
from itertools import pairwise

import numpy as np
import pytest
from tables import told
from whole_agent import whole_agent

from llm_flock.agent import Agent
from llm_flock.arrays import Point
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskStep,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Effect,
    Note,
    Planned,
    Received,
    RoundBegan,
)
from llm_flock.message import NO_OWNER, BidEntry, Message, Provenance, encode
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer, StepAnswer
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus
from llm_flock.protocol._membership.joint import ROUNDS, VERSION
from llm_flock.protocol._membership.rendezvous import HOLD, LINK, WITHIN, landing, meeting_places, meeting_point

SQUARE = Mission(shape="square", n_robots=40, arena=((-100, -100), (200, 200)))
PLAN = Plan.of(SQUARE.ideal or ())
FREE: BidEntry = (0, 0.0, NO_OWNER)


def owned(count: int) -> tuple[BidEntry, ...]:
    return tuple((0, -1.0, a) if a < count else FREE for a in range(len(PLAN)))


def test_places_of_any_turn_lie_on_one_circle_seen_from_centre() -> None:
    angle = 0.6
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    center = np.array(SQUARE.center)
    turned = Plan.of(((PLAN.array - center) @ turn.T + center).tolist())
    radii: list[float] = []
    for plan in (PLAN, turned):
        places = meeting_places(SQUARE, plan, owned(1))
        offsets, wanted = places.array - center, plan.array - center
        radii.extend(np.linalg.norm(offsets, axis=1).tolist())
        across = offsets[:, 0] * wanted[:, 1] - offsets[:, 1] * wanted[:, 0]
        assert np.abs(across).max() < 1e-3 and ((offsets * wanted).sum(axis=1) > 0).all()
    assert max(radii) - min(radii) < 1e-5
    assert radii[0] == pytest.approx(np.linalg.norm(PLAN.array - center, axis=1).mean(), abs=1e-5)


def test_with_half_of_the_places_taken_they_are_where_they_are() -> None:
    assert meeting_places(SQUARE, PLAN, owned(19)) != PLAN
    assert meeting_places(SQUARE, PLAN, owned(20)) == PLAN


@pytest.mark.parametrize("shape", ["grid", "line", "cross"])
def test_shapes_with_places_near_the_centre_have_no_such_circle(shape: str) -> None:
    mission = Mission(shape=shape, n_robots=41, arena=((-200, -200), (300, 300)))
    plan = Plan.of(mission.ideal or ())
    assert meeting_places(mission, plan, (FREE,) * len(plan)) == plan


def test_places_in_the_centre_have_no_direction() -> None:
    plan = Plan.of([SQUARE.center] * 2)
    assert meeting_places(SQUARE, plan, (FREE,) * 2) == plan


def test_obstacle_on_the_circle_keeps_the_places_as_they_are() -> None:
    there = meeting_places(SQUARE, PLAN, owned(1)).points[3]
    mission = SQUARE.model_copy(update={"obstacles": (Obstacle(center=there, radius=1.0),)})
    assert meeting_places(mission, PLAN, owned(1)) == PLAN


def test_robot_missing_most_of_a_large_team_goes_to_meet_it() -> None:
    agent = whole_agent(0, SQUARE, ProvenanceConsensus(), AuctionAssignment(), shield_on=True)
    here = PLAN.points[0]
    agent.handle(RoundBegan(round=1, position=here, sensed={}, observed=(), degree=0))
    agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
    for event in (CommRoundBegan(), CommRoundEnded()):
        agent.handle(event)
    effects = agent.handle(AgreementEnded())
    ask = effects[-1]
    assert isinstance(ask, AskStep) and agent.claim.slot == 0
    assert ask.question.target == meeting_places(SQUARE, PLAN, owned(1)).points[0] != here


# ------------------------------------------------------------------ waiting for each other

CENTER = SQUARE.center
RADIUS = WITHIN * float(np.linalg.norm(PLAN.array - np.array(CENTER), axis=1).mean())


def on_circle(along: float) -> Point:
    """A point of the circle, so far from where it meets the x axis [units]."""
    return CENTER[0] + RADIUS * math.cos(along / RADIUS), CENTER[1] + RADIUS * math.sin(along / RADIUS)


def went(along: float, others: list[float]) -> float:
    """How far along the circle a robot there goes."""
    point = meeting_point(SQUARE, PLAN, on_circle(along), [on_circle(other) for other in others])
    assert point is not None
    assert math.dist(point, CENTER) == pytest.approx(RADIUS)
    turn = math.atan2(point[1] - CENTER[1], point[0] - CENTER[0]) - along / RADIUS
    return RADIUS * ((turn + math.pi) % math.tau - math.pi)


@pytest.mark.parametrize("away", [1.0, RADIUS, 3 * RADIUS])
def test_a_robot_comes_to_the_circle_in_its_own_direction(away: float) -> None:
    here = (CENTER[0] - 0.6 * away, CENTER[1] + 0.8 * away)
    there = (CENTER[0] - 0.6 * RADIUS, CENTER[1] + 0.8 * RADIUS)
    assert landing(SQUARE, PLAN, here) == pytest.approx(there)
    if away != RADIUS:
        assert meeting_point(SQUARE, PLAN, here, [on_circle(1.0)]) == pytest.approx(there)


def test_without_a_circle_in_the_plane_no_robot_waits() -> None:
    grid = Mission(shape="grid", n_robots=41, arena=((-200, -200), (300, 300)))
    assert landing(grid, Plan.of(grid.ideal or ()), (0.0, 0.0)) is None
    there = meeting_places(SQUARE, PLAN, owned(1)).points[3]
    walled = SQUARE.model_copy(update={"obstacles": (Obstacle(center=there, radius=1.0),)})
    assert landing(walled, PLAN, (0.0, 0.0)) is None and meeting_point(walled, PLAN, (0.0, 0.0), []) is None
    ring = ((20.0, 0.0, 0.0), (0.0, 20.0, 0.0), (-20.0, 0.0, 0.0), (0.0, -20.0, 0.0))
    space = Mission(shape="points", points=ring, n_robots=4, center=(0, 0, 0), arena=((-50, -50, -50), (50, 50, 50)))
    assert landing(space, Plan.of(space.ideal or ()), (1.0, 0.0, 0.0)) is None


def test_robot_stays_if_alone_or_all_are_at_hold_distance() -> None:
    apart = HOLD * SQUARE.comm_range
    assert went(0.0, []) == pytest.approx(0.0)
    for k in range(5):
        others = [apart * other for other in range(5) if other != k]
        assert went(apart * k, others) == pytest.approx(0.0, abs=1e-6)


def test_a_chain_spreads_from_its_middle_and_keeps_its_links() -> None:
    where = [8.0 * k for k in range(7)]
    moves = [went(x, [other for other in where if other != x]) for x in where]
    assert moves[0] < -1.0 and moves[1] < -1.0 and moves[3] == pytest.approx(0.0, abs=1e-6)
    assert moves == pytest.approx([-x for x in moves[::-1]], abs=1e-6)
    after = [x + move for x, move in zip(where, moves, strict=True)]
    assert max(b - a for a, b in pairwise(after)) <= LINK * SQUARE.comm_range + 1e-6
    assert after[-1] - after[0] > where[-1] - where[0] + 5.0


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.5, 0.9])
def test_a_chain_across_the_antipode_is_one_chain(turn: float) -> None:
    """All but one gap is closed: wherever the gap is as seen from a robot, its two sides close it."""
    around, reach = math.tau * RADIUS, SQUARE.comm_range
    count = int((around - 2 * reach) / 9.0)
    where = [turn * around + 9.0 * k for k in range(count)]
    assert around - 9.0 * (count - 1) > reach
    assert went(where[0], where[1:]) < -1.0 and went(where[-1], where[:-1]) > 1.0


def test_robots_on_a_closed_circle_stay() -> None:
    around = math.tau * RADIUS
    count = int(around / 9.0)
    where = [around * k / count + (k % 2) for k in range(count)]
    assert went(where[4], [x for x in where if x != where[4]]) == pytest.approx(0.0, abs=1e-9)


def test_robots_off_the_circle_do_not_count() -> None:
    here = on_circle(0.0)
    inside = (CENTER[0] + 0.5 * RADIUS, CENTER[1] + 1.0)
    assert meeting_point(SQUARE, PLAN, here, [inside]) == pytest.approx(here)


def message(sender: int, version: int) -> bytes:
    """A robot at its own place of the plan; all claims are of this version."""
    origin = Provenance(mission=0, mission_digest=SQUARE.digest, epoch=0, degree=0, proposer=0, sequence=0)
    table = tuple((version, -1.0, (a + 1) % len(PLAN)) for a in range(len(PLAN)))
    slot = (sender - 1) % len(PLAN)
    return encode(Message(sender=sender, sequence=0, degree=1, plan=PLAN, provenance=origin, slot=slot, **told(table)))


def flown(agent: Agent, number: int, here: Point, *heard: bytes) -> list[Effect]:
    """One round on the spot; what is decided at its end."""
    asked = agent.handle(RoundBegan(round=number, position=here, sensed={}, observed=(), degree=len(heard)))
    if asked:
        agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
    agent.handle(CommRoundBegan())
    for payload in heard:
        agent.handle(Received(payload))
    agent.handle(CommRoundEnded())
    effects = agent.handle(AgreementEnded())
    if isinstance(effects[-1], AskStep):
        agent.handle(Decided(StepAnswer(waypoint=here)))
    agent.handle(Arrived())
    return effects


def target(effects: list[Effect]) -> Point | None:
    assert isinstance(effects[-1], AskStep)
    return effects[-1].question.target


def test_after_the_first_call_a_robot_waits_instead_of_searching() -> None:
    agent = whole_agent(0, SQUARE, ProvenanceConsensus(), AuctionAssignment(), shield_on=True)
    here = meeting_places(SQUARE, PLAN, owned(1)).points[5]
    effects = list[Effect]()
    for number in range(1, ROUNDS + 1):
        effects = flown(agent, number, here)
    assert agent.claim.slot == 5 and target(effects) != here, "it searches"
    effects = flown(agent, ROUNDS + 1, here)
    assert Note("search", {"begun": False, "vacant": [a for a in range(40) if a != 5]}) in effects
    assert target(effects) == pytest.approx(landing(SQUARE, PLAN, here))
    assert not [e for e in flown(agent, ROUNDS + 2, here) if isinstance(e, Note)]


def test_robot_leaves_once_all_it_hears_are_jointly_placed() -> None:
    agent = whole_agent(0, SQUARE, ProvenanceConsensus(), AuctionAssignment(), shield_on=True)
    here = PLAN.points[5]
    for number in range(1, ROUNDS + 1):
        flown(agent, number, here)
    effects = flown(agent, ROUNDS + 1, here, message(1, 40 * VERSION), message(2, 0))
    assert agent.claim.slot == len(PLAN) - 1 and target(effects) == pytest.approx(landing(SQUARE, PLAN, here))
    assert target(flown(agent, ROUNDS + 2, here, message(1, 40 * VERSION), message(2, 40 * VERSION))) is None


def test_robot_searches_on_if_there_is_no_meeting_circle() -> None:
    there = meeting_places(SQUARE, PLAN, owned(1)).points[3]
    walled = SQUARE.model_copy(update={"obstacles": (Obstacle(center=there, radius=1.0),)})
    agent = whole_agent(0, walled, ProvenanceConsensus(), AuctionAssignment(), shield_on=True)
    effects = list[Effect]()
    for number in range(1, ROUNDS + 2):
        effects = flown(agent, number, PLAN.points[5])
    assert target(effects) in PLAN.points
