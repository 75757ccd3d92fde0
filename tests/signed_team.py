"""A team of real agents that sign, driven by a test, and a robot with keys that sends anything."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from driven_team import turned
from rounds import round_began
from tables import told
from toy_keys import ToyKeys
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
    MoveTo,
    Note,
    Phase,
    Planned,
    Received,
)
from llm_flock.message import NO_OWNER, UNSAID, BidEntry, Message, MissionStamp, Offer, Provenance, encode
from llm_flock.metrics import segment_separation
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer, StepAnswer
from llm_flock.protocol._parts import Gaps
from llm_flock.runtime._rules import PRESETS, assignment_rule, consensus_rule
from llm_flock_swarm._signed.certificates import (
    Certificate,
    Context,
    Proofs,
    WitnessStatement,
    claim_statement,
    claims_of,
    drawn_bid,
    offer_statement,
    origin_statement,
    word_statement,
    wrap,
)
from llm_flock_swarm._signed.channel import SignedChannel
from llm_flock_swarm._signed.evidence import Evidence

Sends = Callable[[], Sequence[bytes]]


def channel_of(agent: Agent) -> SignedChannel:
    """The signed channel of an agent with keys."""
    channel = agent._messaging.channel
    assert isinstance(channel, SignedChannel)
    return channel


def evidence_of(agent: Agent) -> Evidence:
    """The signatures about claims that an agent with keys holds."""
    return channel_of(agent)._evidence


class SignedTeam:
    """N - 1 honest agents that sign, and robot N - 1, of which there is a body only; `liar_says` speaks for it.

    Args:
        mission: what the team is asked to do.
        positions: of all N bodies [units].
        seed: of losses.
        loss: share of messages lost.
        liars: robots without an agent, the last ones.
        tolerated: number of liars that the honest reckon with.
        gaps: what the honest do about places that no robot can take.
    """

    def __init__(
        self,
        mission: Mission,
        positions: Sequence[Point],
        *,
        seed: int = 0,
        loss: float = 0.0,
        liars: int = 1,
        tolerated: int = 1,
        gaps: Gaps = "report",
    ) -> None:
        rules = PRESETS["flock"]
        self.mission = mission
        self.positions = list(positions)
        self.liar = mission.n_robots - 1
        self.agents = [
            whole_agent(
                robot,
                mission,
                consensus_rule(rules["consensus"]),
                assignment_rule(rules["assignment"]),
                shield_on=True,
                verify=True,
                authenticator=ToyKeys(robot),
                liars=tolerated,
                gaps=gaps,
            )
            for robot in range(mission.n_robots - liars)
        ]
        self.rng = np.random.default_rng(seed)
        self.loss = loss
        self.round = 0
        self.smallest = math.inf
        self.notes: list[Note] = []

    @property
    def slots(self) -> list[int | None]:
        """The place that each honest robot claims."""
        return [agent.claim.slot for agent in self.agents]

    @property
    def context(self) -> Context:
        """What the first robot's claims are about."""
        agent = self.agents[0]
        assert agent.plan is not None
        return Context(agent._agreement.stamp, agent.plan.digest, agent.provenance)

    def owners(self, robot: int) -> tuple[tuple[int, int], ...]:
        """Version and owner of every place, as one robot has them."""
        return tuple((version, owner) for version, _, owner in self.agents[robot].claim.table or ())

    def counts(self, reason: str) -> int:
        """Number of refusals of honest robots for this reason."""
        return sum(agent.rejected[reason] for agent in self.agents)

    def fly(self, rounds: int, liar_says: Sends = tuple, liar_moves: Callable[[], Point] | None = None) -> None:
        """Fly a number of rounds of five communication rounds; the liar sends to all in each of them."""
        for _ in range(rounds):
            self.begin()
            for _ in range(5):
                self.comm_round(liar_says())
            self.end(None if liar_moves is None else liar_moves())

    def begin(self) -> None:
        """A round begins, if none is under way."""
        if self.agents[0].phase is not Phase.IDLE:
            return
        self.round += 1
        self.links = graph.neighbors(self.positions, self.mission.comm_range)
        for i, agent in enumerate(self.agents):
            sensed = {j: self.positions[j] for j in self.links[i]}
            for effect in agent.handle(round_began(self.round, self.positions[i], sensed)):
                if isinstance(effect, AskPlan):
                    agent.handle(Planned(PlanAnswer(plan=turned(effect.question.mission, i + 1)[i], slot=i)))

    def comm_round(
        self,
        lies: Sequence[bytes] = (),
        *,
        said_by: Sequence[tuple[int, bytes, frozenset[int] | None]] = (),
    ) -> list[bytes]:
        """One exchange; returns what the honest said. `said_by` are lies with who tells them, and to whom (or all)."""
        said = [
            effect.payload
            for agent in self.agents
            for effect in agent.handle(CommRoundBegan())
            if isinstance(effect, Broadcast)
        ]
        for i, payload in enumerate(said):
            for j in self.links[i]:
                if j < len(self.agents) and self.rng.random() >= self.loss:
                    self.tell(j, payload, i)
        for lie in lies:
            for j in range(len(self.agents)):
                self.tell(j, lie, self.liar)
        for sender, lie, hears in said_by:
            for j in range(len(self.agents)):
                if hears is None or j in hears:
                    self.tell(j, lie, sender)
        for agent in self.agents:
            self.notes.extend(e for e in agent.handle(CommRoundEnded()) if isinstance(e, Note))
        return said

    def tell(self, robot: int, payload: bytes, sender: int) -> list[str]:
        """Give one robot a payload; returns the reasons for which it was refused."""
        self.begin()
        effects = self.agents[robot].handle(Received(payload, sender))
        notes = [e for e in effects if isinstance(e, Note)]
        self.notes.extend(notes)
        return [note.detail["reason"] for note in notes if note.kind == "rejected_message"]

    def end(self, liar_goes: Point | None = None, *, moves: Mapping[int, Point] | None = None) -> None:
        """All fly, the model's answer being the straight way; bodies without an agent move as told."""
        before, after = np.array(self.positions), list(self.positions)
        for i, agent in enumerate(self.agents):
            effects = agent.handle(AgreementEnded())
            if isinstance(effects[-1], AskStep):
                question = effects[-1].question
                way = np.array(question.goal) - before[i]
                share = min(1.0, self.mission.max_step / max(float(np.linalg.norm(way)), 1e-9))
                effects = agent.handle(Decided(StepAnswer(waypoint=tuple((before[i] + way * share).tolist()))))
            after[i] = next(e for e in effects if isinstance(e, MoveTo)).waypoint
            agent.handle(Arrived())
        if liar_goes is not None:
            after[self.liar] = liar_goes
        for robot, to in (moves or {}).items():
            after[robot] = to
        honest = len(self.agents)
        self.smallest = min(self.smallest, segment_separation(before[:honest], np.array(after)[:honest]))
        self.positions = after

    def settled(self) -> bool:
        """Whether the honest are on distinct places of one plan, and agree about that."""
        tables = {self.owners(robot) for robot in range(len(self.agents))}
        owned = [slot for slot in self.slots if slot is not None]
        return len({a.plan for a in self.agents}) == 1 and len(set(owned)) == len(self.agents) and len(tables) == 1

    def held_by_liar(self) -> int:
        """Most places that any honest robot's table gives to the liar."""
        return max(sum(owner == self.liar for _, _, owner in agent.claim.table or ()) for agent in self.agents)


