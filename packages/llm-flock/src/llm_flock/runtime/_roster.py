"""The agents of a team. Those that have died, or have not begun yet, are not awake."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable

from llm_flock.agent import Agent
from llm_flock.protocol._parts import Checker, Membership, Parts, Safety
from llm_flock.record._schema import ASLEEP, DEAD
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._rules import Rules, know_no_team
from llm_flock.simulate import Bodies


def load_solvers() -> None:
    """Import the solvers of agents: half a second of waiting in flight would make them miss deadlines."""
    for name in ("scipy.optimize", "scipy.sparse.csgraph", "scipy.spatial"):
        importlib.import_module(name)


def parts_of(config: RunConfig, rules: Rules, robot: int, *, apart: float | None = None) -> Parts:
    """The parts of one robot in a team without keys. Call once for each agent, as parts keep state.

    Bodies that are `apart` pass each other, by default the safe distance [units].
    """
    protocol, mission = config.protocol, config.mission
    any_size = protocol.gaps == "replan" or protocol.judge == "models"
    team, safety, verifier = Membership(), Safety(), Checker(any_size=any_size)
    if any_size or not know_no_team(rules):
        from llm_flock.protocol._membership.team import TeamMembership

        parts = {"joint": protocol.without != "joint-assignment", "searches": protocol.without != "search"}
        team = TeamMembership(robot, mission, time_out=protocol.time_out, gaps=protocol.gaps, **parts)
    if protocol.shield:
        from llm_flock.protocol._motion.safety import ShieldedSafety

        sight, delay = config.sight, config.trial.sensing_delay
        safety = ShieldedSafety(robot, mission, sight.error, apart, delay=delay, rests=sight.rests)
        safety.asks = protocol.without != "right-of-way"
    if protocol.verify:
        from llm_flock.protocol._verification.validator import Validator

        verifier = Validator(shield_on=bool(protocol.shield), any_size=any_size)
    consensus, assignment = rules
    return Parts(consensus=consensus, assignment=assignment, membership=team, safety=safety, verifier=verifier)


def make_agent(config: RunConfig, robot: int, parts: Parts, *, own_clock: bool = False) -> Agent:
    """A new agent. Its heartbeats follow lockstep rounds, or the robot's `own_clock`."""
    if own_clock:
        load_solvers()
    return Agent(
        robot,
        config.mission,
        parts=parts,
        fallback=config.protocol.fallback or "hold",
        on_event=config.model.decide == "on-event",
        noise_bound=config.sight.error,
        judges=config.protocol.judge == "models",
        own_clock=own_clock,
    )


class Roster:
    """One agent a robot, and which robots are awake: those `asleep` join later. A silent robot still has its body."""

    def __init__(self, make: Callable[[int], Agent], n_robots: int, asleep: Iterable[int] = ()) -> None:
        self._make = make
        self._silent = dict.fromkeys(asleep, ASLEEP)
        self.agents = [make(robot) for robot in range(n_robots)]
        self.awake: list[int] = []
        self._update()

    def _update(self) -> None:
        self.awake = [robot for robot in range(len(self.agents)) if robot not in self._silent]

    def kill(self, robot: int) -> None:
        """Silence a robot: from now on it neither plans, moves, sends nor receives."""
        self._silent[robot] = DEAD
        self._update()

    def join(self, robot: int) -> Agent:
        """Let a robot begin, with a new agent; returns its former one."""
        del self._silent[robot]
        before, self.agents[robot] = self.agents[robot], self._make(robot)
        self._update()
        return before

    def awake_agents(self) -> list[Agent]:
        """Agents of the robots that are awake, by id."""
        return [self.agents[robot] for robot in self.awake]

    def phase(self, robot: int) -> str:
        """Phase of a robot's agent; `ASLEEP` or `DEAD` for a silent robot."""
        return self._silent.get(robot) or self.agents[robot].phase.value

    def hears(self, team: Bodies, robot: int) -> tuple[int, ...]:
        """Awake robots within radio range of one that is awake; empty for a silent robot."""
        if not self._silent:
            return team.readings.in_radio_range[robot]
        if robot in self._silent:
            return ()
        return tuple(other for other in team.readings.in_radio_range[robot] if other not in self._silent)

    def reaches(self, team: Bodies, robot: int) -> tuple[int, ...]:
        """Awake robots to whom others can pass a robot's broadcasts on: its connected component without itself."""
        reached, frontier = {robot}, [robot]
        while frontier:
            new = set(self.hears(team, frontier.pop())) - reached
            reached |= new
            frontier += new
        return tuple(sorted(reached - {robot}))
