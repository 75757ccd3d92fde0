"""Rivals of the project's rules, for comparison: what is known from elsewhere, on the same bodies, radio and shield.

Rules that a robot applies to its own messages have names (`--consensus lowest-id`, `--assignment cbaa`). What needs a
station that knows all robots is no rule of an agent: `fly_rival` flies it, as a program. `RIVALS` has both.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, TypeAlias

import msgspec
import numpy as np
from scipy.optimize import linear_sum_assignment

import llm_flock
from llm_flock import metrics
from llm_flock.arrays import Pairwise, between
from llm_flock.errors import InputError, unknown
from llm_flock.message import Message, Provenance, encode
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol import (
    AssignmentInput,
    AuctionAssignment,
    Claim,
    PlanKey,
    ProvenanceConsensus,
    geometric_plan,
    plan_key,
    straight_path,
)
from llm_flock.runtime import RunResult, Trial

# Which plan: the proposer's rank decides, where the project's rule takes its influence.


def _by_proposer(rank: Callable[[Plan, Provenance], int], plan: Plan, origin: Provenance, plan_class: int) -> PlanKey:
    ranked = msgspec.structs.replace(origin, degree=rank(plan, origin))
    return plan_key(plan, ranked, plan_class)


def _drawn(plan: Plan, origin: Provenance) -> int:
    """A number by chance that every robot computes alike, from the plan and its proposer."""
    text = f"{plan.digest} {origin.proposer} {origin.sequence}"
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=4).digest())


def lowest_id() -> ProvenanceConsensus:
    """The plan of the lowest id spreads."""
    order = partial(_by_proposer, lambda _, origin: -origin.proposer)
    return ProvenanceConsensus(name="lowest-id", order=order)


def highest_id() -> ProvenanceConsensus:
    """Leader election by FloodMax: the highest id spreads, here together with the leader's plan."""
    return ProvenanceConsensus(name="highest-id", order=partial(_by_proposer, lambda _, origin: origin.proposer))


def random_priority() -> ProvenanceConsensus:
    """The plan with the highest number by chance spreads."""
    return ProvenanceConsensus(name="random-priority", order=partial(_by_proposer, _drawn))


# Which place.


def consensus_based_auction() -> AuctionAssignment:
    """CBAA as published: bids, and nothing else. Robots that hear nothing of each other may share a place till they do.

    On a connected graph whose links stay, places are distinct after at most N * D communication rounds, of N robots
    and a graph D hops across.
    """
    return AuctionAssignment(name="cbaa", swaps=False, joint=False, team=False)


@dataclass(frozen=True, slots=True)
class DecentralizedCapt(AuctionAssignment):
    """D-CAPT: two that hear each other exchange places whenever that lowers the sum of their squared distances.

    At first each has the place with its own number. As for the auction, an exchange takes two communication rounds, and
    has to gain 0.01 squared spacings.
    """

    name: str = "d-capt"
    joint: bool = False
    team: bool = False

    def take(self, now: AssignmentInput) -> Claim:
        """The place with the robot's id; None for robots beyond the places."""
        size = len(now.plan)
        slot = now.robot if now.robot < size else None
        return Claim(slot=slot, table=tuple((1, 0.0, owner) for owner in range(size)), bids=(0.0,) * size)

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """The place after the exchanges of a communication round."""
        return AuctionAssignment.update(self, claim, msgspec.structs.replace(now, straight=True))


@dataclass(frozen=True, slots=True)
class LeaderAssignment(AuctionAssignment):
    """The robot whose plan is in force assigns all whose positions have reached it, for the smallest sum of squares.

    Its table spreads as a whole. Robots that it does not know of bid.
    """

    name: str = "by-leader"
    swaps: bool = False

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """The place in the leader's table, or else the auction's."""
        leads = now.origin is not None and now.origin.proposer == now.robot
        return AuctionAssignment.update(self, claim, now if leads else msgspec.structs.replace(now, positions=None))


# Programs with a station.

Assign: TypeAlias = Callable[[Pairwise], list[int]]
"""The place of each robot from the lengths of the ways, shape (n, n) [units]."""


def smallest_sum_of_squares(ways: Pairwise) -> list[int]:
    """The assignment with the smallest sum of squared ways."""
    return linear_sum_assignment(ways**2)[1].tolist()


def smallest_longest_way(ways: Pairwise) -> list[int]:
    """The assignment with the shortest longest way (bottleneck), and of these the smallest sum of squares."""
    longest = metrics.bottleneck_distance(ways, ways, lambda lengths, _: lengths)
    too_long = 1.0 + len(ways) * longest**2
    return linear_sum_assignment(np.where(ways <= longest, ways**2, too_long))[1].tolist()


def own_number(ways: Pairwise) -> list[int]:
    """The place with the robot's own number."""
    return list(range(len(ways)))


