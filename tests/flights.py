"""Short flights of simulated drones for tests: what is flown, and what is done to a drone meanwhile."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Sequence
from typing import Any

from llm_flock.record._schema import Entry
from llm_flock.robots._base import Equipment
from llm_flock.robots._point_mass import PointMass
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock.runtime._result import FlightFigures, RunResult
from llm_flock_flight._cascade import pid
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet, start_of, with_drones
from llm_flock_flight._flight.flight import Flight, FlightResult
from llm_flock_flight._flight.preflight import PreflightReport
from llm_flock_flight._flight.sections import DroneConfig

ROOM = {"center": [15, 15], "arena": [[0, 0], [30, 30]], "comm_range": 20}
BRISK = {"round_s": 0.6, "max_speed_m_s": 6.0, "take_off_s": 0.4, "land_s": 0.4, "settle_s": 0.3, "deadman": False}
STARTS = ((-1.2, -1.2), (1.2, -1.2), (1.2, 1.2), (-1.2, 1.2))

Robots = list[SimulatedRobot]
Sabotage = Callable[[Flight, Robots], None]


def flight_config(
    n: int = 4, shape: str = "square", mission: dict[str, Any] | None = None, **fields: Any
) -> FlightConfig:
    """A brisk flight of some drones in a room of 3 m, from the corners of it where there are four."""
    room = {"shape": shape, "n_robots": n, **ROOM, **(mission or {})}
    if n == 4 and "drones" not in fields:
        fields["drones"] = [{"name": f"d{k}", "start": start} for k, start in enumerate(STARTS)]
    return with_drones(FlightConfig.build({"mission": room}, **{**BRISK, "take_off_group": 10, **fields}))


STOCK: dict[str, Any] = {"round_s": 3.0, "max_speed_m_s": 1.0, "take_off_s": 2.5, "land_s": 3.0, "settle_s": 1.0}
"""The defaults of a flight."""


def stock(config: FlightConfig, drones: Sequence[DroneConfig]) -> list[SimulatedRobot]:
    """Drones that lag behind their set-points, as Crazyflies do before they are tuned."""
    homes = [start_of(config, drone) for drone in drones]
    bodies = [PointMass(home=home, ground_m=home[2], controlled=pid()) for home in homes]
    untuned = Equipment(controller="PID", lag_s=0.5, max_speed_m_s=1.0)
    return [
        SimulatedRobot(drone.name, body.home, limits=config.driver_limits, body=body, equipment=untuned)
        for drone, body in zip(drones, bodies, strict=True)
    ]


async def yes(report: PreflightReport) -> bool:
    """An operator who confirms every flight."""
    return True


async def fly(
    config: FlightConfig,
    sabotage: Sabotage | None = None,
    at: str = "round 1",
    sink: Callable[[Entry], None] | None = None,
) -> FlightResult:
    """Fly, and do something to the drones when a stage begins (`taking off`, ...) or in the middle of a round.

    `sink` gets every entry of the record.
    """
    robots = [robot for robot in build_fleet(config) if isinstance(robot, SimulatedRobot)]
    tasks: list[asyncio.Task[None]] = []

    async def later() -> None:
        await asyncio.sleep(config.safety.round_s / 2)
        act()

    def act() -> None:
        if sabotage is not None:
            sabotage(flight, robots)

    def on_stage(stage: str) -> None:
        if stage == at:
            act()
        if stage == "flying" and at == "round 1":
            tasks.append(asyncio.get_running_loop().create_task(later()))

    class Sink:
        def write(self, entry: Entry) -> None:
            if sink is not None:
                sink(entry)

    flight = Flight(config, robots, on_stage=on_stage, sink=None if sink is None else Sink())
    return await flight.run(yes)


def flown(
    config: FlightConfig,
    sabotage: Sabotage | None = None,
    at: str = "round 1",
    sink: Callable[[Entry], None] | None = None,
) -> FlightResult:
    """As `fly`, from start to end."""
    return asyncio.run(fly(config, sabotage, at, sink))


def trial(result: FlightResult) -> RunResult:
    """The trial that was flown. Fails with the reason if no drone took off."""
    assert result.result is not None, [str(check) for check in result.report.checks if not check.passed]
    return result.result


def figures(result: FlightResult) -> FlightFigures:
    """The figures of a flight that took place."""
    found = trial(result).summary.flight
    assert found is not None
    return found


def one_by_one(config: FlightConfig, drones: Sequence[DroneConfig]) -> list[SimulatedRobot]:
    """A driver as a user may write one."""
    return [SimulatedRobot(drone.name, start_of(config, drone)) for drone in drones]


def only_one(config: FlightConfig, drones: Sequence[DroneConfig]) -> SimulatedRobot:
    """A driver that makes a single robot."""
    return one_by_one(config, drones)[0]


def too_few(config: FlightConfig, drones: Sequence[DroneConfig]) -> list[SimulatedRobot]:
    """A driver that leaves a drone out."""
    return one_by_one(config, drones[1:])


def telling(config: FlightConfig, drones: Sequence[DroneConfig]) -> list[SimulatedRobot]:
    """Drones that write their names to the file LANDED once they are told to land, in any process."""
    robots, file = one_by_one(config, drones), os.open(os.environ["LANDED"], os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def tell(robot: SimulatedRobot) -> None:
        plain = robot.land

        async def land(height_m: float, duration_s: float) -> None:
            os.write(file, f"{robot.name}\n".encode())
            await plain(height_m, duration_s)

        robot.land = land

    for robot in robots:
        tell(robot)
    return robots
