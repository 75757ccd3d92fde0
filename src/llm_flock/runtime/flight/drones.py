"""The drones of a flight file: which addresses, batteries and starts are refused."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from llm_flock.errors import InputError
from llm_flock.obstacles import clearance
from llm_flock.robots.addresses import one_spelling
from llm_flock.robots.crazyflie.radios import plan_radios, traffic_of

if TYPE_CHECKING:
    from llm_flock.runtime.flight.config import FlightConfig

ROUNDING_M = 1e-6
"""Tolerance of limits on lengths and times [m, s]."""

ON_FLOOR_M = 0.3
"""Largest distance of the estimate from the floor for a drone on it [m]."""


def check_drones(config: FlightConfig) -> None:
    """Drones are one for each robot, told apart by their names and addresses, and may fly longer than they take off.

    Raises:
        InputError: they are not.
    """
    drones, n = config.fleet.drones, config.mission.n_robots
    if drones and config.fleet.crazyflies is not None:
        raise InputError("drones", f"{len(drones)} drones", "either drones, or crazyflies")
    if drones and len(drones) != n:
        raise InputError("drones", f"{len(drones)} drones", f"one for each of the mission's {n} robots")
    shared = config.fleet.robot == "mavlink"  # several autopilots may answer at one address
    for field in ("name",) if shared else ("name", "uri"):
        given = [value for drone in drones if (value := getattr(drone, field)) is not None]
        twice = next((value for value in given if given.count(value) > 1), None)
        if twice is not None:
            raise InputError("drones", twice, says=f"two drones have this {field}")
    called = [(drone.name, drone.uri) for drone in drones if drone.uri is not None]
    for fault in plan_radios(called, traffic_of(round_s=config.safety.round_s)).faults:
        raise InputError("drones", None, says=fault)
    spelt: dict[str, tuple[str, str]] = {}
    for name, uri in called:
        first, as_it = spelt.setdefault(one_spelling(uri), (name, uri))
        if uri != as_it:
            raise InputError("drones", name, says=f"{uri} is the address of {first}, {as_it}, in other words")
    links = [(drone.uri, drone.system_id or 1) for drone in drones if shared]
    for uri, number in links:
        if links.count((uri, number)) > 1:
            raise InputError("system_id", number, f"one that no other drone at {uri} has")
    for drone in drones:
        for name in drone.parameters:
            if not all(part and not any(map(str.isspace, part)) for part in name.partition(".")[::2]):
                raise InputError("parameters", name, f"names such as stabilizer.controller for {drone.name}")
    _check_batteries(config)


def _check_batteries(config: FlightConfig) -> None:
    """A battery that is good enough for a take-off is not too low in the air."""
    safety = config.safety
    limits = [("", safety.ready_battery_v, safety.low_battery_v)]
    for drone in config.fleet.drones:
        ready = safety.ready_battery_v if drone.ready_battery_v is None else drone.ready_battery_v
        low = safety.low_battery_v if drone.low_battery_v is None else drone.low_battery_v
        limits.append((f" of {drone.name}", ready, low))
    for whose, ready, low in limits:
        if low > ready:
            says = f"at most ready_battery_v{whose}, {ready:g} V: a drone would land as soon as it is up"
            raise InputError("low_battery_v", low, says)


def check_starts(config: FlightConfig) -> None:
    """Starts are on the floor and apart, and drones may fly above them: they take off from there, and return to there.

    Raises:
        InputError: they are not, or may not.
    """
    least, floor_m = config.safe_distance_m, config.world.floor_m
    starts = [(drone.name, drone.start) for drone in config.fleet.drones if drone.start is not None]
    for k, (one, here) in enumerate(starts):
        for two, there in starts[:k]:
            apart = math.dist(here[:2], there[:2])
            if apart < least - ROUNDING_M:
                allowed = f"starts at least {least:g} m apart, the safe distance (here {apart:.3f} m)"
                raise InputError("drones", f"{two} and {one}", allowed)
        who = "{} at ({:g}, {:g}) m".format(one, *here)
        if (wrong := wrong_place(config, *here[:2])) is not None:
            raise InputError("drones", who, f"a start {good_place(config)} (here {wrong})")
        if len(here) == 3 and abs(here[2] - floor_m) > ON_FLOOR_M:
            allowed = f"a start within {ON_FLOOR_M:g} m of the floor at z = {floor_m:g} m (here {here[2]:g} m)"
            raise InputError("drones", who, allowed)


def wrong_place(config: FlightConfig, x_m: float, y_m: float) -> str | None:
    """Why no drone may fly above a place on the floor, in words; None where it may."""
    mission, place = config.mission, config.frame.to_mission((x_m, y_m, config.world.altitude_m))
    slack = ROUNDING_M / config.world.scale_m
    low, high = mission.arena
    if not all(a - slack <= v <= b + slack for a, v, b in zip(low, place, high, strict=True)):
        return "outside the arena"
    free = clearance(place, mission.obstacles)
    if free >= mission.body_radius - slack:
        return None
    return "in an obstacle" if free <= 0 else f"{free * config.world.scale_m:.2f} m from an obstacle"


def good_place(config: FlightConfig) -> str:
    """What `wrong_place` asks for, in words."""
    clear = f", at least {config.safe_distance_m / 2:.3g} m from its obstacles" if config.mission.obstacles else ""
    return f"in the mission's arena{clear}"
