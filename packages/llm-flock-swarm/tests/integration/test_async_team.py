"""Swarms in which nothing is in step give way as one in lockstep does: at a gap, in a corridor, off a place."""

from __future__ import annotations

import math
from typing import Any

import pytest
from async_team import AsyncTeam, one_clock

from llm_flock.arrays import Point
from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer, PlanQuestion
from llm_flock.protocol._geometry import GeometryPlanner
from llm_flock_swarm._network.config import SwarmConfig

pytestmark = pytest.mark.usefixtures("skipped_waits")

SAFE = 3.0
Box = dict[str, list[list[float]]]


def box(left: float, low: float, right: float, high: float) -> Box:
    return {"polygon": [[left, low], [right, low], [right, high], [left, high]]}


GAP = [box(55, -5, 58, 46.85), box(55, 53.15, 58, 105)]
CORRIDOR = [box(30, -5, 70, 48), box(30, 52, 70, 105)]
BAY = [box(38, -5, 62, 48), box(38, 52, 46, 105), box(54, 52, 62, 105), box(46, 57, 54, 105)]


@pytest.fixture(autouse=True)
def wall_clock(skipped_waits: None, monkeypatch: pytest.MonkeyPatch) -> None:
    one_clock(monkeypatch)


@pytest.fixture
def fixed_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every robot proposes the mission's own points, and keeps the place of its number."""

    async def given(_: GeometryPlanner, question: PlanQuestion) -> PlanAnswer:
        points = question.mission.points
        assert points is not None
        return PlanAnswer(plan=Plan.of(points), slot=question.robot)

    monkeypatch.setattr(GeometryPlanner, "plan", given)


def team(starts: list[Point], obstacles: list[Box], **fields: Any) -> AsyncTeam:
    """Robots that fly by geometry."""
    base = {"n_robots": len(starts), "center": (50, 50), "comm_range": 100, "model": "geometry", "gather_s": 0.3}
    return AsyncTeam(SwarmConfig.build({}, **{**base, "obstacles": obstacles, **fields}), starts)


def is_safe(swarm: AsyncTeam) -> bool:
    return swarm.nearest >= SAFE - 1e-6 and swarm.clearance >= SAFE / 2 - 1e-6


def test_a_team_comes_through_a_gap_of_two_robots_width() -> None:
    room = {"shape": "triangle", "center": (75, 50), "arena": ((0, 0), (120, 100))}
    swarm = team([(42.0, 46.0), (42.0, 50.0), (46.0, 54.0)], GAP, **room)
    assert swarm.fly(40.0) is not None
    assert is_safe(swarm)


@pytest.mark.usefixtures("fixed_places")
def test_two_head_on_in_a_corridor_with_one_bay_pass_each_other() -> None:
    """With fixed places one of them has to go back, into the bay or all the way."""
    ends = (32.0, 50.0), (68.0, 50.0)
    swarm = team([(40.0, 50.0), (60.0, 50.0)], BAY, points=ends[::-1], assignment="index")
    assert swarm.fly(60.0) is not None
    assert is_safe(swarm) and swarm.kinds["deadlock"] and swarm.kinds["gives_way"]
    assert sum(origins["yield"] for origins in swarm.origins) >= 2


@pytest.mark.usefixtures("fixed_places")
def test_robot_at_its_place_steps_aside_and_comes_back() -> None:
    """It stands in the corridor; the other one's place is in the room behind it."""
    farthest, place = 0.0, (64.0, 50.0)

    def watch(swarm: AsyncTeam, _: float) -> None:
        nonlocal farthest
        farthest = max(farthest, math.dist(swarm.world.positions[1], place))

    swarm = team([(50.0, 50.0), place], CORRIDOR, points=((80.0, 50.0), place), center=(72, 50), assignment="index")
    assert swarm.fly(40.0, watch) is not None
    assert is_safe(swarm) and swarm.kinds["gives_way"] and swarm.origins[1]["yield"]
    assert farthest > 5.0 and math.dist(swarm.world.positions[1], place) <= 0.5


@pytest.mark.usefixtures("fixed_places")
def test_two_that_meet_head_on_exchange_places() -> None:
    """Something carries each to the other end; they learn of it when they come into radio range."""
    slots: list[list[int | None]] = []

    def carry(swarm: AsyncTeam, _: float) -> None:
        now = [agent.claim.slot for agent in swarm.agents]
        if now == [0, 1] and not slots:
            swarm.world.positions[:] = [(41.0, 50.0), (59.0, 50.0)]
        if None not in now and now not in slots:
            slots.append(now)

    swarm = team([(90.0, 50.0), (10.0, 50.0)], CORRIDOR, points=((76.0, 50.0), (24.0, 50.0)), comm_range=15)
    assert swarm.fly(30.0, carry) is not None
    assert is_safe(swarm) and swarm.kinds["gives_way"] == 0
    assert slots[0] == [0, 1] and slots[-1] == [1, 0]
