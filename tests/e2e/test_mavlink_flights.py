"""Whole flights of four and of ten stand-in autopilots, and what becomes of them when the flight process is gone."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

import pytest

pytest.importorskip("pymavlink")

from flights import STARTS, flight_config, yes
from mavlink_flights import CALM, until

from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.deadman import land_all
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight, FlightResult
from llm_flock_flight._flight.landing import LANDED, TAKEN
from llm_flock_flight._testing.mavlink import AutopilotStandIns

pytestmark = pytest.mark.clock(1.5)


def vehicles_of(flavour: str) -> AutopilotStandIns:
    return AutopilotStandIns([(x, y, 0.0) for x, y in STARTS], flavour=flavour, shared=True, loss=0.02, seed=3)


def config_of(vehicles: AutopilotStandIns, **fields: object) -> FlightConfig:
    drones = [
        {"name": f"d{k}", "uri": vehicles.uris[k], "system_id": k + 1, "start": start} for k, start in enumerate(STARTS)
    ]
    return flight_config(drones=drones, **{**CALM, **fields})


def flown(config: FlightConfig, on_stage: Callable[[str], None] = lambda _: None) -> FlightResult:
    return asyncio.run(Flight(config, build_fleet(config), on_stage=on_stage).run(yes))


@pytest.mark.slow
@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_the_papers_square(flavour):
    with vehicles_of(flavour) as vehicles:
        done = flown(config_of(vehicles))
        names = [check.name for check in done.report.checks]
        assert names.count("its own fence") == 4
        assert [check for check in done.report.checks if not check.passed] == []
        assert done.result is not None and done.result.summary.flight is not None
        figures = done.result.summary.flight
        assert figures.reason is None and done.result.summary.formed
        assert set(figures.ends.values()) == {LANDED} and figures.safe
        assert not any(vehicles[k].armed for k in range(4))


@pytest.mark.slow
def test_a_pilot_takes_one_and_the_others_land():
    with vehicles_of("px4") as vehicles:

        def on_stage(stage: str) -> None:
            if stage == "flying":
                vehicles[2].switch("Position")

        done = flown(config_of(vehicles), on_stage)
        assert done.result is not None and done.result.summary.flight is not None
        figures = done.result.summary.flight
        assert figures.ended == "refused" and "d2: its mode is Position, not Offboard" in str(figures.reason)
        assert figures.ends == {"d0": LANDED, "d1": LANDED, "d2": TAKEN, "d3": LANDED} and not figures.safe
        assert vehicles[2].armed and vehicles[2].mode == "Position"
        assert not vehicles[0].armed


def test_a_vehicle_that_nothing_would_land_does_not_take_off():
    with vehicles_of("ardupilot") as vehicles:
        vehicles[1].autopilot.parameters["FS_GCS_ENABLE"] = 0.0
        done = flown(config_of(vehicles))
        assert done.result is None
        failed = [check for check in done.report.checks if not check.passed]
        assert [(check.who, check.name) for check in failed] == [("d1", "without heartbeats")]
        assert not any(vehicles[k].armed for k in range(4))


def test_vehicle_away_from_its_switch_on_point_stays_grounded():
    with vehicles_of("px4") as vehicles:
        vehicles[3].autopilot.offset = (0.6, 0.0, 0.0)
        done = flown(config_of(vehicles))
        failed = [check for check in done.report.checks if not check.passed]
        assert done.result is None and ("d3", "start position") in [(check.who, check.name) for check in failed]


@pytest.mark.slow
@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_the_deadman_lands_what_is_in_the_air(flavour):
    """The flight process is gone, and its set-points with it: PX4 lands by itself, ArduPilot waits for the deadman."""

    async def whole() -> None:
        with vehicles_of(flavour) as vehicles:
            for k in range(4):
                vehicles[k].autopilot.parameters["FS_GCS_TIMEOUT"] = 60.0
            config = config_of(vehicles, reach_s=10.0)
            robots = build_fleet(config)
            for robot in robots:
                await robot.connect(8.0)
            await asyncio.gather(*(robot.arm() for robot in robots))
            await asyncio.gather(*(robot.take_off(1.0, 1.5) for robot in robots))
            await asyncio.sleep(3.0)
            assert all(vehicles[k].position[2] > 0.8 for k in range(4))
            for robot in robots:
                await robot.close()
            await asyncio.sleep(1.5)
            ends = await land_all(config, build_fleet(config), lambda _: None)
            assert ends == dict.fromkeys(["d0", "d1", "d2", "d3"], LANDED)
            await until(lambda: not any(vehicles[k].armed for k in range(4)))

    asyncio.run(whole())


@pytest.mark.slow
@pytest.mark.parametrize(("flavour", "shared"), [("px4", False), ("ardupilot", True)])
def test_ten_connect_form_a_circle_return_and_land(flavour, shared):
    """Ten at ports of their own, and ten that share one: all by their system ids."""
    homes = [(0.75 * (k % 4) - 1.2, 0.75 * (k // 4) - 0.8, 0.0) for k in range(10)]
    with AutopilotStandIns(homes, flavour=flavour, shared=shared) as vehicles:
        assert len(set(vehicles.uris)) == (1 if shared else 10)
        drones = [
            {"name": f"d{k}", "uri": vehicles.uris[k], "system_id": k + 1, "start": home[:2]}
            for k, home in enumerate(homes)
        ]
        config = flight_config(10, "circle", {"spacing": 6}, drones=drones, **CALM, at_end="return")
        done = flown(config)
        assert done.result is not None and done.result.summary.flight is not None, done.report
        figures = done.result.summary.flight
        assert figures.reason is None and done.result.summary.formed
        assert set(figures.ends.values()) == {LANDED} and len(figures.ends) == 10
        assert (figures.min_separation_m or 0.0) >= config.safety.min_separation_m
        for k, home in enumerate(homes):
            assert not vehicles[k].armed and math.dist(vehicles[k].position, home) <= config.safety.tracking_m + 0.05