class Station(Planner):
    """Answers for all robots: gives each a place in one plan, and flies it straight there.

    Args:
        trial: where it sees all positions, before the first round.
        assign: the places of the robots.
        in_time: all arrive at the same time, as late as the one with the longest way at full speed.
    """

    model: Planner | None = None
    """Who is asked for the plan, once; without, the plan is the ideal shape in its reference orientation."""

    def __init__(self, trial: Trial, assign: Assign, *, in_time: bool = False) -> None:
        self._trial, self._assign, self._in_time = trial, assign, in_time
        self._one_at_a_time = asyncio.Lock()
        self._told: tuple[Plan, list[int]] | None = None
        self._arrival = 0.0  # end of the flight [rounds]

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """The plan, with the place that the station chose for this robot."""
        async with self._one_at_a_time:
            if self._told is None:
                answer = geometric_plan(question) if self.model is None else await self.model.plan(question)
                if isinstance(answer, NoAnswer):
                    return answer
                ways = question.mission.shortest_ways(self._trial.bodies.positions, answer.plan.array)
                slots = self._assign(ways)
                longest = max(float(ways[robot, slot]) for robot, slot in enumerate(slots))
                self._arrival = question.round - 1 + longest / question.mission.max_step
                self._told = answer.plan, slots
        plan, slots = self._told
        return PlanAnswer(plan=plan, slot=slots[question.robot])

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Straight to the place of the robot: at full speed, or in time."""
        if not self._in_time:
            return straight_path(question)
        left = self._arrival - (question.round - 1)
        far = math.dist(question.position, question.goal)
        share = min(1.0 / max(left, 1.0), question.mission.max_step / far if far else 1.0)
        return StepAnswer(waypoint=between(question.position, question.goal, share))


@dataclass(frozen=True, slots=True)
class _AskedForSteps(Planner):
    """The plan of the station, and the steps of the one model that it asks."""

    station: Planner
    asks: Planner

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        return await self.station.plan(question)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        return await self.asks.step(question)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rival:
    """A rival: its source, what it assumes beyond a robot's own sensors and radio, and how it is flown."""

    source: str
    assumes: str
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])  #: Fields of the configuration.
    assign: Assign | None = None  #: How a station, or a table on board, gives places; None for a team without.
    in_time: bool = False  #: Whether all arrive at the same time.
    #: What the station asks its one model: nothing, for the plan once, or for every step too.
    asks: Literal["nothing", "plan", "steps"] = "nothing"
    link: Literal["radio", "station", "none"] = "radio"  #: The way of its messages.
    all_hear_all: bool = False  #: Whether the radio reaches across the arena.

    def traffic(self, result: RunResult) -> tuple[float, float]:
        """Messages and bytes for each robot. With a station, a position up, and plan and place down.

        A station that asks for steps needs a message up and one down in every round.
        """
        summary, n = result.summary, result.mission.n_robots
        if self.link == "radio":
            return summary.messages_sent / n, summary.bytes_per_robot_round * summary.rounds
        if self.link == "none":
            return 0.0, 0.0
        place: tuple[float, ...] = tuple(result.positions[0, 0].round(2).tolist())
        up = len(encode(Message(sender=0, sequence=0, degree=0, positions={0: (0, place, ())})))
        origin = Provenance(mission=0, mission_digest=result.mission.digest, epoch=0, degree=0, proposer=0, sequence=0)
        down = len(encode(Message(sender=0, sequence=0, degree=0, plan=result.plans[0], provenance=origin, slot=0)))
        rounds = summary.rounds if self.asks == "steps" else 1
        return 2.0 * rounds, down + rounds * up + (rounds - 1) * up


_GIVEN: Mapping[str, Any] = {"protocol": "baseline", "model": "geometry"}
_ONE_MODEL: Mapping[str, Any] = {"protocol": "baseline", "model": "simulated:ideal", "observe": "all"}
_ALL_KNOWN = "a station that knows all positions at the start and reaches all robots"
_SHAPE = "all robots know the shape as a formula, and which place is whose"
_CAPT = (
    "Turpin, Michael and Kumar: CAPT: Concurrent assignment and planning of trajectories for multiple robots. "
    "International Journal of Robotics Research 33(1), 2014"
)
_CBAA = (
    "Choi, Brunet and How: Consensus-based decentralized auctions for robust task allocation. "
    "IEEE Transactions on Robotics 25(4), 2009"
)
_D_CAPT: Mapping[str, Any] = {**_GIVEN, "assignment": "d-capt", "comm_rounds": 5}
_AUCTION: Mapping[str, Any] = {**_GIVEN, "assignment": "cbaa", "comm_rounds": 5}
_CHECKS = "all robots know the shape as a formula, to check plans, as those of `flock` do"
_LYNCH = "Lynch: Distributed Algorithms. Morgan Kaufmann, 1996 (FloodMax)"