class Liar:
    """A member that signs anything, but only as itself."""

    def __init__(self, team: SignedTeam, robot: int | None = None) -> None:
        self.team = team
        self.robot = team.liar if robot is None else robot
        self.keys = ToyKeys(self.robot)
        self.number = 0
        self.sequence = 0

    def claim(
        self, slot: int, version: int = 0, bid: float | None = None, number: int | None = None
    ) -> tuple[BidEntry, Certificate]:
        """An entry for itself, with its own signature; the bid is the best that may be."""
        self.number += 1
        if bid is None:
            bid = drawn_bid(self.team.context, slot, version, self.robot) if version else 0.0
        number = self.number if number is None else number
        entry: BidEntry = (version, bid, self.robot)
        signature = self.keys.sign(claim_statement(self.team.context, slot, entry, number))
        agent = self.team.agents[0]
        freed = evidence_of(agent)._page.freed.get((slot, version, -1))
        return entry, Certificate(number=number, signature=signature, grant=freed)

    def word(self, slot: int, version: int, owner: int = -1) -> WitnessStatement:
        """Its word that a place is free."""
        return WitnessStatement(
            self.robot,
            slot,
            version,
            owner,
            self.keys.sign(word_statement(self.team.context, slot, version, owner)),
        )

    def says(
        self,
        entries: dict[int, tuple[BidEntry, Certificate]] | None = None,
        words: Sequence[WitnessStatement] = (),
        offer: Offer | None = None,
        offer_number: int = 1,
        slot: int | None = None,
        **message: Any,
    ) -> bytes:
        """A message, on the team's plan, with these entries and words."""
        agent, context = self.team.agents[0], self.team.context
        assert agent.plan is not None
        table = [UNSAID] * len(agent.plan)
        for a, (entry, _) in (entries or {}).items():
            table[a] = entry
        self.sequence += 1
        said = Message(
            **{
                "sender": self.robot,
                "sequence": self.sequence,
                "degree": self.team.mission.n_robots - 1,
                "plan": agent.plan,
                "provenance": agent.provenance,
                "slot": slot,
                "offer": offer,
                **told(message.pop("table", tuple(table))),
                **message,
            }
        )
        claims, grants = claims_of({a: certificate for a, (_, certificate) in (entries or {}).items()})
        proofs = Proofs(claims=claims, grants=grants, words=tuple(words), origin=self.origin(said))
        if offer is not None:
            statement = offer_statement(context, self.robot, offer, offer_number)
            proofs = Proofs(
                claims=claims, grants=grants, offer=(offer_number, self.keys.sign(statement)), origin=proofs.origin
            )
        return wrap(encode(said), proofs)

    def origin(self, message: Message) -> bytes | None:
        """The true signature of a known origin, or its own."""
        origin, plan = message.provenance, message.plan_digest
        if origin is None or plan is None:
            return None
        known = channel_of(self.team.agents[0])._known_origin(origin, plan)
        return known or self.keys.sign(origin_statement(origin, plan))

    def provenance(self, *, epoch: int = 0, sequence: int = 0, proposer: int | None = None) -> Provenance:
        """An origin of its own with the highest influence."""
        stamp: MissionStamp = self.team.context.mission
        return Provenance(
            mission=stamp.counter,
            mission_digest=stamp.digest,
            epoch=epoch,
            degree=self.team.mission.n_robots - 1,
            proposer=self.robot if proposer is None else proposer,
            sequence=sequence,
        )


def line_up(n: int, gap: float = 7.0) -> list[Point]:
    """Bodies in a row, all in touch with their next."""
    return [(20.0 + gap * k, 50.0) for k in range(n)]


def good_plan(mission: Mission, angle: int) -> Plan:
    """A faultless plan that no robot of the team proposed."""
    return turned(mission, mission.n_robots + angle)[-1]


def free_slot(team: SignedTeam) -> int:
    """The first place without an owner."""
    table = team.agents[0].claim.table
    assert table is not None
    return next(a for a, entry in enumerate(table) if entry[2] == NO_OWNER)
