"""The radios of a flight: their loads and warnings, for the preflight and the dry run."""

from __future__ import annotations

from llm_flock.robots.crazyflie.radios import MOST_SHARE, RadioPlan, plan_radios, traffic_of
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.preflight import Check

RADIO = "radio"
"""Name of the preflight line of a radio."""


def radio_plan(config: FlightConfig) -> RadioPlan:
    """What the radios of a flight have to carry; without loads where no drone is called by radio."""
    drones = [(drone.name, drone.uri) for drone in config.fleet.drones if drone.uri is not None]
    pose_hz = config.positions.pose_rate_hz if config.positions.outside else 0.0
    return plan_radios(drones, traffic_of(round_s=config.safety.round_s, pose_hz=pose_hz))


def radio_checks(config: FlightConfig) -> list[Check]:
    """One line for each radio. A load that is too large is only warned of: the capacity is a model's."""
    if config.fleet.robot != "crazyflie":
        return []
    return [
        Check(
            RADIO,
            f"radio {load.dongle}",
            True,
            f"WARNING: {load}" if load.share > MOST_SHARE else str(load),
            f"at most {MOST_SHARE:.0%}",
        )
        for load in radio_plan(config).loads
    ]
