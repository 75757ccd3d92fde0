"""Take-offs of drones that lift late: what is streamed, judged and recorded is one trajectory that waits for them."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

import pytest
from flights import STOCK, Robots, figures, flight_config, flown

from llm_flock.record._schema import NullWriter
from llm_flock.robots._base import Commanded
from llm_flock_flight._flight import takeoff
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.takeoff import TakeOffFailed, take_off
from llm_flock_flight._flight.team import FlyingTeam
from llm_flock_flight._mavlink.frames import enu
from llm_flock_flight._testing.mavlink import AutopilotStandIns

HOME = (0.0, 0.0, 0.0)
CALM: dict[str, Any] = {
    "altitude_m": 1.6,
    "take_off_s": 4.0,
    "land_s": 4.0,
    "round_s": 7.0,
    "max_speed_m_s": 1.5,
    "tracking_m": 0.35,
}


def config_of(vehicles: AutopilotStandIns) -> FlightConfig:
    drones = [{"name": "d0", "uri": vehicles.uris[0], "start": (0.0, 0.0)}]
    room: dict[str, Any] = {"geofence": [[-9.0, -9.0, -1.0], [9.0, 9.0, 4.0]], "scale_m": 0.5}
    return flight_config(1, "circle", drones=drones, robot="mavlink", **room, **CALM)


async def risen(vehicles: AutopilotStandIns) -> list[tuple[float, float, float, float]]:
    """Take off; time [s], set-point judged, set-point that came last, and height, again and again [m]."""
    config = config_of(vehicles)
    log = FlightLog(config, NullWriter())
    robots = build_fleet(config)
    rows: list[tuple[float, float, float, float]] = []
    try:
        await robots[0].connect(8.0)
        team = FlyingTeam(config, robots, log)
        rising = asyncio.ensure_future(take_off(config, team, log))
        while not rising.done():
            await asyncio.sleep(0.02)
            if team.airborne:
                now = time.monotonic()
                came = [enu(point)[2] for point in vehicles[0].autopilot.set_points[-1:]] or [0.0]
                rows.append((now, team.motions[0].at(now)[0][2], came[0], vehicles[0].position[2]))
        await rising
    finally:
        for robot in robots:
            await robot.close()
    return rows


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_set_points_wait_for_the_lift_and_are_those_judged(flavour: str) -> None:
    pytest.importorskip("pymavlink")
    with AutopilotStandIns([HOME], flavour=flavour, lifelike=True) as vehicles:
        rows = asyncio.run(risen(vehicles))
    began = rows[0][0]
    led = [row for row in rows if row[1] > 0.0]
    assert led[0][0] - began > 2.0, "it rests for as long as the motors do not act"
    assert all(row[3] > 0.2 for row in led), "no set-point leads a vehicle that is not seen to lift"
    assert max(abs(judged - came) for _, judged, came, _ in led[3:]) < 0.05
    assert max(abs(judged - height) for _, judged, _, height in rows) < 0.35
    assert led[-1][0] - led[0][0] > 3.9, "it takes its full time"
    assert max(height for *_, height in rows) < 1.6 + 0.15


def test_vehicle_that_never_lifts_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pymavlink")
    monkeypatch.setattr(takeoff, "LIFT_S", 1.0)
    with AutopilotStandIns([HOME], flavour="ardupilot", lifelike=True) as vehicles:
        with pytest.raises(TakeOffFailed, match="d0 was told to take off, and is not seen to lift after 1 s"):
            asyncio.run(risen(vehicles))
        assert vehicles[0].position == HOME


@pytest.mark.usefixtures("skipped_waits")
@pytest.mark.parametrize(("late_s", "ended"), [(0.0, "mission"), (2.0, "mission"), (11.0, "refused")])
def test_an_order_that_acts_late_ends_no_flight(late_s: float, ended: str) -> None:
    """Drones that plan on board: their trajectory begins when they do, unless that takes too long."""

    def delay(flight: Flight, robots: Robots) -> None:
        plain = robots[1].take_off

        async def later(height_m: float, duration_s: float) -> Commanded:
            asyncio.get_running_loop().call_later(late_s, lambda: asyncio.ensure_future(plain(height_m, duration_s)))
            return Commanded(target=(*robots[1].state().position[:2], height_m), duration_s=duration_s)

        robots[1].take_off = later

    config = flight_config(robot="flights:stock", **STOCK)
    flight = figures(flown(config, delay, "taking off"))
    assert flight.ended == ended, flight.reason
    assert flight.safe and (flight.tracking_max_m or 0.0) < (0.05 if ended == "mission" else math.inf)
