"""The dry run: a whole flight with ideal bodies, in which every set-point is checked."""

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
from llm_flock_flight._flight.fleet import build_fleet, driver_of, with_drones
from llm_flock_flight._flight.homing import fly_home, homes_of
from llm_flock_flight._flight.landing import Descent, plan_landing
from llm_flock_flight._flight.sections import DroneConfig
from llm_flock_flight._flight.setpoints import SetPointCheck


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedMotion:
    """One joint motion: set-points at its end, highest speeds, smallest distance with heights scaled, and faults."""

    round: int
    targets: tuple[Position, ...]
    peaks_m_s: tuple[float, ...]
    separation_m: float
    faults: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """The plan of a whole flight, which takes `air_s` if no model takes any time to answer.

    `away_m` has how far from their starts those land that should return and do not get there, by robot [m].
    """

    drones: tuple[DroneConfig, ...]
    steps: tuple[PlannedMotion, ...]
    landing: tuple[tuple[Descent, ...], ...]
    result: RunResult
    away_m: Mapping[int, float]
    air_s: float
    most_s: float

    @property
    def faults(self) -> list[str]:
        """Faults of all set-points, with their rounds; then who does not get home, and a flight that takes too long."""
        found = [f"round {step.round}: {fault}" for step in self.steps for fault in step.faults]
        for robot, off in self.away_m.items():
            found.append(f"{self.drones[robot].name} does not get home: it lands {off:.2f} m from its start")
        if self.air_s > self.most_s:
            found.append(
                f"the flight takes {self.air_s:.0f} s, even if models answer at once; after max_flight_s = "
                f"{self.most_s:g} s all land where they are"
            )
        return found


class DryRunTeam(InstantBodies):
    """Simulated bodies that keep the commands that real ones would get."""

    def __init__(self, config: FlightConfig, aims: Points) -> None:
        super().__init__(Readings(config.mission, aims, 0.0, np.random.default_rng(0)))
        self._config = config
        self._check = SetPointCheck(config)
        self.steps: list[PlannedMotion] = []

    def set_points(self) -> list[Position]:
        """Set-points now [m]."""
        return [self._config.frame.to_world(tuple(row)) for row in self.positions.tolist()]

    async def fly(self, displacements: Points) -> None:
        """Check and keep the motion, and move at once."""
        before, seconds = self.set_points(), self._config.safety.round_s
        await super().fly(displacements)
        after = self.set_points()
        self.steps.append(
            PlannedMotion(
                round=len(self.steps) + 1,
                targets=tuple(after),
                peaks_m_s=tuple(PEAK_SPEED * math.dist(a, b) / seconds for a, b in zip(before, after, strict=True)),
                separation_m=self._check.separation(before, after),
                faults=tuple(self._check.faults(before, after, seconds)),
            )
        )


async def dry_run(config: FlightConfig) -> DryRun:
    """Fly on paper, with the models that the flight would ask; raises InputError for drones that cannot be flown."""
    config = with_drones(config)
    driver_of(config.fleet.robot)
    if config.fleet.robot in ("crazyflie", "mavlink"):
        build_fleet(config)  # which calls nobody, and refuses addresses
    aims = _aims(config)
    team = DryRunTeam(config, aims)
    planners = TeamPlanners(config)
    journal = Journal(config.mission, NullWriter(), replans=config.protocol.gaps == "replan")
    planners.listen(journal.attempt)
    trial = Trial(config, config.protocol.rules(), planners, team, journal, aims)
    try:
        await trial.run()
    finally:
        await planners.close()
    away_m: dict[int, float] = {}
    if config.safety.at_end == "return":
        homes = homes_of(config, aims)
        for robot in await fly_home(config, team.readings, team.fly, homes):
            away_m[robot] = math.dist(team.positions[robot], homes[robot]) * config.world.scale_m
    groups = plan_landing(config, dict(enumerate(team.set_points())), [])
    safety, ups = config.safety, math.ceil(len(aims) / config.fleet.take_off_group)
    return DryRun(
        drones=config.fleet.drones,
        steps=tuple(team.steps),
        landing=tuple(map(tuple, groups)),
        result=finish_trial(trial, None),
        away_m=away_m,
        air_s=ups * safety.take_off_s + len(team.steps) * safety.round_s,
        most_s=safety.max_flight_s,
    )


def _aims(config: FlightConfig) -> Points:
    rows: list[tuple[float, ...]] = []
    for drone in config.fleet.drones:
        if drone.start is None:
            raise InputError("drones", drone.name, "a start for each drone: a dry run does not ask the drones")
        x, y = drone.start[:2]
        rows.append(config.frame.to_mission((x, y, config.world.altitude_m)))
    return np.array(rows, dtype=np.float64)
