"""One agent of a triangle of three, event by event, for tests of its state machine."""

from __future__ import annotations

from rounds import round_began
from whole_agent import whole_agent

from llm_flock.agent import Agent
from llm_flock.events import Effect, Note, Planned, RoundBegan
from llm_flock.message import Message, MissionStamp, Provenance, encode
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus

MISSION = Mission(shape="triangle", n_robots=3)
PLAN = Plan.of([[50.0, 50.0], [60.0, 50.0], [55.0, 58.66]])
BETTER = Plan.of([[50.0, 45.0], [60.0, 45.0], [55.0, 53.66]])


def make(robot: int = 0, *, shield_on: bool = True) -> Agent:
    return whole_agent(robot, MISSION, ProvenanceConsensus(), AuctionAssignment(), shield_on=shield_on)


def began(round_number: int = 1, **sensed: tuple[float, float]) -> RoundBegan:
    others = {int(name[1:]): x for name, x in sensed.items()}
    return round_began(round_number, (48.0, 50.0), others)


def origin(proposer: int, digest: str = MISSION.digest) -> Provenance:
    return Provenance(mission=0, mission_digest=digest, epoch=0, degree=2, proposer=proposer, sequence=0)


def foreign(
    sender: int, plan: Plan | None, provenance: Provenance | None, sequence: int = 0, mission_text: str | None = None
) -> bytes:
    """A message; one that says a mission claims a stamp that is higher than any and stands for something else."""
    message = Message(
        sender=sender,
        sequence=sequence,
        degree=2,
        plan=plan,
        provenance=provenance,
        stamp=MissionStamp(0 if mission_text is None else 7, "0" * 16),
        mission_text=mission_text,
    )
    return encode(message)


def planned(agent: Agent) -> list[Effect]:
    agent.handle(began())
    return agent.handle(Planned(PlanAnswer(plan=PLAN, slot=1)))


def notes(effects: list[Effect]) -> list[str]:
    return [e.kind for e in effects if isinstance(e, Note)]
