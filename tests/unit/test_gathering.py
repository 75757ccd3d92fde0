"""Where a large team in pieces meets: on the circle that is the same for every turn of its shape."""

import math

import numpy as np
import pytest

from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.protocol.agent import Agent
from llm_flock.protocol.auction import AuctionAssignment
from llm_flock.protocol.consensus import PedigreeConsensus
from llm_flock.protocol.events import AskStep, NegotiationEnded, Planned, RoundBegan, TickBegan, TickEnded
from llm_flock.protocol.gathering import meeting_places
from llm_flock.protocol.messages import NO_OWNER, Entry
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import PlanAnswer

SQUARE = Mission(shape="square", n_robots=40, arena=((-100, -100), (200, 200)))
PLAN = Plan.of(SQUARE.ideal or ())
FREE: Entry = (0, 0.0, NO_OWNER)


def owned(count: int) -> tuple[Entry, ...]:
    return tuple((0, -1.0, a) if a < count else FREE for a in range(len(PLAN)))


def test_places_of_any_turn_lie_on_one_circle_each_where_it_is_seen_from_the_centre() -> None:
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


def test_an_obstacle_on_the_circle_keeps_the_places_where_they_are() -> None:
    there = meeting_places(SQUARE, PLAN, owned(1)).points[3]
    mission = SQUARE.model_copy(update={"obstacles": (Obstacle(center=there, radius=1.0),)})
    assert meeting_places(mission, PLAN, owned(1)) == PLAN


def test_a_robot_that_misses_most_of_a_large_team_goes_there() -> None:
    agent = Agent(0, SQUARE, PedigreeConsensus(), AuctionAssignment(), shield_on=True)
    here = PLAN.points[0]
    agent.handle(RoundBegan(round=1, position=here, sensed={}, observed=(), neighbors=0))
    agent.handle(Planned(PlanAnswer(plan=PLAN, slot=0)))
    for event in (TickBegan(), TickEnded()):
        agent.handle(event)
    effects = agent.handle(NegotiationEnded())
    ask = effects[-1]
    assert isinstance(ask, AskStep) and agent.claim.slot == 0
    assert ask.question.target == meeting_places(SQUARE, PLAN, owned(1)).points[0] != here
