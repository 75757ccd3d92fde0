"""Whole flights of four and of ten stand-in autopilots, and what becomes of them when the flight process is gone."""

from __future__ import annotations

import asyncio
import math
import socket
import threading
from collections.abc import Callable
from itertools import combinations, starmap

import pytest

pytest.importorskip("pymavlink")

from flights import STARTS, flight_config, yes
from mavlink_flights import CALM, until

from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.deadman import land_all
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight, FlightResult
from llm_flock_flight._flight.landing import LANDED, TAKEN
from llm_flock_flight._mavlink.codec import Codec
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


class Stranger:
    """Another client of the vehicles' port: it speaks for vehicles, and for none, and floods; and looks at the bodies.

    It begins in flight: before, one that speaks for a vehicle only keeps all on the ground.
    """

    def __init__(self, vehicles: AutopilotStandIns) -> None:
        self.vehicles, self.sent, self.nearest, self.farthest, self.begun = vehicles, 0, math.inf, 0.0, False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._work)

    def __enter__(self) -> Stranger:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _packets(self, system: int) -> list[bytes]:
        codec, place = Codec(system, 1), (0, 0.0, 9.0, -9.0, 0.0, 0.0, 0.0)
        target = (0, 1, 1, 1, 0, 50.0, 50.0, -50.0, *(0.0,) * 8)
        good = [
            codec.encode("heartbeat", 2, 12, 0x81, 0x03_00_00_00, 4),
            codec.encode("local_position_ned", *place),
            codec.encode("set_position_target_local_ned", *target),
            codec.encode("command_long", 1, 1, 400, 0, 0.0, 21196.0, *(0.0,) * 5),
            codec.encode("command_ack", 400, 0),
            codec.encode("param_value", b"COM_OF_LOSS_T", 1e9, 9, 1, 0),
        ]
        return [*good, *(packet[:-3] for packet in good), *(b"\xfd\xff" + packet for packet in good), bytes(9000)]

    def _work(self) -> None:
        place = ("127.0.0.1", int(self.vehicles.uris[0].rpartition(":")[2]))
        packets = [packet for system in (1, 2, 3, 4, 77, 255, 0) for packet in self._packets(system)]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not self._ended.wait(0.02):
                for packet in packets if self.begun else ():
                    sender.sendto(packet, place)
                    self.sent += 1
                bodies = [self.vehicles[k].position for k in range(4)]
                self.nearest = min(self.nearest, *starmap(math.dist, combinations(bodies, 2)))
                self.farthest = max(self.farthest, *(abs(x) for body in bodies for x in body))


@pytest.mark.parametrize("model", ["simulated:ideal", "own_models:Outside"])
def test_hostile_client_and_model_lead_no_drone_away(model):
    with vehicles_of("px4") as vehicles, Stranger(vehicles) as stranger:

        def on_stage(stage: str) -> None:
            stranger.begun = stranger.begun or stage == "flying"

        config = config_of(vehicles, model=model, fallback="geometry", max_tries=1)
        done = flown(config, on_stage)
    assert done.result is not None and done.result.summary.flight is not None
    figures = done.result.summary.flight
    assert done.result.summary.formed and figures.reason is None and set(figures.ends.values()) == {LANDED}
    fence = max(abs(x) for corner in config.world.geofence for x in corner)
    assert stranger.sent > 5000 and stranger.nearest > config.safety.min_separation_m and stranger.farthest < fence


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
