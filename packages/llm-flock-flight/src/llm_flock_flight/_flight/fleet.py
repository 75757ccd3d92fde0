"""Builds the drones of a flight: their driver, a plug-in of the kind `robots`, addresses and starts."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias, cast

from llm_flock import plugins
from llm_flock.errors import InputError, unknown
from llm_flock.robots import Position, Robot
from llm_flock.runtime import Stream, stream
from llm_flock.simulate import draw_start
from llm_flock.user_code import load_own
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.sections import DroneConfig

logger = logging.getLogger(__name__)

Driver: TypeAlias = Callable[[FlightConfig, Sequence[DroneConfig]], Sequence[Robot]]
"""Makes the robots of a flight, one for each drone, in order."""

DRIVER = "a function (config, drones) that returns a robot for each drone"

LOADED = 3.2 / 3.7
"""Share of its voltage at rest that a battery keeps while motors run: Crazyswarm2's limits are for a drone at rest."""


def _voltage_under_load(critical_v: float | None, least_v: float) -> float | None:
    """The voltage at which a drone lands, by its critical voltage at rest and the flight file's own limit [V]."""
    return None if critical_v is None else max(LOADED * critical_v, least_v)


def with_drones(config: FlightConfig) -> FlightConfig:
    """The same flight with its drones listed: those of the file, those of `crazyflies.yaml`, or else drawn starts."""
    if config.fleet.drones:
        return config
    found: list[dict[str, object]]
    if config.fleet.crazyflies is not None:
        from llm_flock_flight._crazyflie.crazyflies_yaml import read_crazyflies

        drones = read_crazyflies(Path(config.fleet.crazyflies))
        unplaced = config.positions.outside and len(drones) > 1 and not any(any(drone.home) for drone in drones)
        if unplaced:
            logger.warning(
                "all initial positions are zero: drones start where they are measured, and swapped ones pass"
            )
        found = [
            {
                "name": drone.name,
                "uri": drone.uri,
                "start": None if unplaced else drone.home,
                "parameters": drone.parameters,
                "ready_battery_v": drone.battery.voltage_warning,
                "low_battery_v": _voltage_under_load(drone.battery.voltage_critical, config.safety.low_battery_v),
            }
            for drone in drones
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
    """The robots of a flight, not connected yet; raises InputError if no driver can drive these drones."""
    wanted = config.fleet.drones
    if not wanted:
        raise InputError("drones", None, "one for each robot of the mission")
    robots = driver_of(config.fleet.robot)(config, wanted)
    count = len(robots) if isinstance(cast(object, robots), Sequence) else type(robots).__name__
    if count != len(wanted):
        raise InputError("robot", config.fleet.robot, f"{DRIVER}, {len(wanted)} here (not {count})")
    return robots


def check_driver(config: FlightConfig) -> None:
    """Raise InputError for an unknown driver, or for addresses that it refuses; opens no connection."""
    if driver_of(config.fleet.robot) in (crazyflie, mavlink):
        build_fleet(config)


def start_of(config: FlightConfig, drone: DroneConfig) -> Position:
    """Position of a drone before take-off [m]; raises InputError if the file does not say it."""
    if drone.start is None:
        raise InputError("drones", drone.name, "a start for each drone of this driver")
    return (drone.start[0], drone.start[1], config.world.floor_m if len(drone.start) < 3 else drone.start[2])


def simulated(config: FlightConfig, wanted: Sequence[DroneConfig]) -> Sequence[Robot]:
    """Point masses in this process; see `Driver`."""
    from llm_flock.robots import PointMass, SimulatedRobot

    bodies = [PointMass(home=start_of(config, drone), ground_m=config.world.floor_m) for drone in wanted]
    limits = config.driver_limits
    return [SimulatedRobot(d.name, body.home, limits=limits, body=body) for d, body in zip(wanted, bodies, strict=True)]


def crazyflie(config: FlightConfig, wanted: Sequence[DroneConfig]) -> Sequence[Robot]:
    """Crazyflies, by radio or by a simulator's address; see `Driver`."""
    from llm_flock_flight._crazyflie import CrazyflieRobot
    from llm_flock_flight._crazyflie import controllers as known
    from llm_flock_flight._crazyflie.robot import LINK_TIMEOUT_S

    cache = None if config.fleet.cache is None else Path(config.fleet.cache)
    chosen: dict[str, float] = {}
    if config.fleet.controller is not None:
        chosen[known.CONTROLLER] = known.number_of(known.CONTROLLERS, config.fleet.controller)
    if config.fleet.estimator is not None:
        chosen[known.ESTIMATOR] = known.number_of(known.ESTIMATORS, config.fleet.estimator)
    robots: list[Robot] = []
    for drone in wanted:
        if drone.uri is None:
            raise InputError("drones", drone.name, "a uri for each Crazyflie, such as radio://0/80/2M/E7E7E7E701")
        robots.append(
            CrazyflieRobot(
                drone.name,
                drone.uri,
                limits=config.driver_limits,
                link_timeout_s=max(LINK_TIMEOUT_S, config.safety.stall_s),
                parameters={**chosen, **drone.parameters},
                cache=cache,
                stop_watchdog=config.fleet.stop_watchdog,
            )
        )
    return robots


def mavlink(config: FlightConfig, wanted: Sequence[DroneConfig]) -> Sequence[Robot]:
    """Copters with PX4 or ArduPilot; see `Driver`."""
    from llm_flock_flight._mavlink import Geodetic, LocalFrame, MavlinkRobot, Ports

    fleet, ports = config.fleet, Ports()
    origin: Geodetic | None = None
    if fleet.origin_lat_lon_alt is not None:
        latitude, longitude, altitude = fleet.origin_lat_lon_alt
        origin = Geodetic(latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude)
        if fleet.local_frames == "common":
            raise InputError("local_frames", "common", says="is of no use with origin_lat_lon_alt")
    robots: list[Robot] = []
    for drone in wanted:
        if drone.uri is None:
            raise InputError("drones", drone.name, "a uri for each drone, such as udp://0.0.0.0:14540")
        if drone.parameters:
            raise InputError("parameters", drone.name, says="cannot be set by MAVLink: set them by a ground station")
        frame = LocalFrame()
        if origin is None and fleet.local_frames == "start":
            frame = LocalFrame(origin=start_of(config, drone))
        robots.append(
            MavlinkRobot(
                *(drone.name, drone.uri),
                ports=ports,
                system_id=drone.system_id or 1,
                frame=frame,
                origin=origin,
                limits=config.driver_limits,
            )
        )
    return robots


def physics(config: FlightConfig, wanted: Sequence[DroneConfig]) -> Sequence[Robot]:
    """Quadrotors in simulated physics, in this process; see `Driver`."""
    from llm_flock_flight._physics import PhysicsWorld

    if config.world.floor_m != 0.0:
        raise InputError("floor_m", config.world.floor_m, "0 in physics")
    world = PhysicsWorld([start_of(config, drone) for drone in wanted])
    world.start()  # its thread ends with the process, which does nothing but this flight
    return [world.robot(k, drone.name, config.driver_limits) for k, drone in enumerate(wanted)]


def driver_of(name: str) -> Driver:
    """The driver of this name, or InputError: a plug-in, or a function of one's own as package.module:function."""
    if ":" in name:
        found = load_own("robot", name, f"{DRIVER} and can be imported")
        if isinstance(found, type) or not callable(found):
            raise InputError("robot", name, DRIVER)
        return cast("Driver", found)
    try:
        return cast("Driver", plugins.load("robots", name))
    except KeyError:
        known = (*plugins.entries("robots"), "package.module:function")
        raise InputError("robot", name, says=unknown("driver", name, known)) from None
