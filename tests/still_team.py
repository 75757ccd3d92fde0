"""A team of real agents on faulty links: robots fall silent, start late and come back.

Their bodies stand still, so only the agreement is tested.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from rounds import round_began
from whole_agent import whole_agent

from llm_flock import graph
from llm_flock.agent import Agent
from llm_flock.arrays import Point
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Effect,
    MissionGiven,
    Planned,
    Received,
)
from llm_flock.links import LinkFaults, MemoryTransport
from llm_flock.message import order_time
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus
from llm_flock.protocol._parts import Gaps

WIDE = ((-500.0, -500.0), (600.0, 600.0))
PERFECT = LinkFaults()
COMM_ROUNDS = 5


def connected_places(n: int, rng: np.random.Generator) -> list[Point]:
    """Positions of a connected, randomly branched team around the centre, no two nearer than 4."""
    places = [np.array([50.0, 50.0])]
    while len(places) < n:
        angle = rng.uniform(0, 2 * np.pi)
        new = places[rng.integers(len(places))] + rng.uniform(4, 14) * np.array([np.cos(angle), np.sin(angle)])
        if min(np.linalg.norm(new - old) for old in places) >= 4.0:
            places.append(new)
    return [tuple(float(x) for x in place) for place in places]


def a_leaf(places: list[Point], comm_range: float, root: int) -> int:
    """A robot without which the others stay connected: the last that a search from `root` finds."""
    near = graph.neighbors(places, comm_range)
    found = [root]
    for robot in found:
        found.extend(j for j in near[robot] if j not in found)
    return found[-1]


def turned_plan(question: PlanQuestion) -> Plan:
    """The ideal shape, turned by an angle that depends on the robot."""
    mission = question.mission
    assert mission.ideal is not None
    angle = 0.11 * (question.robot + 1)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    center = np.array(mission.center)
    return Plan.of(((np.array(mission.ideal) - center) @ turn.T + center).tolist())


class StillTeam:
    """N bodies, and an agent for each of them that is awake.

    Args:
        mission: what the team is asked to do at first.
        places: where the bodies are [units].
        rng: decides about the faults of the links.
        faults: faults of the links.
        asleep: robots that start later.
        time_out: rounds without a heartbeat after which a robot is taken for dead.
        gaps: what to do about places that no living robot can take.
        verify: whether plans are checked.
    """

    def __init__(
        self,
        mission: Mission,
        places: list[Point],
        rng: np.random.Generator,
        faults: LinkFaults = PERFECT,
        *,
        asleep: Collection[int] = (),
        time_out: int = 4,
        gaps: Gaps = "report",
        verify: bool = False,
    ) -> None:
        self.mission = mission
        self.places = places
        self.number = 0
        self.silent = set(asleep)
        self.cut_off = set[int]()
        self.asked: list[PlanQuestion] = []
        self._rng, self._time_out, self._verify = rng, time_out, verify
        self._gaps: Gaps = gaps
        self.agents = [self._new_agent(robot) for robot in range(mission.n_robots)]
        self.set_faults(faults)

    def _new_agent(self, robot: int) -> Agent:
        return whole_agent(
            robot,
            self.mission,
            ProvenanceConsensus(),
            AuctionAssignment(),
            shield_on=False,
            verify=self._verify,
            time_out=self._time_out,
            gaps=self._gaps,
        )

    def set_faults(self, faults: LinkFaults) -> None:
        """Give the links other faults from now on; messages on the way are lost."""
        self.transport = MemoryTransport(self.mission.n_robots, faults, self._rng)

    def wake(self, robot: int) -> None:
        """Start a robot; it remembers nothing."""
        self.silent.discard(robot)
        self.agents[robot] = self._new_agent(robot)

    @property
    def awake(self) -> list[int]:
        """Ids of the robots that run."""
        return [robot for robot in range(len(self.agents)) if robot not in self.silent]

    @property
    def active(self) -> list[Agent]:
        """The agents that run."""
        return [self.agents[robot] for robot in self.awake]

    def round(self, given: Mapping[int, Mission] | None = None, *, junk: Collection[bytes] = ()) -> None:
        """One round of all that are awake.

        Args:
            given: missions that robots are given at its start, one after the other.
            junk: payloads from outside that every robot receives in each communication round.
        """
        self.number += 1
        deaf = self.silent | self.cut_off
        times = {i: order_time(self.number, k) for k, i in enumerate(given or {})}
        near = graph.neighbors(self.places, self.mission.comm_range)
        heard_by = [() if i in deaf else tuple(j for j in near[i] if j not in deaf) for i in range(len(near))]
        for i in self.awake:
            if given and i in given:
                self.agents[i].handle(MissionGiven(mission=given[i], ordered_at=times[i]))
            sensed = {j: self.places[j] for j in near[i]}
            for effect in self.agents[i].handle(round_began(self.number, self.places[i], sensed, len(heard_by[i]))):
                if isinstance(effect, AskPlan):
                    self.asked.append(effect.question)
                    self.agents[i].handle(Planned(PlanAnswer(plan=turned_plan(effect.question), slot=i)))
        for _ in range(COMM_ROUNDS):
            self._comm_round(heard_by, junk)
        for agent in self.active:
            effects: list[Effect] = agent.handle(AgreementEnded())
            if isinstance(effects[-1], AskStep):
                agent.handle(Decided(NoAnswer(cause="answer", reason="bodies stand still")))
            agent.handle(Arrived())

    def _comm_round(self, heard_by: list[tuple[int, ...]], junk: Collection[bytes]) -> None:
        for i in self.awake:
            for effect in self.agents[i].handle(CommRoundBegan()):
                assert isinstance(effect, Broadcast)
                self.transport.broadcast(effect.payload, heard_by[i])
        for i, payload in self.transport.deliver():
            if i not in self.silent:
                self.agents[i].handle(Received(payload))
        for agent in self.active:
            for payload in junk:
                agent.handle(Received(payload))
            agent.handle(CommRoundEnded())
            slot = agent.claim.slot
            assert owned(agent) == ([] if slot is None else [slot]), "a robot owns at most one slot in its table"

    def rounds(self, count: int) -> None:
        """Run a number of rounds without a new mission."""
        for _ in range(count):
            self.round()


def owned(agent: Agent) -> list[int]:
    """Slots that a robot owns in its own table."""
    return [a for a, entry in enumerate(agent.claim.table or ()) if entry[2] == agent.robot]


def assert_at_rest(team: StillTeam, rejected: Mapping[str, int] | None = None) -> None:
    """One mission, one plan made for it, equal tables in which each awake robot owns the place that it claims.

    Args:
        team: the team.
        rejected: how many messages each robot has refused, by reason; none if left out.
    """
    active = team.active
    assert len({agent.mission.digest for agent in active}) == 1
    assert len({agent.plan for agent in active}) == 1
    assert all(a.provenance is not None and a.provenance.mission_digest == a.mission.digest for a in active)
    tables = {agent.claim.table for agent in active}
    assert len(tables) == 1
    (table,) = tables
    assert table is not None
    claimed = {agent.claim.slot: agent.robot for agent in active if agent.claim.slot is not None}
    owners = {a: owner for a, (_, _, owner) in enumerate(table) if owner >= 0}
    assert owners == claimed, "slots belong to the robots that claim them"
    assert all(agent.rejected == (rejected or {}) for agent in active)
