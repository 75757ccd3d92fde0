"""Flights that return: every drone flies to above its own start, under the shield, and lands there."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

import numpy as np
import pytest
from effort import EFFORT
from flights import STARTS, STOCK, Robots, Sabotage, flight_config, flown

from llm_flock import metrics
from llm_flock.mission import Mission
from llm_flock.record._reader import read_record
from llm_flock.runtime._result import FlightFigures
from llm_flock.simulate import Readings, draw_start
from llm_flock_flight._flight import homing
from llm_flock_flight._flight.dry_run import dry_run
from llm_flock_flight._flight.flight import Flight
from llm_flock_flight._flight.homing import WayHome

pytestmark = pytest.mark.usefixtures("skipped_waits")


def order(flight: Flight, robots: Robots) -> None:
    assert flight.return_home()


def fly_and_look(act: Sabotage, at: str, **fields: Any) -> tuple[FlightFigures, list[float]]:
    """The figures of a flight, and how far from its start each drone is in the end [m]."""
    made: Robots = []

    def keep_and_act(flight: Flight, robots: Robots) -> None:
        made.extend(robots)
        act(flight, robots)

    config = flight_config(**fields)
    result = flown(config, keep_and_act, at).result
    assert result is not None and result.summary.flight is not None
    now = time.monotonic()
    return result.summary.flight, [math.dist(robot.body.position(now), robot.body.home) for robot in made]


@pytest.mark.parametrize("fields", [{}, {"robot": "flights:stock", **STOCK}], ids=["exact", "stock"])
def test_order_in_the_middle_of_a_round_brings_all_home(fields: dict[str, Any], tmp_path) -> None:
    flight, off = fly_and_look(order, "round 1", out=str(tmp_path), **fields)
    assert flight.ended == "return" and flight.reason is None and flight.safe
    assert set(flight.ends.values()) == {"landed"} and max(off) <= 0.05
    assert (flight.min_separation_m or 0.0) >= 0.2
    record = read_record(tmp_path / "run.mcap")
    kinds = [event.kind for event in record.flight]
    assert kinds.index("returning") < kinds.index("returned") < kinds.index("landing")
    assert record.result is not None and record.result["stopped"] == "return"
    returning = record.flight[kinds.index("returning")].time_s
    began = record.flight[kinds.index("aloft")].time_s
    assert returning - began > 0.9 * flight_config(**fields).safety.round_s, "the motion under way was flown to its end"


def test_drones_return_after_the_mission_if_the_file_says_so() -> None:
    flight, off = fly_and_look(lambda flight, robots: None, "landing", at_end="return")
    assert flight.ended == "mission" and flight.safe and max(off) <= 0.05
    there, off = fly_and_look(lambda flight, robots: None, "landing")
    assert there.ended == "mission" and max(off) > 0.5, "without, they land where the mission ends"


def test_an_order_while_they_think_is_carried_out_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    from llm_flock.protocol._geometry import GeometryPlanner

    async def for_ever(self: GeometryPlanner, question: object) -> None:
        await asyncio.sleep(3600.0)

    monkeypatch.setattr(GeometryPlanner, "step", for_ever)
    began = time.monotonic()
    flight, off = fly_and_look(order, "round 1", model="geometry", think_s=600.0)
    assert flight.ended == "return" and max(off) <= 0.05 and time.monotonic() - began < 60.0


def test_order_during_take_off_lands_the_flying_drones() -> None:
    flight, off = fly_and_look(order, "taking off")
    assert flight.ended == "abort" and flight.safe and max(off) <= 0.05


def test_a_low_battery_on_the_way_home_lands_all_where_they_are() -> None:
    def discharge(flight: Flight, robots: Robots) -> None:
        robots[2].body.battery_v = 3.0

    flight, off = fly_and_look(discharge, "returning", at_end="return", low_battery_s=0.1)
    assert flight.ended == "battery_low" and set(flight.ends.values()) == {"landed"} and max(off) > 0.1


def test_before_a_flight_has_begun_there_is_no_order() -> None:
    assert not Flight(flight_config(), []).return_home()


def test_a_dry_run_checks_the_way_home() -> None:
    there, back = (asyncio.run(dry_run(flight_config(at_end=end))) for end in ("land", "return"))
    assert not back.faults and back.result.formed and len(back.motions) > len(there.motions)
    for place, start in zip(back.motions[-1].targets, STARTS, strict=True):
        assert math.dist(place[:2], start) <= 0.05
    assert len(back.landing) == 1


def test_drone_that_does_not_get_home_is_named(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A way home of one step is too short for all; on paper that is a fault, in flight a warning."""
    monkeypatch.setattr(homing, "STEPS", 1)
    monkeypatch.setattr(homing, "STEPS_EACH", 0)
    config = flight_config(at_end="return")
    plan = asyncio.run(dry_run(config))
    assert [*plan.away_m] == [0, 1, 2, 3] and min(plan.away_m.values()) > 0.05
    assert plan.faults[0] == f"d0 does not get home: it lands {plan.away_m[0]:.2f} m from its start"
    _, off = fly_and_look(lambda flight, robots: None, "landing", at_end="return")
    assert off == pytest.approx([*plan.away_m.values()], abs=0.05)
    assert "d0, d1, d2, d3: not home, and landed where it is now" in caplog.text


def test_a_dry_run_tells_a_flight_that_cannot_end_in_time() -> None:
    plan = asyncio.run(dry_run(flight_config(at_end="return")))
    assert not plan.faults
    late = asyncio.run(dry_run(flight_config(at_end="return", max_flight_s=0.9 * plan.air_s)))
    assert len(late.faults) == 1 and late.faults[0].startswith("the flight takes")


@pytest.mark.parametrize(
    ("n", "size", "obstacles"), [(3, 30, []), (10, 33, []), (10, 40, [{"center": [20, 20], "radius": 6}])]
)
def test_all_get_home_from_anywhere_at_a_safe_distance(n: int, size: float, obstacles: list[Any]) -> None:
    room: dict[str, Any] = {"center": (size / 2, size / 2), "arena": ((0, 0), (size, size)), "obstacles": obstacles}
    mission = Mission(shape="circle", n_robots=n, comm_range=20, **room)
    for seed in range(max(1, round(5 * EFFORT))):
        rng = np.random.default_rng(seed)
        starts, homes = draw_start(mission, "separated", rng), draw_start(mission, "separated", rng)
        team, way = Readings(mission, starts, 0.0, rng), WayHome(mission, homes, 0.5)
        for _ in range(way.most_steps(starts)):
            before = team.places
            moves = way.step(team)
            assert np.linalg.norm(moves, axis=1).max() <= mission.max_step + 1e-9
            team.move(moves)
            assert metrics.segment_separation(before, team.places) >= mission.safe_distance - 1e-6
        assert not way.far(team.places), seed


def test_homes_too_near_are_named_and_no_drone_waits_forever() -> None:
    mission = Mission(shape="line", n_robots=2, center=(15, 15), arena=((0, 0), (30, 30)), comm_range=20)
    homes = np.array([[10.0, 10.0], [11.0, 10.0]])
    team = Readings(mission, np.array([[5.0, 5.0], [25.0, 25.0]]), 0.0, np.random.default_rng(0))
    way = WayHome(mission, homes, 0.5)
    for _ in range(way.most_steps(team.places)):
        team.move(way.step(team))
    assert way.far(team.places)
