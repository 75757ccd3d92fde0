"""The dry run: the whole flight with bodies that are where they are told to be, and every set-point checked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.record.writer import NullWriter
from llm_flock.robots.base import PEAK_SPEED, Position
from llm_flock.runtime.api import minds
from llm_flock.runtime.bodies import AtOnce
from llm_flock.runtime.flight.config import Drone, FlightConfig
from llm_flock.runtime.flight.fleet import with_drones
from llm_flock.runtime.flight.landing import Descent, plan_landing
from llm_flock.runtime.flight.setpoints import SetPointCheck
from llm_flock.runtime.journal import Journal
from llm_flock.runtime.result import RunResult
from llm_flock.runtime.roster import Roster
from llm_flock.runtime.rules import assignment_rule, consensus_rule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.team import Thinkers
from llm_flock.runtime.trial import Trial
from llm_flock.transport.memory import MemoryTransport


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One motion of all.

    Attributes:
        round: which.
        targets: set-points at its end, by robot [m].
        peaks_m_s: highest speed on the way, by robot [m/s].
        separation_m: smallest distance of two set-points on the way, heights scaled by the vertical rule [m].
        faults: what is wrong with it.
    """

    round: int
    targets: tuple[Position, ...]
    peaks_m_s: tuple[float, ...]
    separation_m: float
    faults: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rehearsal:
    """A flight on paper.

    Attributes:
        drones: who flies, with a start for each.
        steps: every motion.
        landing: groups that land at once.
        result: of the trial.
    """

    drones: tuple[Drone, ...]
    steps: tuple[Step, ...]
    landing: tuple[tuple[Descent, ...], ...]
    result: RunResult

    @property
    def faults(self) -> list[str]:
        """Everything that is wrong with a set-point, with its round."""
        return [f"round {step.round}: {fault}" for step in self.steps for fault in step.faults]


class RehearsedTeam(AtOnce):
    """Simulated bodies that write down what real ones would be told.

    Args:
        config: the flight.
        aims: where they hover at first, shape (n, d) [units].
    """

    def __init__(self, config: FlightConfig, aims: Points) -> None:
        super().__init__(config.mission, aims, 0.0, np.random.default_rng(0))
        self._config = config
        self._check = SetPointCheck(config)
        self.steps: list[Step] = []

    def places(self) -> list[Position]:
        """Set-points now [m]."""
        return [self._config.frame.to_world(tuple(row)) for row in self.positions.tolist()]

    async def fly(self, displacements: Points) -> None:
        """Write the motion down, and be there."""
        before, seconds = self.places(), self._config.safety.round_s
        await super().fly(displacements)
        after = self.places()
        self.steps.append(
            Step(
                round=len(self.steps) + 1,
                targets=tuple(after),
                peaks_m_s=tuple(PEAK_SPEED * math.dist(a, b) / seconds for a, b in zip(before, after, strict=True)),
                separation_m=self._check.separation(before, after),
                faults=tuple(self._check.faults(before, after, seconds)),
            )
        )


async def rehearse(config: FlightConfig) -> Rehearsal:
    """Fly on paper, with the models that the flight would ask.

    Raises:
        InputError: a drone has no start, or one that no mission can begin from.
    """
    config = with_drones(config)
    fleet = config.fleet.drones
    aims = _aims(config, fleet)
    team = RehearsedTeam(config, aims)
    protocol, mission = config.protocol, config.mission
    rules = consensus_rule(protocol.consensus or ""), assignment_rule(protocol.assignment or "")
    schedule = config.schedule()
    thinkers = Thinkers(config)
    journal = Journal(mission, NullWriter(), replans=protocol.gaps == "replan")
    thinkers.listen(journal.attempt)
    journal.mission_given(mission, 0, aims)
    trial = Trial(
        config,
        schedule,
        Roster(minds(config, *rules), mission.n_robots, schedule.asleep),
        thinkers,
        team,
        MemoryTransport(mission.n_robots, config.links, stream(config.trial.seed, Stream.LINKS)),
        journal,
    )
    try:
        await trial.run()
    finally:
        await thinkers.close()
    groups = plan_landing(config, dict(enumerate(team.places())), [])
    return Rehearsal(
        drones=fleet,
        steps=tuple(team.steps),
        landing=tuple(map(tuple, groups)),
        result=trial.finish(None),
    )


def _aims(config: FlightConfig, fleet: Sequence[Drone]) -> Points:
    rows: list[tuple[float, ...]] = []
    low, high = config.mission.arena
    for drone in fleet:
        if drone.start is None:
            raise InputError("drones", drone.name, "a start for each drone: a dry run does not ask the drones")
        x, y = drone.start[:2]
        row = config.frame.to_mission((x, y, config.world.altitude_m))
        if not all(a <= value <= b for a, value, b in zip(low, row, high, strict=True)):
            raise InputError("drones", f"{drone.name} at ({x:g}, {y:g}) m", "a start in the arena of the mission")
        rows.append(row)
    return np.array(rows, dtype=np.float64)
