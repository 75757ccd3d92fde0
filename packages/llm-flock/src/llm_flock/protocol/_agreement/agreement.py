"""One robot's part in the agreement: the mission in force, the plan that it follows, and the slot that it claims."""

from __future__ import annotations

import operator
import traceback
from collections.abc import Mapping
from itertools import islice
from typing import TYPE_CHECKING, Literal

from llm_flock.arrays import Point, spread
from llm_flock.errors import MAX_SHOWN, FlockError
from llm_flock.events import Note
from llm_flock.message import BLOCKED, MAX_EPOCHS, Message, MissionStamp, Provenance
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer
from llm_flock.printable import one_line
from llm_flock.protocol._agreement.assignment import AssignmentInput, Claim
from llm_flock.protocol._agreement.consensus import PlanKey, Standing, plan_key
from llm_flock.protocol._breaker import fallback_notes
from llm_flock.protocol._parts import Parts, Situation

if TYPE_CHECKING:
    from llm_flock.protocol._agreement.ballot import Ballot

MAX_EARLIER = 64  # places of earlier missions that are remembered


def new_ballot() -> Ballot:
    """An empty ballot; few rules need one."""
    from llm_flock.protocol._agreement.ballot import Ballot

    return Ballot()


class Agreement(Situation):
    """The decisions of one robot about mission, plan and claim, in the mission's frame, where places stand still."""

    def __init__(self, robot: int, mission: Mission, parts: Parts) -> None:
        super().__init__(mission)
        self.stamp = MissionStamp(0, mission.digest)
        self.provenance: Provenance | None = None
        self.degree = 0
        self._robot = robot
        self._consensus, self._assignment = parts.consensus, parts.assignment
        self._membership, self._verifier = parts.membership, parts.verifier
        #: The proposals of the team, for a rule that compares them all; None for others.
        self.ballot = new_ballot() if getattr(parts.consensus, "ballots", False) else None
        self._refused_answer: NoAnswer | None = None
        self._proposals = 0
        self._last_epoch = -1
        self._followed: dict[int, tuple[Plan, Provenance, Claim]] = {}
        self._remembers = parts.channel is not None  # without keys, no plan turns out void
        self.listens = self.retired = False
        self._void = frozenset[int]()
        self._chosen: int | None = None
        self._knows_blocked = False
        self._occupancy_due = False
        self._settled: tuple[object, ...] = ()

    def sense(self, position: Point, sensed: Mapping[int, Point]) -> None:
        """Take the own believed position and those of sensed robots, by id [units; frame of the mission]."""
        self.position, self.sensed = position, sensed

    def begin_round(self, degree: int) -> None:
        """Begin a round with `degree` neighbours, |N_i|, as the radio counts them. Call after `sense`."""
        self.degree = degree
        self._occupancy_due = True
        self._knows_blocked = BLOCKED in map(operator.itemgetter(2), self.claim.table or ())

    @property
    def bodies(self) -> tuple[Point, ...]:
        """Bodies in sight whose heartbeats have stopped [units; frame of the mission]."""
        return self._membership.still(self)

    def begin_mission(self, mission: Mission, stamp: MissionStamp) -> Note:
        """Begin another mission, which makes the present plan and claim void."""
        if self.mission.velocity is None:
            places = (self.mission.ideal or ()) if self.plan is None else self.plan.points
            known = spread((*places, *self.earlier), 0.5 * mission.comm_range)
            self.earlier = tuple(islice(known, MAX_EARLIER))
        self.mission, self.stamp = mission, stamp
        self.plan = self.provenance = self._refused_answer = self._chosen = None
        self.claim = Claim(slot=None)
        self._proposals, self._last_epoch, self._void, self._followed = 0, -1, frozenset[int](), {}
        self.weights, self.resting, self.retired = {}, (), False
        self.ballot = self.ballot and new_ballot()
        self._membership.begin_mission()
        return Note("mission", {"counter": stamp.counter, "digest": mission.digest, "shape": mission.shape})

    def lack_plan(self, failure: NoAnswer) -> Note:
        self._refused_answer = failure if self._verifier.verify else None
        return Note("no_plan", {"cause": failure.cause, "reason": failure.reason})

    @property
    def owes_proposal(self) -> bool:
        """Whether it follows a plan of an epoch in which all proposals count, and has made none of its own."""
        return self.ballot is not None and self.provenance is not None and self._last_epoch < self.provenance.epoch

    def _epoch(self, places: int) -> int:
        """The epoch of its next proposal: the present one if it owes one of as many places, or else the next."""
        if self.provenance is None or (self.owes_proposal and self.plan is not None and places == len(self.plan)):
            return 0 if self.provenance is None else self.provenance.epoch
        return min(self.provenance.epoch + 1, MAX_EPOCHS)

    def may_propose(self, places: int) -> bool:
        """Whether it may propose a plan of this size: once in an epoch, and in the last one only with more places."""
        if self._robot in self._void or self._epoch(places) <= self._last_epoch:
            return False
        last = self.provenance is not None and self.provenance.epoch == MAX_EPOCHS
        return not last or self.plan is None or places > len(self.plan)

    def propose(self, answer: PlanAnswer, by: Literal["model", "geometry"]) -> list[Note]:
        """Follow an own plan, if it may propose one. The provenance keeps the influence of this moment."""
        if not self.may_propose(len(answer.plan)):
            return []
        origin = Provenance(
            mission=self.stamp.counter,
            mission_digest=self.stamp.digest,
            epoch=self._epoch(len(answer.plan)),
            degree=self.degree,
            proposer=self._robot,
            sequence=self._proposals,
        )
        self._proposals += 1
        self._last_epoch = origin.epoch
        self._chosen = answer.slot
        self.learn(origin, answer.plan)
        self._follow(answer.plan, origin, adopted=False, heard=[])
        return [Note("proposed", {"plan": answer.plan.digest, "slot": self.claim.slot, "by": by})]

    def learn(self, origin: Provenance, plan: Plan) -> None:
        """Take note of a proposal for this mission that passed the checks."""
        if self.ballot is not None:
            self.ballot.take(origin, plan, self._verifier.plan_class(self.mission, plan))

    def _choose(self, own: Standing, heard: list[Message]) -> Message | None:
        """The rule's choice. A rule may be user code: raises FlockError if it fails, or returns another type."""
        rule = f"robot {self._robot}: the consensus rule {self._consensus.name!r}"
        try:
            chosen = self._consensus.choose(own, heard)
        except Exception as error:
            from llm_flock.user_code import describe_exception

            *_, (frame, line) = traceback.walk_tb(error.__traceback__)
            says = f"failed: {describe_exception(error)} ({frame.f_code.co_filename}, line {line})"
            raise FlockError(one_line(f"{rule} {says}")) from error
        if chosen is None or (any(chosen is message for message in heard) and chosen.plan is not None):
            return chosen
        allowed = "None, or one of the messages heard that has a plan"
        raise FlockError(f"{rule} returned {one_line(repr(chosen), MAX_SHOWN)}; expected {allowed}")

    def _adopt(self, source: Message, heard: list[Message]) -> list[Note]:
        """Follow another robot's plan. The same points with another origin leave claim and bids unchanged."""
        plan, origin = source.plan, source.provenance
        assert plan is not None and origin is not None, "a message has both or none"
        if plan == self.plan:
            self._remember()
            self.provenance = origin
            return []
        notes = fallback_notes("plan", "neighbour", self._refused_answer if self.plan is None else None)
        self._follow(plan, origin, adopted=True, heard=heard)
        return [*notes, Note("adopted", {"plan": plan.digest, "from": source.sender})]

    def _remember(self) -> None:
        """Remember the last plan of each proposer with the claim on it, in case later plans turn out void."""
        if self._remembers and self.plan is not None and self.provenance is not None:
            self._followed[self.provenance.proposer] = self.plan, self.provenance, self.claim

    def _withdraw(self, plan: Plan, proposer: int) -> Note:
        """Return to the highest plan followed so far that is not void, with the claim of that time."""
        valid = [followed for robot, followed in self._followed.items() if robot not in self._void]
        self.plan, self.provenance, self.claim = max(valid, key=self._key, default=(None, None, Claim(slot=None)))
        self._membership.begin_plan()
        self.listens = self.plan is None  # to the next exchange: others may have a plan that counts
        after = None if self.plan is None else self.plan.digest
        return Note("void_plan", {"plan": plan.digest, "proposer": proposer, "after": after, "slot": self.claim.slot})

    def _key(self, followed: tuple[Plan, Provenance, Claim]) -> PlanKey:
        plan, origin, _ = followed
        return plan_key(plan, origin, self._verifier.plan_class(self.mission, plan))

    def _follow(self, plan: Plan, origin: Provenance, *, adopted: bool, heard: list[Message]) -> None:
        self._remember()
        self.plan, self.provenance, self.claim = plan, origin, Claim(slot=None)
        self._membership.begin_plan()
        self.claim = self._assignment.take(self._assignment_input(plan, adopted=adopted, heard=heard))

    def _assignment_input(self, plan: Plan, *, adopted: bool, heard: list[Message]) -> AssignmentInput:
        occupancy = None
        if self._occupancy_due:
            hears, knows = bool(heard), self._knows_blocked
            occupancy = self._membership.occupancy(self, hears_others=hears, knows_blocked=knows)
        return AssignmentInput(
            robot=self._robot,
            position=self.position,
            plan=plan,
            spacing=self.mission.spacing,
            chosen=self._chosen,
            adopted=adopted,
            heard=[m for m in heard if m.plan == plan],
            sensed=self.sensed,
            mission=self.stamp,
            origin=self.provenance,
            roadmap=self.ways,
            occupancy=occupancy,
            positions=self._membership.positions(self),
            preferences=self.mission if self.mission.prefer else None,
            exchanges=not self.mission.prefer,
            weights=self.weights,
            retired=self.retired,
        )

    def settle(self, heard: list[Message], void: frozenset[int] = frozenset()) -> list[Note]:
        """Decide on a communication round: consensus first, then the claim, both on the same snapshot.

        `heard` has the newest message of each sender, in ascending order of ids; plans of `void` robots do not count.
        Rules are pure: they are not called twice in a row with the same arguments.
        """
        self._void, self.listens = void, False
        withdrawn = list[Note]()
        if self.plan is not None and self.provenance is not None and self.provenance.proposer in void:
            withdrawn = [self._withdraw(self.plan, self.provenance.proposer)]
        standing = (self.claim, self.plan, self.provenance, self.degree, self.position, self.sensed, self.weights)
        proposed = None if self.ballot is None else self.ballot.known
        arguments = (*standing, self._membership.known, proposed, *heard)
        due = self._occupancy_due
        if not due and len(arguments) == len(self._settled) and all(map(operator.is_, arguments, self._settled)):
            return []
        own_class = self._verifier.plan_class(self.mission, self.plan)
        origin, degree = self.provenance, self.degree
        own = Standing(robot=self._robot, plan=self.plan, provenance=origin, degree=degree, plan_class=own_class)
        before = self.claim
        source = self._choose(own, heard if proposed is None else [*proposed.values()])
        adopted = [] if source is None else self._adopt(source, heard)
        if not adopted and self.plan is not None:
            claim = self._assignment.update(before, self._assignment_input(self.plan, adopted=True, heard=heard))
            self.claim = before if claim == before else claim
        self._occupancy_due = False
        notes = [*withdrawn, *adopted]
        self._settled = () if due or notes or self.claim is not before else arguments
        self._membership.hear_claims(heard, self.plan)
        if self.claim.slot != before.slot:
            notes.append(Note("claimed", {"slot": self.claim.slot, "before": before.slot}))
        return notes
