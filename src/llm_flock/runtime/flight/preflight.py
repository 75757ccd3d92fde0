"""Preflight: every drone connected, ready, at its start and apart from the others; reports every check."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from llm_flock.robots.base import Robot, RobotError, RobotState
from llm_flock.runtime.flight.config import FlightConfig

SETTLE_S = 3.0
"""Longest time from the connections until all checks pass: estimators converge, batteries are read [s]."""

LOOK_S = 0.05
"""Time between two checks [s]."""

ON_FLOOR_M = 0.3
"""Largest distance of the estimate from the floor for a drone on it [m]."""

CHECKS = ("link", "battery", "estimator", "on the floor", "start position", "in the arena")
"""Names of the checks of a drone. The arena is within the geofence, so a drone in the arena is as well."""

NAMES = ("connected", *CHECKS, "apart")
"""Names of all checks, in order."""


@dataclass(frozen=True, slots=True)
class Check:
    """One check of one drone, or of the `team`: the finding, and the requirement (empty where it is obvious)."""

    name: str
    who: str
    passed: bool
    found: str
    asked: str = ""

    def __str__(self) -> str:
        return f"{self.who}: {self.name}: {self.found}" + (f", {self.asked}" if self.asked else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class PreflightReport:
    """All checks of a preflight, in order, and the time until all drones were connected, or had failed."""

    checks: tuple[Check, ...]
    connect_s: float

    @property
    def passed(self) -> bool:
        """Whether every check was passed."""
        return all(check.passed for check in self.checks)


async def connect(config: FlightConfig, robots: Sequence[Robot]) -> tuple[list[Check], float]:
    """Connect to all drones at once; returns a check of each connection, and the time taken [s]."""
    began = time.monotonic()

    async def one(robot: Robot) -> Check:
        try:
            await robot.connect(config.fleet.connect_s)
        except RobotError as error:
            return Check("connected", robot.name, False, error.what)
        return Check("connected", robot.name, True, f"{time.monotonic() - began:.2f} s")

    checks = await asyncio.gather(*map(one, robots))
    return list(checks), time.monotonic() - began


async def preflight(config: FlightConfig, robots: Sequence[Robot]) -> PreflightReport:
    """Connect, then repeat the checks until all pass or the time for that is over."""
    connections, seconds = await connect(config, robots)
    if not all(check.passed for check in connections):
        return PreflightReport(checks=tuple(connections), connect_s=seconds)
    until = time.monotonic() + SETTLE_S
    while True:
        checks = look(config, [robot.name for robot in robots], [robot.state() for robot in robots], time.monotonic())
        if all(check.passed for check in checks) or time.monotonic() > until:
            return PreflightReport(checks=(*connections, *checks), connect_s=seconds)
        await asyncio.sleep(LOOK_S)


def look(config: FlightConfig, names: Sequence[str], states: Sequence[RobotState], now_s: float) -> list[Check]:
    """Every check but the connection, by drone; `now_s` is on the clock of the states."""
    found = [
        Check(title, name, *finding)
        for robot, (name, state) in enumerate(zip(names, states, strict=True))
        for title, finding in zip(CHECKS, _findings(config, robot, state, now_s), strict=True)
    ]
    return [*found, _apart(config, names, states)]


def _findings(config: FlightConfig, robot: int, state: RobotState, now: float) -> Iterator[tuple[bool, str, str]]:
    """For each of `CHECKS` whether it is passed, the finding, and the requirement."""
    world, safety = config.world, config.safety
    if state.link_lost:
        yield False, "lost", "there"
    elif state.link is None:
        yield True, "not told", ""
    else:
        least = safety.ready_link
        yield state.link >= least, f"{state.link:.0%}", f"at least {least:.0%} of packets acknowledged"

    if state.battery_v is None:
        yield True, "not told", ""
    else:
        least = safety.ready_battery_v
        yield state.battery_v >= least, f"{state.battery_v:.2f} V", f"at least {least:.2f} V"

    age = now - state.stamp_s
    fresh = age <= safety.stall_s
    said = f"{age:.1f} s old" if not fresh else "converged" if state.settled else "not converged"
    yield state.settled and fresh, said, "a fresh estimate of a converged estimator"

    x, y, z = state.position
    above = z - world.floor_m
    passed = not state.flying and abs(above) <= ON_FLOOR_M
    yield passed, f"{above:+.2f} m", f"at most {ON_FLOOR_M:g} m from the floor, motors off"

    start = config.fleet.drones[robot].start if config.fleet.drones else None
    if start is None:
        yield True, "not given", ""
    else:
        off, most = math.dist(start[:2], (x, y)), safety.start_tolerance_m
        yield off <= most, f"{off:.2f} m off", f"within {most:g} m of ({start[0]:g}, {start[1]:g}) m"

    row = config.frame.to_mission((x, y, world.altitude_m))
    inside = all(a <= value <= b for value, (a, b) in zip(row, zip(*config.mission.arena, strict=True), strict=True))
    yield inside, f"{x:.2f}, {y:.2f} m", "in the mission's arena"


def _apart(config: FlightConfig, names: Sequence[str], states: Sequence[RobotState]) -> Check:
    """Distances side by side: on the floor, heights do not count."""
    least = config.safe_distance_m
    pairs = [
        (math.dist(a.position[:2], b.position[:2]), f"{names[j]} and {names[i]}")
        for i, a in enumerate(states)
        for j, b in enumerate(states[:i])
    ]
    nearest, who = min(pairs, default=(math.inf, ""))
    said = f"{nearest:.2f} m" if pairs else "alone"
    return Check("apart", "team", nearest >= least, said, f"at least {least:g} m between {who}")