RIVALS: Mapping[str, Rival] = {
    "fixed formula": Rival(
        source="none: a table on board",
        assumes=_SHAPE,
        options=_GIVEN,
        assign=own_number,
        link="none",
    ),
    "one central planner": Rival(
        source="Chen, Arkin, Zhang, Roy and Fan: Scalable multi-robot collaboration with large language models: "
        "Centralized or decentralized systems? ICRA 2024",
        assumes=_ALL_KNOWN,
        options=_ONE_MODEL,
        assign=smallest_longest_way,
        asks="plan",
        link="station",
    ),
    "one central planner, every step": Rival(
        source="the same",
        assumes="a station that knows all positions in every round and reaches all robots",
        options=_ONE_MODEL,
        assign=smallest_longest_way,
        asks="steps",
        link="station",
    ),
    "central, sum of squares": Rival(
        source="Kuhn: The Hungarian method for the assignment problem. Naval Research Logistics Quarterly 2, 1955",
        assumes=_ALL_KNOWN,
        options=_GIVEN,
        assign=smallest_sum_of_squares,
        link="station",
    ),
    "central, bottleneck": Rival(
        source="Burkard, Dell'Amico and Martello: Assignment Problems. SIAM, 2009 (threshold algorithm)",
        assumes=_ALL_KNOWN,
        options=_GIVEN,
        assign=smallest_longest_way,
        link="station",
    ),
    "CAPT": Rival(
        source=_CAPT,
        assumes=f"{_ALL_KNOWN}; a common clock",
        options=_GIVEN,
        assign=smallest_sum_of_squares,
        in_time=True,
        link="station",
    ),
    "D-CAPT": Rival(
        source=_CAPT,
        assumes=f"{_SHAPE} at first; a common clock and time of arrival",
        options=_D_CAPT,
        assign=own_number,
        in_time=True,
    ),
    "D-CAPT, all hear all": Rival(
        source="the same",
        assumes=f"{_SHAPE} at first; a common clock and time of arrival; a radio that reaches across the arena",
        options=_D_CAPT,
        assign=own_number,
        in_time=True,
        all_hear_all=True,
    ),
    "D-CAPT, full speed": Rival(
        source="the same, without its common time of arrival, which its proof needs",
        assumes=f"{_SHAPE} at first",
        options=_D_CAPT,
        assign=own_number,
    ),
    "CBAA": Rival(source=_CBAA, assumes="all robots know the shape as a formula", options=_AUCTION, assign=own_number),
    "CBAA, all hear all": Rival(
        source="the same",
        assumes="all robots know the shape as a formula; a radio that reaches across the arena",
        options=_AUCTION,
        assign=own_number,
        all_hear_all=True,
    ),
    "leader election": Rival(
        source=f"{_LYNCH}; Garcia-Molina: Elections in a distributed computing system. IEEE Transactions on Computers "
        "C-31(1), 1982",
        assumes=_CHECKS,
        options={"consensus": "highest-id", "assignment": "by-leader"},
    ),
    "lowest id": Rival(source=_LYNCH, assumes=_CHECKS, options={"consensus": "lowest-id"}),
    "random priority": Rival(
        source="Itai and Rodeh: Symmetry breaking in distributed networks. Information and Computation 88(1), 1990",
        assumes=_CHECKS,
        options={"consensus": "random-priority"},
    ),
    "leader, one table": Rival(
        source="the paper's authors: github.com/Zhourobotics/LLM-Flock, without its collision check",
        assumes="broadcasts reach all from robot to robot; one table of the whole team",
        options={"protocol": "released", "collision_check": "none"},
    ),
}
"""The rivals by name. Those with `consensus` are the project's own rules but for that one, with *simulated* models."""


def fly_rival(name: str, mission: Mission, *, seed: int, shield: bool, trace: bool = False) -> RunResult:
    """Fly a mission as a rival of the project would, with or without the project's shield, from separated starts.

    The messages that the summary counts are the radio's; `Rival.traffic` has those that the rival needs.

    Raises:
        InputError: there is no such rival, or the mission does not suit it.
    """
    if name not in RIVALS:
        raise InputError("name", name, says=unknown("rival", name, RIVALS))
    rival = RIVALS[name]
    if rival.assign is not None and mission.n_places != mission.n_robots:
        raise InputError("places", mission.places, f"one place for each of the {mission.n_robots} robots")
    if rival.assign is not None and mission.velocity is not None:
        raise InputError("velocity", mission.velocity, "a formation that stands still")
    if rival.all_hear_all:
        mission = mission.change(comm_range=math.dist(*mission.arena), sense_range=mission.sensing)

    async def take_over(trial: Trial) -> None:
        if trial.round or rival.assign is None:
            return
        station = Station(trial, rival.assign, in_time=rival.in_time)

        def answers(robot: int, planner: Planner) -> Planner:
            if robot == 0 and rival.asks != "nothing":
                station.model = planner
            return _AskedForSteps(station, planner) if rival.asks == "steps" else station

        trial.planners.wrap(answers)

    return llm_flock.run(mission, seed=seed, shield=shield, trace=trace, steer=take_over, **rival.options)
