"""One robot in agreement with the others: which mission, which plan, which place in it, and what it says of all that.

Everything here happens between motion rounds and knows positions only as the sensors gave them. Positions are taken in
the frame of the mission, which travels with its centre: there the places of a plan stand still.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from llm_flock.arrays import Point
from llm_flock.errors import MessageError
from llm_flock.mission import Mission
from llm_flock.protocol.agreement.assignment import AssignmentInput, AssignmentRule, Claim
from llm_flock.protocol.agreement.auction import changed
from llm_flock.protocol.agreement.consensus import ConsensusRule, Standing
from llm_flock.protocol.agreement.precedent import Precedent
from llm_flock.protocol.events import Note
from llm_flock.protocol.membership.all_to_all import AllToAll, given_all_to_all
from llm_flock.protocol.membership.liveness import Liveness
from llm_flock.protocol.membership.occupancy import bodies, observed_occupancy
from llm_flock.protocol.membership.rendezvous import landing
from llm_flock.protocol.membership.replanning import Gaps, Replanning
from llm_flock.protocol.messages.codec import completed, decode, heartbeats
from llm_flock.protocol.messages.dissemination import Dissemination, mission_said
from llm_flock.protocol.messages.inbox import NO_PROOFS, Inbox
from llm_flock.protocol.messages.message import (
    BLOCKED,
    NO_OWNER,
    UNSAID,
    Message,
    MissionStamp,
    PositionReport,
    Provenance,
)
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer
from llm_flock.protocol.signed.certificates import Authenticator, Authorization, Context, Proofs, unwrap
from llm_flock.protocol.signed.signing import Signing
from llm_flock.protocol.verification.validator import Validator, fallback_notes

NOTHING = frozenset[int]()


class Agreement:
    """What one robot follows and claims, and how that changes with what it hears.

    Args:
        robot: own id, 0 .. N-1.
        mission: what the team is asked to do.
        consensus: rule that chooses the plan.
        assignment: rule that chooses the slot.
        validator: says which plans may be followed.
        liveness: who is alive.
        gaps: what to do about places that nobody is alive to take: report them, or have the plan remade.
        authenticator: signs what this robot says and checks what others say; without one nothing is signed.
    """

    def __init__(
        self,
        robot: int,
        mission: Mission,
        consensus: ConsensusRule,
        assignment: AssignmentRule,
        validator: Validator,
        liveness: Liveness,
        *,
        gaps: Gaps,
        authenticator: Authenticator | None = None,
    ) -> None:
        self.mission = mission
        self.stamp = MissionStamp(0, mission.digest)
        self.plan: Plan | None = None
        self.provenance: Provenance | None = None
        self.claim = Claim(slot=None)
        self.neighbors = 0
        self.quiet = False
        """Whether another communication round like the last one would change nothing: it said again what it had said,
        heard again what it had heard, refused nothing, and nothing came of it."""
        self.liveness = liveness
        self._robot = robot
        self._consensus = consensus
        self._assignment = assignment
        self._validator = validator
        self._replanning = Replanning(robot, validator, liveness, gaps)
        self._dissemination = Dissemination()
        self.all_to_all = AllToAll(robot, mission.n_robots if authenticator is None else 0)
        self._signing = None if authenticator is None else Signing(robot, authenticator)
        self.rejected: Counter[str] = Counter() if self._signing is None else self._signing.evidence.refused
        self._inbox = Inbox()
        self._unplaced: set[int] = set()
        self._no_plan: NoAnswer | None = None
        self._proposals = 0
        self._own_slot: int | None = None
        self._position: Point = ()
        self._sensed: Mapping[int, Point] = {}
        self._told_of_bodies = False
        self._survey_due = False
        self._precedent = Precedent()

    def look(self, position: Point, sensed: Mapping[int, Point]) -> None:
        """What the sensors say.

        Args:
            position: own believed position [units; frame of the mission].
            sensed: believed positions of the robots within sensing range, by id [units; frame of the mission].
        """
        self._position, self._sensed = position, sensed

    def begin_round(self, round_number: int, near: frozenset[int], neighbors: int) -> None:
        """A new round, after a look.

        Args:
            round_number: number of the round.
            near: robots that are sensed within radio range.
            neighbors: how many robots the radio counts within range, |N_i|.
        """
        self.neighbors = neighbors
        self._survey_due = True
        self.liveness.begin_round(round_number, near)
        self._dissemination.begin_round(near, neighbors)
        self.all_to_all.begin_round()
        self._unplaced.clear()
        self._inbox.begin_round()

    # ---------------------------------------------------------------- mission

    def take_mission(self, mission: Mission, counter: int) -> Note:
        """Pursue another mission: everything that belonged to the one before is void."""
        self.mission, self.stamp = mission, MissionStamp(counter, mission.digest)
        self._validator.mission = mission
        self.plan = self.provenance = self._no_plan = self._own_slot = None
        self.claim = Claim(slot=None)
        self._inbox.void()
        self._dissemination.forget_plans()
        self._replanning.reset()
        self.all_to_all.begin()
        if self._signing is not None:
            self._proposals = 0  # bounded for each mission
        return Note("mission", {"counter": counter, "digest": mission.digest, "shape": mission.shape})

    def obey(self, mission: Mission, order: Authorization | None) -> Note:
        """A mission that the operator gives to this robot."""
        counter = self.stamp.counter + 1 if order is None else order.counter
        stamp = MissionStamp(counter, mission.digest)
        try:
            if self._signing is not None:
                self._signing.check_order(stamp, order)
            if stamp <= self.stamp:
                raise MessageError("old_mission", f"mission {self.stamp.counter} is in force")
        except MessageError as error:
            return self._reject(error)
        return self.take_mission(mission, counter)

    def _consider(self, message: Message, proofs: Proofs) -> list[Note]:
        """A mission of higher stamp: taken if it is said in full and leaves alone what is this robot's own."""
        if message.mission_text is None:
            return []
        try:
            mission = mission_said(message, self.mission)
            if self._signing is not None:
                order = Authorization(counter=message.mission.counter, signature=proofs.mission or b"")
                self._signing.check_order(message.mission, order)
        except MessageError as error:
            return [self._reject(error)]
        return [self.take_mission(mission, message.mission.counter)]

    # ---------------------------------------------------------------- plan

    @property
    def places(self) -> int | None:
        """How many places the plan should have that this robot is to propose now; None while it need not."""
        return self._replanning.places(self.plan, sees_bodies=bool(self.bodies))

    def watch_team(self, *, may_shrink: bool) -> None:
        """Once a round: does the plan fit the team that is alive?

        Args:
            may_shrink: whether robots that were never heard of may be given up.
        """
        self._told_of_bodies = BLOCKED in [owner for _, _, owner in self.claim.table or ()]
        self._replanning.watch(self.plan, self.claim.table, may_shrink=may_shrink)

    def propose(self, answer: PlanAnswer | NoAnswer) -> list[Note]:
        """A proposal of one's own, in the mission's frame: it gets the influence of this moment as its provenance."""
        if isinstance(answer, NoAnswer):
            self._no_plan = answer if self._validator.verify else None
            return [Note("no_plan", {"cause": answer.cause, "reason": answer.reason})]
        origin = Provenance(
            mission=self.stamp.counter,
            mission_digest=self.stamp.digest,
            epoch=0 if self.provenance is None else self.provenance.epoch + 1,
            neighbors=self.neighbors,
            proposer=self._robot,
            sequence=self._proposals,
        )
        self._proposals += 1
        if self._signing is not None:
            self._signing.propose(origin, answer.plan.digest)
        self._own_slot = answer.slot
        self._follow(answer.plan, origin, adopted=False, heard=[])
        proposed = Note("proposed", {"plan": answer.plan.digest, "slot": self.claim.slot})
        return [*fallback_notes("plan", "geometry", answer.instead_of), proposed]

    def _follow(self, plan: Plan, origin: Provenance, *, adopted: bool, heard: list[Message]) -> None:
        self.plan, self.provenance = plan, origin
        self._replanning.reset()
        if self._signing is not None:
            self.claim = Claim(slot=None)
            self._signing.evidence.turn_to(Context(self.stamp, plan.digest))
        self._claims(self._assignment.take(self._moment(adopted=adopted, heard=heard)))

    def _claims(self, claim: Claim) -> None:
        """Have a claim, and sign what is new in it."""
        if claim != self.claim:
            self.claim = claim
        if self._signing is not None:
            self._signing.evidence.attest(claim)

    def _moment(self, *, adopted: bool, heard: list[Message]) -> AssignmentInput:
        """What the assignment rule may know."""
        assert self.plan is not None
        silent = blocked = clear = NOTHING
        if self._survey_due:  # heartbeats and bodies are news once a round
            silent = self.liveness.silent
            if self.bodies or self._told_of_bodies:
                living = self.liveness.living
                blocked, clear = observed_occupancy(
                    self.mission, self.plan, self._position, self._sensed, self.bodies, living
                )
        silent = silent if heard else NOTHING  # who hears nobody is the one that is lost
        heard = [m for m in heard if m.plan is self.plan or m.plan == self.plan]
        granted, order = None, None
        if self._signing is not None:
            evidence, table = self._signing.evidence, self.claim.table or (UNSAID,) * len(self.plan)
            heard = [evidence.admit(m, self._inbox.proofs[m.sender], table) for m in heard]
            if self._survey_due:
                evidence.survey(table, silent, blocked, clear)
            granted, order = evidence.granted(table), evidence.order
        return AssignmentInput(
            robot=self._robot,
            position=self._position,
            plan=self.plan,
            spacing=self.mission.spacing,
            chosen=self._own_slot,
            adopted=adopted,
            heard=heard,
            sensed=self._sensed,
            silent=silent,
            blocked=blocked,
            clear=clear,
            granted=granted,
            positions=None if self.liveness.silent else self.all_to_all.complete(self.plan),
            order=order,
        )

    @property
    def placed(self) -> bool:
        """Whether a roll call has given places to this robot and all that it has heard in this round."""
        return given_all_to_all(self.claim.table, self.claim.slot) and not self._unplaced

    @property
    def bodies(self) -> tuple[Point, ...]:
        """Bodies in sight without a mind [units; frame of the mission]."""
        return bodies(self.mission, self._sensed, self.liveness.silent)

    def look_at(self, slots: Sequence[int]) -> None:
        """Write in the table that these vacant slots were looked at and nobody was met there."""
        table = self.claim.table
        assert table is not None, "only who knows the claims looks for robots"
        looked = {a: (table[a][0], table[a][1] + 1.0, NO_OWNER) for a in slots if table[a][2] == NO_OWNER}
        self.claim = replace(self.claim, table=changed(table, looked))

    # ---------------------------------------------------------------- messages

    def broadcast(self) -> bytes:
        """The own standing as bytes, which are made anew only when there is something new to say."""
        roll = self._positions_said() if self.all_to_all.called else None
        payload = self._dissemination.again(self.neighbors, self.stamp, self.plan, self.provenance, self.claim)
        self.quiet = payload is not None
        if payload is None or roll is not None:
            payload = self._say_anew(roll)
        if self._signing is None:
            return payload
        return self._signing.say(payload, decode(payload, self.mission.n_robots, self.mission.dim))

    def _positions_said(self) -> dict[int, PositionReport] | None:
        plan = self.plan if self.all_to_all.waiting else None
        return self.all_to_all.say(
            self._position,
            waits_at=None if plan is None else landing(self.mission, plan, self._position),
            greeting=self._dissemination.greets,
            settled=given_all_to_all(self.claim.table, self.claim.slot),
            spacing=self.mission.spacing,
        )

    def _say_anew(self, roll: dict[int, PositionReport] | None) -> bytes:
        whole = Message(
            sender=self._robot,
            sequence=0,
            neighbors=self.neighbors,
            mission=self.stamp,
            plan=self.plan,
            provenance=self.provenance,
            slot=self.claim.slot,
            table=self.claim.table,
            table_digest=self._dissemination.digest(self.claim.table),
            offer=self.claim.offer,
            positions=roll,
        )
        return self._dissemination.say(whole, self.mission, self.liveness)

    def receive(self, payload: bytes, sender: int | None = None) -> list[Note]:
        """Keep the newest message of each sender; refuse what is not acceptable, and say so.

        Args:
            payload: what came in.
            sender: the robot that has signed it, where the transport knows.
        """
        again = self._inbox.again(payload)
        if again is not None:
            self._dissemination.hear(again)
            return []
        team, proofs = (self.mission.n_robots, self.mission.dim), NO_PROOFS
        try:
            if self._signing is not None:
                payload, proofs = unwrap(payload, self.mission.n_robots)
            message = decode(payload, *team)
            if message.sender == self._robot:
                raise MessageError("own_id", f"a message from outside claims to come from robot {self._robot}")
            if self._signing is not None:
                self._signing.vouch(message, proofs, sender)
        except MessageError as error:
            return [self._reject(error)]
        notes = self._consider(message, proofs) if message.mission > self.stamp else []
        if message.mission_text is not None and message.mission > self.stamp:
            return notes  # refused: who pursues such a mission is not of this team
        self._dissemination.hear(message)
        beats = heartbeats(payload, *team)
        if self._signing is not None:
            news = self._signing.beats(message, proofs, self.liveness.beats)
            beats = None if news is None else np.array(news, dtype=np.int64)
        if beats is not None:
            self._inbox.beats.append(beats)
        if message.mission != self.stamp:
            return notes
        if message.positions is not None:
            self.all_to_all.hear(message.positions)
        plan = message.plan
        objection = self._validator.objection(plan)
        if objection is not None and plan is not None:
            refused = self._reject(MessageError("unverified_plan", objection))
            return [*notes, refused] if self._validator.is_new(plan) else notes
        plan = self._dissemination.named(message, self.plan)
        once = self._signing is not None or beats is not None or message.positions is not None
        if plan is not None:
            message = completed(payload, *team, plan, self._validator.plan_class(plan))
        self._inbox.take(message, proofs, None if once or plan is None else payload)
        return notes

    def _reject(self, error: MessageError) -> Note:
        self.quiet = False
        self.rejected[error.reason] += 1
        return Note("rejected_message", {"reason": error.reason, "detail": error.detail})

    def settle(self) -> list[Note]:
        """Decide on what was heard: consensus first, then the claim, both on the same snapshot."""
        heard, beats = self._inbox.drain()
        self.liveness.hear(beats)
        quiet, self.quiet = self.quiet and not beats, False
        grounds = (self.claim, self.plan, self.provenance, self.neighbors, self._position, self._sensed)
        due = self._survey_due or self.all_to_all.called or self._signing
        if not due and self._precedent.decides(grounds, heard, self._dissemination.digest(self.claim.table)):
            self.quiet = quiet and self._precedent.repeated
            return []
        self._precedent.void()
        own_class = self._validator.plan_class(self.plan)
        own = Standing(plan=self.plan, provenance=self.provenance, neighbors=self.neighbors, plan_class=own_class)
        slot_before = self.claim.slot
        source = self._consensus.choose(own, heard)
        notes = [] if source is None else self._adopt(source, heard)
        if not notes and self.plan is not None:
            self._claims(self._assignment.update(self.claim, self._moment(adopted=True, heard=heard)))
        self._survey_due = False
        if self.all_to_all.large:
            self._unplaced -= {m.sender for m in heard}
            self._unplaced |= {m.sender for m in heard if m.plan != self.plan or not given_all_to_all(m.table, m.slot)}
        if self.claim.slot != slot_before:
            notes.append(Note("claimed", {"slot": self.claim.slot, "before": slot_before}))
        if not notes and self.claim is grounds[0] and self.claim.offer is None:
            self._precedent.set(grounds, heard)
        return notes

    def _adopt(self, source: Message, heard: list[Message]) -> list[Note]:
        """Follow another robot's plan; the same points with another origin leave claim and bids as they are."""
        plan, origin = source.plan, source.provenance
        assert plan is not None and origin is not None, "a rule may only choose a message with a plan"
        if plan == self.plan:
            self.provenance = origin
            return []
        notes = fallback_notes("plan", "neighbour", self._no_plan if self.plan is None else None)
        self._follow(plan, origin, adopted=True, heard=heard)
        return [*notes, Note("adopted", {"plan": plan.digest, "from": source.sender})]
