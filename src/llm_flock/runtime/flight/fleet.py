"""Builds the drones of a flight: their driver, addresses and starts."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias, cast

from llm_flock.errors import InputError
from llm_flock.robots.base import Position, Robot
from llm_flock.robots.simulated import draw_start
from llm_flock.runtime.flight.config import DroneConfig, FlightConfig
from llm_flock.runtime.seeds import Stream, stream

Driver: TypeAlias = Callable[[FlightConfig, Sequence[DroneConfig]], Sequence[Robot]]
"""Makes the robots of a flight, one for each drone, in order."""


def with_drones(config: FlightConfig) -> FlightConfig:
    """The same flight with its drones listed: those of the file, those of `crazyflies.yaml`, or else drawn starts.

    Raises:
        InputError: the file cannot be used, or has another number of drones than the mission.
    """
    if config.fleet.drones:
        return config
    found: list[dict[str, object]]
    if config.fleet.crazyflies is not None:
        from llm_flock.robots.crazyflie.crazyflies_yaml import read_crazyflies

        found = [
            {"name": drone.name, "uri": drone.uri, "start": drone.home, "parameters": drone.parameters}
            for drone in read_crazyflies(Path(config.fleet.crazyflies))
        ]
    else:
        rows = draw_start(
            config.mission, config.trial.start, stream(config.trial.seed, Stream.START), config.trial.start_area
        ).tolist()
        places = [config.frame.to_world(tuple(row)) for row in rows]
        found = [{"name": f"drone{robot}", "start": place[:2]} for robot, place in enumerate(places)]
    fleet = config.fleet.model_dump(exclude={"drones", "crazyflies"})
    return FlightConfig.build({**config.model_dump(exclude={"fleet"}), "fleet": {**fleet, "drones": found}})


def build_fleet(config: FlightConfig) -> Sequence[Robot]:
    """The robots of a flight, not connected yet.

    Raises:
        InputError: there is no such driver, or it cannot drive these drones.
    """
    wanted = config.fleet.drones
    if not wanted:
        raise InputError("drones", "none", "one for each robot of the mission")
    robots = _driver(config.fleet.robot)(config, wanted)
    if len(robots) != len(wanted):
        raise InputError("robot", config.fleet.robot, f"a driver that makes {len(wanted)} robots (here {len(robots)})")
    return robots


def start_of(config: FlightConfig, drone: DroneConfig) -> Position:
    """Position of a drone before take-off [m].

    Raises:
        InputError: the file does not say it.
    """
    if drone.start is None:
        raise InputError("drones", drone.name, "a start for each drone of this driver")
    return (drone.start[0], drone.start[1], config.world.floor_m if len(drone.start) < 3 else drone.start[2])


def _simulated(config: FlightConfig, wanted: Sequence[DroneConfig]) -> Sequence[Robot]:
    from llm_flock.robots.point_mass import PointMass
    from llm_flock.robots.simulated_robot import SimulatedRobot

    bodies = [PointMass(home=start_of(config, drone), ground_m=config.world.floor_m) for drone in wanted]
    limits = config.driver_limits
    return [SimulatedRobot(d.name, body.home, limits=limits, body=body) for d, body in zip(wanted, bodies, strict=True)]


def _crazyflie(config: FlightConfig, wanted: Sequence[DroneConfig]) -> Sequence[Robot]:
    from llm_flock.robots.crazyflie import CrazyflieRobot

    cache = None if config.fleet.cache is None else Path(config.fleet.cache)
    robots: list[Robot] = []
    for drone in wanted:
        if drone.uri is None:
            raise InputError("drones", drone.name, "a uri for each Crazyflie, such as radio://0/80/2M/E7E7E7E701")
        robots.append(
            CrazyflieRobot(drone.name, drone.uri, limits=config.driver_limits, parameters=drone.parameters, cache=cache)
        )
    return robots


def _physics(config: FlightConfig, wanted: Sequence[DroneConfig]) -> Sequence[Robot]:
    from llm_flock.robots.physics import PhysicsWorld

    if config.world.floor_m != 0.0:
        raise InputError("floor_m", config.world.floor_m, "0 in physics")
    world = PhysicsWorld([start_of(config, drone) for drone in wanted])
    world.start()  # its thread ends with the process, which does nothing but this flight
    return [world.robot(k, drone.name, config.driver_limits) for k, drone in enumerate(wanted)]


_DRIVERS: dict[str, Driver] = {"simulated": _simulated, "crazyflie": _crazyflie, "physics": _physics}


def _driver(name: str) -> Driver:
    if name in _DRIVERS:
        return _DRIVERS[name]
    module, colon, function = name.partition(":")
    if not colon:
        raise InputError("robot", name, f"{', '.join(_DRIVERS)}, or package.module:function")
    try:
        return cast("Driver", getattr(importlib.import_module(module), function))
    except (ImportError, AttributeError) as error:
        raise InputError("robot", name, f"a function that can be imported ({error})") from None
