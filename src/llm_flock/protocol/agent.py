"""One robot's decision process: a state machine that takes events and returns effects.

It knows itself and what events told it; there is no clock, no network and no model in here. Every runtime, in one
process or one process a robot, drives this same machine. The table of legal events is in `llm_flock.protocol.events`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import assert_never

from llm_flock.arrays import Point
from llm_flock.errors import MessageError
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.protocol.assignment import AssignmentRule, Claim, Moment
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
    MissionGiven,
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
from llm_flock.protocol.judge import Judge, fallback_notes
from llm_flock.protocol.messages import Message, Pedigree, decode, encode
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.safety import Safety
from llm_flock.protocol.search import Search, advance


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
        verify: check every plan before it is followed, and every step before it is flown.
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
        verify: bool = False,
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
        self._judge = Judge(mission, verify=verify, shield_on=shield_on)
        self._question: StepQuestion | None = None
        self._no_plan: NoAnswer | None = None
        self._proposals = 0
        self._own_slot: int | None = None
        self._round = 0
        self.position: Point = ()
        self._sensed: Mapping[int, Point] = {}
        self._observed: tuple[Point, ...] = ()
        self._search = Search()
        self._inbox: dict[int, Message] = {}
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
            case MissionGiven():
                self.mission, self.plan, self.pedigree = event.mission, None, None
                self.claim = Claim(slot=None)
                phase, effects = self.phase, []
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
        self.neighbors = event.neighbors
        if self.plan is not None:
            return Phase.NEGOTIATING, []
        question = PlanQuestion(
            mission=self.mission,
            robot=self.robot,
            round=event.round,
            position=event.position,
            neighbors=event.observed,
        )
        return Phase.PLANNING, [AskPlan(question)]

    def _take_plan(self, answer: PlanAnswer | NoAnswer) -> list[Effect]:
        """A proposal of one's own: it gets the influence of this moment as its pedigree."""
        answer = self._judge.plan(answer)
        if isinstance(answer, NoAnswer):
            self._no_plan = answer if self._judge.verify else None
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
        proposed = Note("proposed", {"plan": answer.plan.digest, "slot": self.claim.slot})
        return [*fallback_notes("plan", "geometry", answer.instead_of), proposed]

    def _follow(self, plan: Plan, origin: Pedigree, *, adopted: bool, heard: list[Message]) -> None:
        self.plan, self.pedigree = plan, origin
        self.claim = self._assignment.take(self._moment(adopted=adopted, heard=heard))

    def _moment(self, *, adopted: bool, heard: list[Message]) -> Moment:
        """What the assignment rule may know."""
        assert self.plan is not None
        return Moment(
            robot=self.robot,
            position=self.position,
            plan=self.plan,
            spacing=self.mission.spacing,
            chosen=self._own_slot,
            adopted=adopted,
            heard=[m for m in heard if m.plan == self.plan],
            sensed=self._sensed,
        )

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
            or said.offer is not self.claim.offer
        ):
            self._said = Message(
                sender=self.robot,
                sequence=0 if said is None else said.sequence + 1,
                neighbors=self.neighbors,
                plan=self.plan,
                pedigree=self.pedigree,
                slot=self.claim.slot,
                table=self.claim.table,
                offer=self.claim.offer,
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
        objection = self._judge.objection(message.plan)
        if objection is not None and message.plan is not None:
            self.rejected["unverified_plan"] += 1
            detail = {"reason": "unverified_plan", "detail": objection}
            return [Note("rejected_message", detail)] if self._judge.is_new(message.plan) else []
        known = self._inbox.get(message.sender)
        if known is None or message.sequence >= known.sequence:
            self._inbox[message.sender] = replace(message, plan_class=self._judge.plan_class(message.plan))
        return []

    def _settle_tick(self) -> list[Effect]:
        """Consensus first, then the claim, both on the same snapshot of what was heard."""
        heard = [self._inbox[sender] for sender in sorted(self._inbox)]
        self._inbox = {}
        own = Standing(
            plan=self.plan,
            pedigree=self.pedigree,
            neighbors=self.neighbors,
            plan_class=self._judge.plan_class(self.plan),
        )
        slot_before = self.claim.slot
        source = self._consensus.choose(own, heard)
        effects = [] if source is None else self._adopt(source, heard)
        if not effects and self.plan is not None:
            self.claim = self._assignment.update(self.claim, self._moment(adopted=True, heard=heard))
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
        notes = fallback_notes("plan", "neighbour", self._no_plan if self.plan is None else None)
        self._follow(plan, origin, adopted=True, heard=heard)
        return [*notes, Note("adopted", {"plan": plan.digest, "from": source.sender})]

    def _ask_step(self) -> tuple[Phase, list[Effect]]:
        if self.plan is None or self.claim.slot is None:
            reason = "no plan yet" if self.plan is None else "every slot is claimed by others"
            return Phase.MOVING, self._hold("no_goal", reason)
        effects = self._look_for_others(self.plan, self.claim.slot)
        question = StepQuestion(
            mission=self.mission,
            robot=self.robot,
            round=self._round,
            position=self.position,
            neighbors=self._observed,
            plan=self.plan,
            slot=self.claim.slot,
            target=self._search.target,
        )
        self._question = question
        return Phase.DECIDING, [*effects, AskStep(question)]

    def _look_for_others(self, plan: Plan, slot: int) -> list[Effect]:
        """Begin, continue or end the search for robots that hold the slots known as vacant."""
        if self.claim.table is None:
            return []
        before = self._search
        spacing = self.mission.spacing
        self._search = advance(
            before,
            position=self.position,
            plan=plan,
            slot=slot,
            table=self.claim.table,
            center=self.mission.center,
            spacing=spacing,
            at_goal=math.dist(self.position, plan.points[slot]) <= AT_GOAL * spacing,
        )
        if bool(before.way) == bool(self._search.way):
            return []
        return [Note("search", {"begun": bool(self._search.way), "vacant": list(self._search.known[1])})]

    def _move(self, answer: StepAnswer | NoAnswer) -> list[Effect]:
        question = self._question
        assert question is not None, "only a robot that asked is answered"
        fit = self._judge.waypoint(question, answer)
        asked = answer.waypoint
        if isinstance(fit, NoAnswer):
            return self._hold(fit.cause, fit.reason, asked)
        failure = answer.instead_of if isinstance(answer, StepAnswer) else None
        notes = fallback_notes("step", "geometry", failure)
        flown, origin = fit, Origin.MODEL
        if self._safety is not None:
            flight = self._safety.step(self.position, self._sensed, fit, question.goal)
            flown, origin = flight.waypoint, flight.origin
            notes.extend(flight.notes)
        if origin is Origin.MODEL and flown != asked:  # clipped to the goal or to the step limit
            notes.append(Note("shielded", {"proposed": asked, "flown": flown}))
            origin = Origin.SHIELD
        if failure is not None and origin is not Origin.DETOUR:
            origin = Origin.FALLBACK
        return [*notes, MoveTo(waypoint=flown, proposed=asked, origin=origin)]

    def _hold(self, cause: str, reason: str, asked: Point | None = None) -> list[Effect]:
        """Nothing to do, and why."""
        held = Note("held", {"cause": cause, "reason": reason})
        if self._safety is None:
            return [held, MoveTo(waypoint=self.position, proposed=asked, origin=Origin.HOLD)]
        flight = self._safety.stay(self.position, self._sensed)
        return [held, *flight.notes, MoveTo(waypoint=flight.waypoint, proposed=asked, origin=flight.origin)]
