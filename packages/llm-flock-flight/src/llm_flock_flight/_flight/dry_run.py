"""The dry run: simulates a whole flight with ideal bodies, and checks every set-point."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.record import NullWriter
from llm_flock.robots import PEAK_SPEED, Position
from llm_flock.runtime import Journal, RunResult, TeamPlanners, Trial, finish_trial
from llm_flock.simulate import InstantBodies, Readings
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import check_driver, with_drones
from llm_flock_flight._flight.homing import fly_home, homes_of
from llm_flock_flight._flight.landing import Descent, plan_landing
from llm_flock_flight._flight.sections import DroneConfig
from llm_flock_flight._flight.setpoints import SetPointCheck


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedMotion:
    """One joint motion: the final set-points, peak speeds, smallest separation (heights scaled), and faults."""

    round: int
    targets: tuple[Position, ...]
    peaks_m_s: tuple[float, ...]
    separation_m: float
    faults: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """The plan of a whole flight, which takes `air_s` if no model takes any time to answer.

    `away_m` maps each robot that misses its start to its distance from it [m].
    """

    drones: tuple[DroneConfig, ...]
    motions: tuple[PlannedMotion, ...]
    landing: tuple[tuple[Descent, ...], ...]
    result: RunResult
    away_m: Mapping[int, float]
    air_s: float
    max_flight_s: float

    @property
    def faults(self) -> list[str]:
        """Faults of all set-points by round; then robots that miss their starts, and a flight that is too long."""
        faults = [f"round {motion.round}: {fault}" for motion in self.motions for fault in motion.faults]
        for robot, distance_m in self.away_m.items():
            faults.append(f"{self.drones[robot].name} does not get home: it lands {distance_m:.2f} m from its start")
        if self.air_s > self.max_flight_s:
            faults.append(
                f"the flight takes {self.air_s:.0f} s, even if models answer at once; after max_flight_s = "
                f"{self.max_flight_s:g} s all land where they are"
            )
        return faults


class DryRunTeam(InstantBodies):
    """Simulated bodies that keep the commands that real ones would get."""

    def __init__(self, config: FlightConfig, starts: Points) -> None:
        super().__init__(Readings(config.mission, starts, 0.0, np.random.default_rng(0)))
        self._config = config
        self._check = SetPointCheck(config)
        self.motions: list[PlannedMotion] = []

    def set_points(self) -> list[Position]:
        """Set-points now [m]."""
        return [self._config.frame.to_world(tuple(row)) for row in self.positions.tolist()]

    async def fly(self, displacements: Points) -> None:
        """Check and keep the motion, and move at once."""
        before, seconds = self.set_points(), self._config.safety.round_s
        await super().fly(displacements)
        after = self.set_points()
        self.motions.append(
            PlannedMotion(
                round=len(self.motions) + 1,
                targets=tuple(after),
                peaks_m_s=tuple(PEAK_SPEED * math.dist(a, b) / seconds for a, b in zip(before, after, strict=True)),
                separation_m=self._check.separation(before, after),
                faults=tuple(self._check.faults(before, after, seconds)),
            )
        )


async def dry_run(config: FlightConfig) -> DryRun:
    """Simulate the flight with its real language models. InputError: a drone cannot be flown."""
    config = with_drones(config)
    check_driver(config)
    starts, safety = _starts(config), config.safety
    team = DryRunTeam(config, starts)
    trial = await _fly_trial(config, team, starts)
    away_m = await _fly_home(config, team, starts) if safety.at_end == "return" else {}
    take_off_groups = math.ceil(len(starts) / config.fleet.take_off_group)
    return DryRun(
        drones=config.fleet.drones,
        motions=tuple(team.motions),
        landing=tuple(map(tuple, plan_landing(config, dict(enumerate(team.set_points())), []))),
        result=finish_trial(trial, None),
        away_m=away_m,
        air_s=take_off_groups * safety.take_off_s + len(team.motions) * safety.round_s,
        max_flight_s=safety.max_flight_s,
    )


def _starts(config: FlightConfig) -> Points:
    rows: list[tuple[float, ...]] = []
    for drone in config.fleet.drones:
        if drone.start is None:
            raise InputError("drones", drone.name, "a start for each drone: a dry run does not ask the drones")
        x, y = drone.start[:2]
        rows.append(config.frame.to_mission((x, y, config.world.altitude_m)))
    return np.array(rows, dtype=np.float64)


async def _fly_trial(config: FlightConfig, team: DryRunTeam, starts: Points) -> Trial:
    planners = TeamPlanners(config)
    journal = Journal(config, NullWriter())
    planners.listen(journal.attempt)
    trial = Trial(config, config.protocol.rules(), planners, team, journal, starts)
    try:
        await trial.run()
    finally:
        await planners.close()
    return trial


async def _fly_home(config: FlightConfig, team: DryRunTeam, starts: Points) -> dict[int, float]:
    """Fly home; returns the robots that do not get there, with their distances from home [m]."""
    homes = homes_of(config, starts)
    away = await fly_home(config, team.readings, team.fly, homes)
    return {robot: math.dist(team.positions[robot], homes[robot]) * config.world.scale_m for robot in away}
