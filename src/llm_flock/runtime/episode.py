"""The part of a run in which one mission is in force: when the team formed, its shape error, its lower bound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock.protocol.agent import Agent
from llm_flock.protocol.messages.message import NO_OWNER
from llm_flock.protocol.plan import Plan


class Episode:
    """One mission, from the moment at which the first robot received it.

    Args:
        mission: the mission.
        flown: rounds flown before; the mission is given at the start of the next one.
        positions: true positions then, shape (n, d) [units].

    Attributes:
        bound: lower bound of the rounds it takes, known when the mission is over; None without one plan.
    """

    def __init__(self, mission: Mission, flown: int, positions: Points) -> None:
        self.mission = mission
        self.flown = flown
        self.tracker = metrics.FormedTracker(spacing=mission.spacing)
        self._start = positions
        self._disturbed = flown
        self.bound: int | None = None
        self._targets: dict[int, metrics.ShapeTarget | None] = {}
        self._measured: tuple[Points, metrics.ShapeError | None] | None = None

    def disturb(self, flown: int) -> None:
        """A robot died or joined, so the team has to form again."""
        self.tracker = metrics.FormedTracker(spacing=self.mission.spacing)
        self._disturbed = flown

    @property
    def formed_at(self) -> int | None:
        """First round in which the team had formed, after the last robot that died or joined; None if it never did."""
        return self.tracker.formed_at

    @property
    def rounds_to_formed(self) -> int | None:
        """Rounds from the moment at which the mission was given until the team had formed."""
        return None if self.formed_at is None else self.formed_at - self.flown

    def in_time(self, bound: int | None) -> bool:
        """Whether the team formed in three times the lower bound plus 20 rounds, counted from the last disturbance."""
        formed = self.formed_at
        return formed is not None and bound is not None and metrics.within_limit(formed - self._disturbed, bound)

    def error(self, positions: Points) -> metrics.ShapeError | None:
        """Distance from the ideal shape of as many robots as `positions`, shape (m, d), has; None without an ideal."""
        # A team that has arrived stays where it is.
        if self._measured is None or not np.array_equal(self._measured[0], positions):
            count = len(positions)
            if count not in self._targets:
                self._targets[count] = self._target(count)
            target = self._targets[count]
            self._measured = positions.copy(), None if target is None else target.error(positions)
        return self._measured[1]

    def _target(self, count: int) -> metrics.ShapeTarget | None:
        if not count:
            return None
        try:
            ideal = self.mission.resized(count).ideal
        except InputError:  # the shape does not exist for this number of robots
            return None
        return None if ideal is None else metrics.ShapeTarget(np.array(ideal))

    def plan(self, agents: Sequence[Agent]) -> Plan | None:
        """The plan of this mission that all of these robots follow, or None."""
        plans = {None if a.plan is None else a.plan.digest for a in agents}
        return agents[0].plan if len(plans) == 1 and all(map(self.follows, agents)) else None

    def follows(self, agent: Agent) -> bool:
        """Whether a robot follows a plan that was made for this mission."""
        return agent.provenance is not None and agent.provenance.mission_digest == self.mission.digest

    def fits(self, plan: Plan, robots: int) -> bool:
        """Whether a plan has as many places as a new plan for this number of robots would have."""
        wanted = min(robots, self.mission.n_places)
        try:
            return len(plan) == self.mission.resized(wanted).n_places
        except InputError:
            return True

    def close(self, awake: Sequence[int], agents: Sequence[Agent]) -> None:
        """The mission is over: find the rounds that a perfect central planner needs for the plan agreed on.

        Args:
            awake: robots that count.
            agents: their agents.
        """
        self.bound = self._lower_bound(awake, agents)

    def _lower_bound(self, awake: Sequence[int], agents: Sequence[Agent]) -> int | None:
        plan = self.plan(agents)
        if plan is None:
            return None
        blocked = blocked_places(agents)
        goals = np.array([point for slot, point in enumerate(plan.points) if slot not in blocked])
        if not len(goals):
            return 0
        start = self._start[list(awake)]
        if self.mission.velocity is None:
            return metrics.lower_bound_rounds(start, goals, self.mission.max_step)
        return metrics.lower_bound_rounds(
            start, goals, self.mission.max_step, lambda rounds: self.mission.drift(self.flown + rounds)
        )


def blocked_places(agents: Sequence[Agent]) -> frozenset[int]:
    """Slots without an owner because an obstructing body lies on them, as known to any of these agents."""
    found: set[int] = set()
    for agent in agents:
        table = agent.claim.table
        if table is not None:
            found.update(slot for slot, entry in enumerate(table) if entry[2] < NO_OWNER)
    return frozenset(found)
