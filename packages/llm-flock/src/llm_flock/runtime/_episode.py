"""The part of a run with one mission: the round in which the team formed, its shape error, its lower bound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from llm_flock import metrics
from llm_flock.agent import Agent
from llm_flock.arrays import Point, Points, flattened
from llm_flock.errors import InputError
from llm_flock.message import NO_OWNER
from llm_flock.mission import Mission
from llm_flock.plan import Plan


class Episode:
    """One mission, from when the first robot received it: the rounds `flown`, and true positions [units] by then."""

    def __init__(self, mission: Mission, flown: int, positions: Points) -> None:
        self.mission = mission
        self.flown = flown
        self._start = positions
        self.disturb(flown)
        self.bound: int | None = None  # lower bound of the rounds it takes, set by `close`; None without one plan
        self._targets: dict[int, metrics.ShapeTarget | None] = {}
        self._deadline: tuple[object, int] = (None, 0)
        self._measured: tuple[Points, metrics.ShapeError | None] | None = None

    def disturb(self, flown: int) -> None:
        """A robot died or joined, so the team has to form again."""
        spacing = self.mission.spacing
        self.trackers = {k: metrics.FormedTracker(spacing=k * spacing) for k in (1.0, 0.5, 2.0)}  # by tolerance
        self.tracker = self.trackers[1.0]
        self._disturbed = flown

    @property
    def formed_at(self) -> int | None:
        """First round in which the team had formed, after the last robot that died or joined; None if it never did."""
        return self.tracker.formed_at

    @property
    def rounds_to_formed(self) -> int | None:
        """Rounds from the moment at which the mission was given until the team had formed."""
        return None if self.formed_at is None else self.formed_at - self.flown

    def deadline(self, awake: Sequence[int], agents: Sequence[Agent], after: int, pace: int = 1) -> int:
        """The round by which a team that flies in one of `pace` rounds should have formed, without events later on.

        Round `after` has the last of them.
        """
        plan = self.plan(agents)
        key = None if plan is None else plan.digest, len(awake), after
        if self._deadline[0] != key:
            # Before they agree on a plan, count the way to the ideal shape; without one, to the centre.
            places = self.mission.ideal or (self.mission.center,) if plan is None else plan.points
            bound = self._bound(awake, np.array(places))
            since = max(self._disturbed, after)
            self._deadline = key, since + metrics.deadline(bound * pace) + metrics.HELD_ROUNDS - 1
        return self._deadline[1]

    def _bound(self, awake: Sequence[int], goals: Points) -> int:
        """Lower bound of the rounds from the start of the mission to these goals of its frame."""
        mission = self.mission

        def drift(rounds: int) -> Point:
            return mission.drift(self.flown + rounds)

        along = None if mission.velocity is None else drift
        within, start = metrics.AT_GOAL * mission.spacing, self._start[list(awake)]
        ways = mission.shortest_ways
        return metrics.lower_bound_rounds(start, goals, mission.max_step, along, within=within, ways=ways)

    def error(self, positions: Points) -> metrics.ShapeError | None:
        """Distance of `positions`, shape (m, d), from the ideal shape of m robots; None without an ideal."""
        # A team that has arrived stays where it is.
        if self._measured is None or not np.array_equal(self._measured[0], positions):
            target = self._target(len(positions))
            self._measured = positions.copy(), None if target is None else target.error(positions)
        return self._measured[1]

    def _target(self, count: int) -> metrics.ShapeTarget | None:
        if count not in self._targets:
            try:
                ideal = self.mission.resized(count).ideal if count else None
            except InputError:  # the shape does not exist for this number of robots
                ideal = None
            self._targets[count] = (
                None if ideal is None else metrics.ShapeTarget(np.array(ideal), turns=self.mission.turn is None)
            )
        return self._targets[count]

    def plan(self, agents: Sequence[Agent]) -> Plan | None:
        """The plan of this mission that all of these robots follow, or None."""
        plans = {None if a.plan is None else a.plan.digest for a in agents}
        return agents[0].plan if len(plans) == 1 and all(map(self.follows, agents)) else None

    def follows(self, agent: Agent) -> bool:
        """Whether a robot follows a plan that was made for this mission."""
        return agent.provenance is not None and agent.provenance.mission_digest == self.mission.digest

    def close(self, awake: Sequence[int], agents: Sequence[Agent], asleep: Points) -> None:
        """End the mission: compute the rounds that a perfect central planner needs for the plan of these agents.

        `asleep` are the bodies of the other robots, shape (m, d) [units].
        """
        plan = self.plan(agents)
        if plan is None:
            self.bound = None
            return
        blocked = blocked_places(agents, plan, asleep, self.mission)
        goals = np.array([point for slot, point in enumerate(plan.points) if slot not in blocked])
        self.bound = self._bound(awake, goals) if len(goals) else 0


def fits(mission: Mission, places: int, robots: int) -> bool:
    """Whether a plan has as many places as a new plan for this number of robots would have."""
    try:
        return places == mission.resized(min(robots, mission.n_places)).n_places
    except InputError:
        return True


def blocked_places(agents: Sequence[Agent], plan: Plan, bodies: Points, mission: Mission) -> frozenset[int]:
    """Slots without an owner that any of these agents takes for blocked, and on which one of the `bodies` does lie."""
    tables = (agent.claim.table or () for agent in agents)
    said = {slot for table in tables for slot, entry in enumerate(table) if entry[2] < NO_OWNER}
    apart = {slot: np.linalg.norm(flattened(bodies - plan.array[slot], mission.downwash), axis=1) for slot in said}
    return frozenset(slot for slot, ways in apart.items() if ways.size and ways.min() < mission.safe_distance)
