"""One robot's decision process: a state machine that takes events and returns effects.

It knows itself and what events told it; there is no clock, no network and no model in here. Every runtime, in one
process or one process a robot, drives this same machine. The table of legal events is in `llm_flock.protocol.events`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import assert_never

from llm_flock.arrays import Point
from llm_flock.errors import MessageError
from llm_flock.mission import Mission
from llm_flock.protocol.assignment import AssignmentRule, Claim, Start
from llm_flock.protocol.consensus import ConsensusRule, Standing
from llm_flock.protocol.events import (
    TRANSITIONS,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    Decided,
    Effect,
    Event,
    MoveTo,
    NegotiationEnded,
    Note,
    Origin,
    Phase,
    Planned,
    Received,
    RoundBegan,
    Stopped,
    TickBegan,
    TickEnded,
)
from llm_flock.protocol.messages import Message, Pedigree, decode, encode
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.safety import Safety


class IllegalEvent(AssertionError):
    """The runtime sent an event that the machine does not take in its present phase."""


class Agent:
    """One robot's mind.

    Args:
        robot: own id, 0 .. N-1.
        mission: what the team is asked to do.
        consensus: rule that chooses the plan.
        assignment: rule that chooses the slot.
        shield_on: project every waypoint on the buffered Voronoi cell, and go round what blocks the way.
        noise_bound: largest error of a believed position [units].
    """

    def __init__(
        self,
        robot: int,
        mission: Mission,
        consensus: ConsensusRule,
        assignment: AssignmentRule,
        *,
        shield_on: bool,
        noise_bound: float = 0.0,
    ) -> None:
        self.robot = robot
        self.mission = mission
        self.phase = Phase.IDLE
        self.plan: Plan | None = None
        self.pedigree: Pedigree | None = None
        self.claim = Claim(slot=None)
        self.neighbors = 0
        self.rejected: Counter[str] = Counter()
        self._consensus = consensus
        self._assignment = assignment
        self._safety = Safety(robot, mission, noise_bound) if shield_on else None
        self._proposals = 0
        self._own_slot: int | None = None
        self._round = 0
        self.position: Point = ()
        self._sensed: Mapping[int, Point] = {}
        self._observed: tuple[Point, ...] = ()
        self._inbox: dict[int, Message] = {}
        self._latest: dict[int, int] = {}
        self._said: Message | None = None
        self._payload = b""

    @property
    def influence(self) -> float:
        """I_i = |N_i| / N (paper, eq. 1)."""
        return self.neighbors / self.mission.n_robots

    @property
    def goal(self) -> Point | None:
        """Position of the claimed slot [units; world frame]."""
        if self.plan is None or self.claim.slot is None:
            return None
        return self.plan.points[self.claim.slot]

    def handle(self, event: Event) -> list[Effect]:
        """Take one event; return what is to be done about it, in order.

        Raises:
            IllegalEvent: the event is not in TRANSITIONS for the present phase.
        """
        allowed = TRANSITIONS.get((self.phase, type(event)))
        if allowed is None:
            raise IllegalEvent(f"{type(event).__name__} in phase {self.phase}")
        match event:
            case Received():
                phase, effects = self.phase, self._receive(event.payload)
            case TickBegan():
                phase, effects = self.phase, self._broadcast()
            case TickEnded():
                phase, effects = self.phase, self._settle_tick()
            case RoundBegan():
                phase, effects = self._begin(event)
            case Planned():
                phase, effects = Phase.NEGOTIATING, self._take_plan(event.answer)
            case NegotiationEnded():
                phase, effects = self._ask_step()
            case Decided():
                phase, effects = Phase.MOVING, self._move(event.answer)
            case Arrived():
                phase, effects = Phase.IDLE, []
            case Stopped():
                phase, effects = Phase.STOPPED, []
            case _:
                assert_never(event)
        assert phase in allowed, f"{type(event).__name__} led from {self.phase} to {phase}"
        self.phase = phase
        return effects

    def _begin(self, event: RoundBegan) -> tuple[Phase, list[Effect]]:
        self._round = event.round
        self.position = event.position
        self._sensed = event.sensed
        self._observed = event.observed
        reach = self.mission.comm_range
        self.neighbors = sum(math.dist(event.position, x) <= reach for x in event.sensed.values())
        if self.plan is not None:
            return Phase.NEGOTIATING, []
        question = PlanQuestion(robot=self.robot, round=event.round, position=event.position, neighbors=event.observed)
        return Phase.PLANNING, [AskPlan(question)]

    def _take_plan(self, answer: PlanAnswer | NoAnswer) -> list[Effect]:
        """A proposal of one's own: it gets the influence of this moment as its pedigree."""
        if isinstance(answer, NoAnswer):
            return [Note("no_plan", {"cause": answer.cause, "reason": answer.reason})]
        origin = Pedigree(
            mission=0,
            mission_digest=self.mission.digest,
            epoch=0,
            neighbors=self.neighbors,
            proposer=self.robot,
            sequence=self._proposals,
        )
        self._proposals += 1
        self._own_slot = answer.slot
        self._follow(answer.plan, origin, adopted=False, heard=[])
        return [Note("proposed", {"plan": answer.plan.digest, "slot": self.claim.slot})]

    def _follow(self, plan: Plan, origin: Pedigree, *, adopted: bool, heard: list[Message]) -> None:
        self.plan, self.pedigree = plan, origin
        start = Start(
            robot=self.robot,
            position=self.position,
            plan=plan,
            chosen=self._own_slot,
            adopted=adopted,
            heard=[m for m in heard if m.plan == plan],
        )
        self.claim = self._assignment.take(start)

    def _broadcast(self) -> list[Effect]:
        """The own standing; bytes are made anew only when it changed, so that equal content is equal bytes."""
        said = self._said
        if (
            said is None
            or said.neighbors != self.neighbors
            or said.plan is not self.plan
            or said.pedigree is not self.pedigree
            or said.slot != self.claim.slot
            or said.table is not self.claim.table
        ):
            self._said = Message(
                sender=self.robot,
                sequence=0 if said is None else said.sequence + 1,
                neighbors=self.neighbors,
                plan=self.plan,
                pedigree=self.pedigree,
                slot=self.claim.slot,
                table=self.claim.table,
            )
            self._payload = encode(self._said)
        return [Broadcast(self._payload)]

    def _receive(self, payload: bytes) -> list[Effect]:
        """Keep the newest message of each sender for this tick; refuse what is not acceptable, and say so."""
        try:
            message = decode(payload, self.mission.n_robots, self.mission.dim)
            if message.sender == self.robot:
                raise MessageError("own_id", f"a message from outside claims to come from robot {self.robot}")
            if message.pedigree is not None and message.pedigree.mission_digest != self.mission.digest:
                raise MessageError("other_mission", f"a plan for mission {message.pedigree.mission_digest}")
        except MessageError as error:
            self.rejected[error.reason] += 1
            return [Note("rejected_message", {"reason": error.reason, "detail": error.detail})]
        if message.sequence >= self._latest.get(message.sender, -1):
            self._latest[message.sender] = message.sequence
            self._inbox[message.sender] = message
        return []

    def _settle_tick(self) -> list[Effect]:
        """Consensus first, then the claim, both on the same snapshot of what was heard."""
        heard = [self._inbox[sender] for sender in sorted(self._inbox)]
        self._inbox = {}
        own = Standing(plan=self.plan, pedigree=self.pedigree, neighbors=self.neighbors)
        slot_before = self.claim.slot
        source = self._consensus.choose(own, heard)
        effects = [] if source is None else self._adopt(source, heard)
        if not effects and self.plan is not None:
            same = [m for m in heard if m.plan == self.plan]
            self.claim = self._assignment.update(self.robot, self.position, self.plan, self.claim, same)
        if self.claim.slot != slot_before:
            effects.append(Note("claimed", {"slot": self.claim.slot, "before": slot_before}))
        return effects

    def _adopt(self, source: Message, heard: list[Message]) -> list[Effect]:
        """Follow another robot's plan; the same points with another origin leave claim and bids as they are."""
        plan, origin = source.plan, source.pedigree
        assert plan is not None and origin is not None, "a rule may only choose a message with a plan"
        if plan == self.plan:
            self.pedigree = origin
            return []
        self._follow(plan, origin, adopted=True, heard=heard)
        return [Note("adopted", {"plan": plan.digest, "from": source.sender})]

    def _ask_step(self) -> tuple[Phase, list[Effect]]:
        if self.plan is None or self.claim.slot is None:
            reason = "no plan yet" if self.plan is None else "every slot is claimed by others"
            return Phase.MOVING, self._hold("no_goal", reason)
        question = StepQuestion(
            robot=self.robot,
            round=self._round,
            position=self.position,
            neighbors=self._observed,
            plan=self.plan,
            slot=self.claim.slot,
        )
        return Phase.DECIDING, [AskStep(question)]

    def _move(self, answer: StepAnswer | NoAnswer) -> list[Effect]:
        if isinstance(answer, NoAnswer):
            return self._hold(answer.cause, answer.reason)
        wish, goal = answer.waypoint, self.goal
        assert goal is not None, "a step is only asked for with a goal"
        if self._safety is None:
            return [MoveTo(waypoint=wish, proposed=wish, origin=Origin.MODEL)]
        flight = self._safety.step(self.position, self._sensed, wish, goal)
        return [*flight.notes, MoveTo(waypoint=flight.waypoint, proposed=wish, origin=flight.origin)]

    def _hold(self, cause: str, reason: str) -> list[Effect]:
        """Nothing to do, and why."""
        held = Note("held", {"cause": cause, "reason": reason})
        if self._safety is None:
            return [held, MoveTo(waypoint=self.position, proposed=None, origin=Origin.HOLD)]
        flight = self._safety.stay(self.position, self._sensed)
        return [held, *flight.notes, MoveTo(waypoint=flight.waypoint, proposed=None, origin=flight.origin)]
