"""Sending and receiving: a message is composed and sealed, or verified, decoded and applied part by part."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from llm_flock.errors import InputError, MessageError
from llm_flock.events import MissionGiven, Note
from llm_flock.message import Course, Message, MissionStamp, received_mission, time_text
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._messages.channel import Channel, Inbound
from llm_flock.protocol._messages.dissemination import Dissemination
from llm_flock.protocol._parts import Parts

if TYPE_CHECKING:
    from llm_flock.protocol._agreement.judgement import Judgement

MAX_REPEATED = 256  # decoded payloads of a round that are kept, as neighbours repeat themselves
MAX_BAD_PLANS = 8  # plans of one sender that may fail verification in a round; then no more are verified
MAX_DRAWN = 16  # likewise, new programs that are drawn, each counted once and once more for each PLACES_DRAWN places
PLACES_DRAWN = 60
COURSE_ROUNDS = 2  # rounds for which a course counts after its sender was last heard, as messages get lost
MAX_CHECKED_PLANS = 1024  # that are remembered, so that a flood of plans costs bounded memory


class Messaging:
    """One robot's side of the radio."""

    def __init__(self, robot: int, agreement: Agreement, parts: Parts, judgement: Judgement | None = None) -> None:
        self._judgement = judgement
        self._robot, self._agreement = robot, agreement
        self.channel = Channel(robot, agreement.mission) if parts.channel is None else parts.channel
        self._membership, self._verifier = parts.membership, parts.verifier
        self.courses: dict[int, Course] = {}  # ways that others ask to be left free, by sender
        self._heard_ago: dict[int, int] = {}
        self._dissemination = Dissemination()
        self._newest: dict[int, Message] = {}
        self._beats: list[NDArray[np.int64]] = []
        self._rejected: Counter[str] = Counter()
        self._checked: dict[str, Plan | None] = {}  # plans for this mission, by digest; None for rejected ones
        self._bad_plans, self._drawn = Counter[int](), Counter[int]()
        self._repeated: dict[bytes, Message] = {}

    @property
    def rejected(self) -> Counter[str]:
        """Number of messages and claims rejected so far, by reason."""
        return self._rejected + self.channel.rejected

    def begin_round(self) -> None:
        """Begin a round, in which neighbours may have changed. Forget courses of senders not heard lately."""
        self._dissemination.begin_round()
        self._bad_plans.clear()
        self._drawn.clear()
        self._repeated.clear()
        self._heard_ago = {j: ago + 1 for j, ago in self._heard_ago.items()}
        for j in [j for j, ago in self._heard_ago.items() if ago > COURSE_ROUNDS]:
            del self._heard_ago[j], self.courses[j]

    def broadcast(self, course: Course | None = None) -> bytes:
        """This robot's knowledge as bytes, with the way it asks for. Call once in each communication round."""
        agreement, claim = self._agreement, self._agreement.claim
        positions = self._membership.report(agreement, greeting=self._dissemination.greets)
        whole = Message(
            sender=self._robot,
            sequence=0,
            degree=agreement.degree,
            stamp=agreement.stamp,
            plan=agreement.plan,
            provenance=agreement.provenance,
            slot=claim.slot,
            table_digest=self._dissemination.digest(claim.table),
            offer=claim.offer,
            course=course,
            beats=self._membership.beats or None if self._dissemination.greets else None,
            positions=positions,
            proposals=agreement.ballot and agreement.ballot.pass_on(),
            votes=self._judgement and self._judgement.votes.pass_on(),
        )
        return self.channel.seal(self._dissemination.compose(whole, claim.table, agreement.mission))

    def receive(self, payload: bytes, sender: int | None = None) -> list[Note]:
        """Verify and decode a payload, then apply its mission, its heartbeats, its positions, its plan and claim."""
        repeated = self._repeated.get(payload)
        if repeated is not None:
            self._keep(repeated)
            return []
        try:
            inbound = self.channel.open(payload, sender)
            notes = self._apply_mission(inbound)
        except MessageError as error:
            return [self._reject(error)]
        message = inbound.message
        if inbound.beats is not None:
            self._beats.append(inbound.beats)
        if message.mission != self._agreement.stamp:
            self._dissemination.hear(message)
            return notes
        if message.positions is not None:
            self._membership.hear_positions(message.positions)
        if self._judgement is not None:
            self._judgement.votes.take(*message.votes or ())
        return [*notes, *self._apply_proposals(message), *self._apply_plan(inbound, payload)]

    def _apply_mission(self, inbound: Inbound) -> list[Note]:
        """Take a mission of higher stamp, if it is spelled out. A MessageError rejects the whole message."""
        message, agreement = inbound.message, self._agreement
        if message.mission <= agreement.stamp or message.mission_text is None:
            return []
        # Check the signature first: reading a mission takes many times as long.
        self.channel.check_mission(message.mission, inbound.authorization)
        mission = received_mission(message, agreement.mission)
        self.channel.keep_order(inbound.authorization)
        return [self._begin_mission(mission, message.mission)]

    def _apply_plan(self, inbound: Inbound, payload: bytes) -> list[Note]:
        """Keep a message with its plan for the next decision, unless the plan fails verification."""
        message, sent = inbound.message, inbound.message.plan
        if sent is not None and self._exhausted(message.sender, sent):
            detail = f"robot {message.sender} sends one bad plan after another, or too many new programs in a round"
            return [self._reject(MessageError("many_plans", detail))]
        if sent is not None:
            sent, notes = self._check_plan(message.sender, sent)
            if sent is None:
                self._dissemination.hear(message)
                return notes
        plan = self._dissemination.resolve_plan(message, sent, self._agreement.plan)
        if plan is not None:
            message = inbound.resolve(plan, self._verifier.plan_class(self._agreement.mission, plan))
            if inbound.repeatable and len(self._repeated) < MAX_REPEATED:
                self._repeated[payload] = message
        self._keep(message)
        return []

    def _apply_proposals(self, message: Message) -> list[Note]:
        """Take note of the proposals that the sender passes on, except plans that fail verification."""
        agreement, notes = self._agreement, list[Note]()
        for proposal in (message.proposals or ()) if agreement.ballot is not None else ():
            if proposal.provenance.stamp != agreement.stamp or self._exhausted(message.sender, proposal.plan):
                continue  # it comes again in later rounds
            plan, said = self._check_plan(message.sender, proposal.plan)
            notes += said
            if plan is not None:
                agreement.learn(proposal.provenance, plan)
        return notes

    def _exhausted(self, sender: int, plan: Plan) -> bool:
        """Whether a sender has used up its share of the round, so that its plan is not checked."""
        known = plan.drawing is None or plan.digest in self._checked
        return self._bad_plans[sender] >= MAX_BAD_PLANS or (not known and self._drawn[sender] >= MAX_DRAWN)

    def _check_plan(self, sender: int, plan: Plan) -> tuple[Plan | None, list[Note]]:
        """The plan, which is for this mission, if it counts; or None with notes. Each is checked, and drawn, once."""
        new, objection = plan.digest not in self._checked, None
        if new:
            self._drawn[sender] += 0 if plan.drawing is None else 1 + len(plan) // PLACES_DRAWN
            objection = self._objection(plan)
            if len(self._checked) >= MAX_CHECKED_PLANS:
                self._checked.clear()
            self._checked[plan.digest] = plan if objection is None else None
        known = self._checked[plan.digest]
        if known is not None:
            return known, []
        self._bad_plans[sender] += 1
        note = self._reject(MessageError("unverified_plan", objection or ""))
        return None, [note] if new else []

    def _objection(self, plan: Plan) -> str | None:
        """The reason to reject a plan, which is drawn if its size is right; None if it can be followed."""
        try:
            objection = self._verifier.objection(self._agreement.mission, plan)
            _ = objection or plan.points
        except InputError as error:
            return f"a plan that cannot be drawn: {error}"
        return objection

    def _keep(self, message: Message) -> None:
        self._dissemination.hear(message)
        known = self._newest.get(message.sender)
        if known is None or message.sequence >= known.sequence:
            self._newest[message.sender] = message

    def _reject(self, error: MessageError) -> Note:
        self._rejected[error.reason] += 1
        return Note("rejected_message", {"reason": error.reason, "detail": error.detail})

    def give_mission(self, order: MissionGiven) -> Note:
        """Take a mission that the operator gives to this robot, unless a later order is known already."""
        current, signed = self._agreement.stamp, order.authorization
        stamp = MissionStamp(order.ordered_at if signed is None else signed.counter, order.mission.digest)
        try:
            if stamp <= current:  # first: an older signature must not replace that of the mission in force
                later = f"an order of {time_text(current.counter)} is in force, this one is of"
                raise MessageError("old_mission", f"{later} {time_text(stamp.counter)}")
            self.channel.check_mission(stamp, signed)
        except MessageError as error:
            return self._reject(error)
        self.channel.keep_order(signed)
        return self._begin_mission(order.mission, stamp)

    def _begin_mission(self, mission: Mission, stamp: MissionStamp) -> Note:
        self._newest.clear()
        self._repeated.clear()
        self._checked.clear()
        self._dissemination.forget_plans()
        return self._agreement.begin_mission(mission, stamp)

    def drain(self) -> list[Message]:
        """The newest message of each sender, in ascending order. Call once before a decision: it counts heartbeats."""
        heard = self.channel.hold([self._newest[sender] for sender in sorted(self._newest)])
        self._membership.hear_beats(self._beats)
        for message in heard:
            self._heard_ago.pop(message.sender, None)
            self.courses.pop(message.sender, None)
            if message.course is not None:
                self.courses[message.sender], self._heard_ago[message.sender] = message.course, 0
        self._newest, self._beats = {}, []
        return heard
