"""Flights among obstacles: set-points lead through a gap, and drones that meet head-on give way."""

from __future__ import annotations

from typing import Any

import pytest
from flights import flight_config, flown

from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer, PlanQuestion
from llm_flock.protocol._geometry import GeometryPlanner
from llm_flock.runtime._result import Summary

pytestmark = pytest.mark.usefixtures("skipped_waits")

Start = tuple[float, float]


def box(left: float, low: float, right: float, high: float) -> dict[str, Any]:
    return {"polygon": [[left, low], [right, low], [right, high], [left, high]]}


def summary_of(starts: list[Start], obstacles: list[dict[str, Any]], mission: dict[str, Any], **fields: Any) -> Summary:
    """A flight of simulated drones at these starts [m] in a room of 30 units, 0.1 m each, with (0, 0) in its middle."""
    drones = [{"name": f"d{k}", "start": start} for k, start in enumerate(starts)]
    room = {**mission, "obstacles": obstacles}
    config = flight_config(len(starts), mission=room, drones=drones, model="geometry", **fields)
    result = flown(config).result
    assert result is not None
    found = result.summary
    assert found.flight is not None and found.flight.ended == "mission" and found.flight.safe
    assert found.min_separation is not None and found.min_separation >= 3.0 - 1e-6
    assert found.min_clearance is not None and found.min_clearance >= 1.5 - 1e-6
    return found


def test_set_points_lead_through_a_gap() -> None:
    gap = [box(13, -5, 15, 11.85), box(13, 18.15, 15, 35)]
    mission = {"shape": "line", "center": [22, 15], "spacing": 6}
    assert summary_of([(-1.2, -0.6), (-1.2, 0.6)], gap, mission).formed


def test_drones_head_on_in_a_corridor_give_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """With fixed places one of them has to go all the way back."""

    async def given(_: GeometryPlanner, question: PlanQuestion) -> PlanAnswer:
        points = question.mission.points
        assert points is not None
        return PlanAnswer(plan=Plan.of(points), slot=question.robot)

    monkeypatch.setattr(GeometryPlanner, "plan", given)
    corridor = [box(11, -5, 19, 13), box(11, 17, 19, 35)]
    mission = {"shape": "points", "points": [[23.0, 15.0], [7.0, 15.0]]}
    found = summary_of([(-0.6, 0.0), (0.6, 0.0)], corridor, mission, assignment="index", rounds=60)
    assert found.formed and found.waypoints["yield"] >= 2
