"""One agent that a test drives round by round; the messages of the others are given."""

from __future__ import annotations

from collections.abc import Mapping

from rounds import round_began
from tables import told
from whole_agent import whole_agent

from llm_flock.agent import Agent
from llm_flock.arrays import Point
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskPlan,
    AskStep,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Effect,
    Planned,
    Received,
)
from llm_flock.message import BidTable, Message, MissionStamp, PositionReport, Provenance, encode
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, StepAnswer
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus
from llm_flock.protocol._parts import Gaps

LINE = Mission(shape="line", n_robots=3, comm_range=60)
PLAN = Plan.of(LINE.ideal or ())
SILENT = NoAnswer(cause="answer", reason="none")


def make(
    robot: int = 0, mission: Mission = LINE, *, gaps: Gaps = "report", on_event: bool = False, verify: bool = False
) -> Agent:
    return whole_agent(
        robot,
        mission,
        ProvenanceConsensus(),
        AuctionAssignment(),
        shield_on=True,
        verify=verify,
        time_out=2,
        gaps=gaps,
        on_event=on_event,
    )


class DrivenAgent:
    """One agent, round by round; the messages of the others are given."""

    def __init__(self, agent: Agent, here: Point = PLAN.points[0], plan: Plan = PLAN) -> None:
        self.agent, self.here, self.plan = agent, here, plan
        self.number = 0
        self.asked: list[AskPlan] = []

    def begin(self, sensed: Mapping[int, Point] | None = None) -> None:
        self.number += 1
        for effect in self.agent.handle(round_began(self.number, self.here, sensed)):
            if isinstance(effect, AskPlan):
                self.asked.append(effect)
                self.agent.handle(Planned(PlanAnswer(plan=self.plan, slot=0)))

    def comm_round(self, *payloads: bytes) -> list[Effect]:
        self.agent.handle(CommRoundBegan())
        effects = [effect for payload in payloads for effect in self.agent.handle(Received(payload))]
        return [*effects, *self.agent.handle(CommRoundEnded())]

    def end(self, answer: StepAnswer | NoAnswer = SILENT) -> list[Effect]:
        effects = self.agent.handle(AgreementEnded())
        if isinstance(effects[-1], AskStep):
            effects = [*effects, *self.agent.handle(Decided(answer))]
        self.agent.handle(Arrived())
        return effects

    def round(self, *payloads: bytes, sensed: Mapping[int, Point] | None = None) -> list[Effect]:
        self.begin(sensed)
        return [*self.comm_round(*payloads), *self.end()]


def says(
    sender: int,
    beats: tuple[int, ...] | None = None,
    *,
    mission: Mission = LINE,
    counter: int = 0,
    plan: Plan | None = None,
    slot: int | None = None,
    table: BidTable | None = None,
    table_digest: bytes | None = None,
    text: str | None = None,
    named_only: bool = False,
    places: int = 0,
    sequence: int = 0,
    positions: dict[int, PositionReport] | None = None,
    epoch: int = 0,
) -> bytes:
    origin = Provenance(
        mission=counter, mission_digest=mission.digest, epoch=epoch, degree=0, proposer=sender, sequence=0
    )
    said = Message(
        sender=sender,
        sequence=sequence,
        degree=0,
        stamp=MissionStamp(counter, mission.digest),
        mission_text=text,
        plan=None if named_only else plan,
        plan_digest=None if plan is None else plan.digest,
        places=places or (0 if plan is None else len(plan)),
        provenance=None if plan is None else origin,
        slot=slot,
        beats=beats,
        positions=positions,
        **told(table, table_digest),
    )
    return encode(said)
