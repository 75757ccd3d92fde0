"""The exchangeable parts of a robot's decision process, each with a null part that does nothing of its own.

`Parts()` with two rules is the paper's robot: it hears its neighbours, and knows of no team beyond them. The parts that
do more are `membership.team.TeamMembership`, `motion.safety.ShieldedSafety`, `verification.validator.Validator`, and
for teams with keys those of `signed.parts`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from llm_flock.arrays import Point, moved
from llm_flock.events import Note, Origin
from llm_flock.message import Course, Message, PositionReport, TeamPositions
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import AssignmentRule, Claim, IndexAssignment, Occupancy
from llm_flock.protocol._agreement.consensus import ConsensusRule, NoConsensus
from llm_flock.protocol._messages.channel import Channel
from llm_flock.protocol._motion.leg import Leg
from llm_flock.protocol._path_length import next_stop
from llm_flock.protocol._planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._verification.steps import Verdict

NO_COURSES: Mapping[int, Course] = {}


class Observation(msgspec.Struct, frozen=True, kw_only=True):
    """Positions that a robot observes in a round.

    Attributes:
        position: the robot's believed position [units; world frame].
        sensed: believed positions of the robots within sensing range, by id [units; world frame].
        observed: positions of other robots for the planner's question [units; world frame].
        drift: displacement of the mission's frame so far [units]; empty if the mission stands still.
        ahead: displacement at the end of the round, for which goals are given [units]; empty as `drift`.
        courses: ways that others ask to be left free, by sender.
        still: bodies in sight that do not move [units; world frame].
        period: heartbeat period; None where each round counts as one.
    """

    round: int = 1
    position: Point
    sensed: Mapping[int, Point]
    observed: tuple[Point, ...] = ()
    drift: Point = ()
    ahead: Point = ()
    courses: Mapping[int, Course] = NO_COURSES
    still: tuple[Point, ...] = ()
    period: int | None = None

    def seen(self, point: Point) -> Point:
        """A point of the world frame in the present frame of the mission."""
        return moved(point, self.drift, -1.0)

    @property
    def here(self) -> Point:
        """The robot's position in the frame of the mission."""
        return self.seen(self.position)

    @property
    def others(self) -> tuple[Point, ...]:
        """Positions of the robots within sensing range [units; world frame]."""
        return tuple(self.sensed.values())


Gaps: TypeAlias = Literal["report", "replan"]
"""What to do about slots that no living robot can take."""


class Membership:
    """What a robot knows of its team beyond the last messages of its neighbours; this part knows nothing.

    Positions are in the frame of the mission [units].
    """

    @property
    def beats(self) -> tuple[int, ...]:
        """The highest heartbeat known of each robot, by id; empty where none are counted."""
        return ()

    @property
    def lost(self) -> bool:
        """Whether a robot without a place should look for the others."""
        return False

    @property
    def known(self) -> object:
        """The positions that were collected; another object whenever they have changed."""
        return None

    def begin_mission(self) -> None:
        """Another mission has come into force."""

    def begin_plan(self) -> None:
        """The robot follows another plan."""

    def begin_round(
        self,
        period: int,
        near: frozenset[int],
        *,
        mission: Mission,
        plan: Plan | None,
        claim: Claim,
        cannot_fly: bool,
    ) -> None:
        """Begin a round or heartbeat period; robots `near` are sensed within radio range."""

    def hear_beats(self, beats: Sequence[NDArray[np.int64]]) -> None:
        """Merge the heartbeats of a communication round's messages, each of shape (N,)."""

    def hear_positions(self, reports: Mapping[int, PositionReport]) -> None:
        """Merge the positions that a neighbour knows."""

    def hear_claims(self, heard: Sequence[Message], plan: Plan | None) -> None:
        """Take note of what the neighbours claim, after a decision; the robot follows `plan`."""

    def report(
        self, mission: Mission, plan: Plan | None, claim: Claim, position: Point, *, greeting: bool
    ) -> dict[int, PositionReport] | None:
        """The positions to broadcast; `greeting` is the first broadcast of a round."""
        return None

    def places(self, mission: Mission, plan: Plan | None, *, sees_bodies: bool) -> int | None:
        """Number of places of the plan that the robot is to propose now; None while it need not propose."""
        return mission.n_places if plan is None else None

    def still(self, mission: Mission, sensed: Mapping[int, Point]) -> tuple[Point, ...]:
        """Bodies in sight whose heartbeats have stopped."""
        return ()

    def occupancy(
        self,
        mission: Mission,
        plan: Plan,
        position: Point,
        sensed: Mapping[int, Point],
        *,
        hears_others: bool,
        knows_blocked: bool,
    ) -> Occupancy | None:
        """What sensors and heartbeats say about the slots of a plan. Call once a round."""
        return None

    def positions(self, mission: Mission, plan: Plan, claim: Claim) -> TeamPositions | None:
        """Where the robots are that are to be assigned jointly; None where there is nothing new to assign."""
        return None

    def route(
        self, mission: Mission, plan: Plan, claim: Claim, here: Point, bodies: Sequence[Point]
    ) -> tuple[Point | None, Claim, list[Note]]:
        """The next intermediate target on the way to the claimed place, for a robot that sees these bodies.

        Without a team to look for, a far place is approached along the formation, where neighbours are. Call once a
        round.

        Returns:
            The target, None to fly straight to the place; the claim with what was found out on the way; and notes.
        """
        assert claim.slot is not None, "a robot without a place has no way to it"
        roadmap = mission.roadmap if mission.velocity is None else None
        return next_stop(here, plan, claim.slot, mission.center, mission.spacing, roadmap), claim, []

    def seek(self, mission: Mission, here: Point) -> Point | None:
        """Where a robot looks for the others that is lost, or has no plan; None to wait. Call once a round."""
        return None

    def wait(self, mission: Mission, plan: Plan, claim: Claim, here: Point, others: Sequence[Point]) -> Point:
        """Where a spare robot waits, with other robots in sight at `others`."""
        return here


class SafeStep(msgspec.Struct, frozen=True, kw_only=True):
    """A waypoint to fly, its origin, and notes for the record."""

    waypoint: Point
    origin: Origin
    notes: tuple[Note, ...] = ()


class Safety:
    """Turns the planner's waypoints into safe ones; this part flies them as they are."""

    @property
    def course(self) -> Course | None:
        """Where this robot has to go, for others to leave free; None if nothing is in its way."""
        return None

    def begin_mission(self) -> None:
        """Heed everybody who asks for a way again: a mission has been given."""

    def stay(self, scene: Observation) -> SafeStep:
        """The step of a robot without a waypoint."""
        return SafeStep(waypoint=scene.position, origin=Origin.HOLD)

    def step(self, scene: Observation, wish: Point, leg: Leg, tolerance: float) -> SafeStep:
        """The safe waypoint for the planner's waypoint `wish` [units; world frame]."""
        return SafeStep(waypoint=wish, origin=Origin.MODEL)


class Checker:
    """Checks plans before they are followed, and waypoints before they are flown; this part accepts everything.

    Attributes:
        verify: whether anything is checked.
        any_size: whether a plan may have fewer places than the mission, as plans for a smaller team do.
    """

    verify: bool = False

    def __init__(self, *, any_size: bool = False) -> None:
        self.any_size = any_size

    def objection(self, mission: Mission, plan: Plan | None) -> str | None:
        """The reason to refuse a plan, or None. Call before a plan is adopted or forwarded."""
        return None

    def plan_class(self, mission: Mission, plan: Plan | None) -> int:
        """The plan's class in the total order of plans; 0 for every plan where nothing is checked."""
        return 0

    def plan(self, question: PlanQuestion, answer: PlanAnswer | NoAnswer) -> PlanAnswer | NoAnswer:
        """The planner's answer, perhaps a little larger, or the reason to refuse its plan. Call with every answer."""
        return answer

    def judge(self, question: StepQuestion, answer: StepAnswer) -> Verdict:
        """What the checks make of the planner's answer."""
        return Verdict(reason=None, fit=answer)


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """What one robot is made of. Rules are pure functions; every other part keeps state, and belongs to one robot.

    Attributes:
        consensus: which plan to follow.
        assignment: which place of it to claim.
        channel: between the radio's bytes and the agreement; None for one that believes every well-formed message.
        membership: who is in the team, and where to look for them.
        safety: what waypoints become before they are flown.
        verifier: checks of plans and waypoints.
    """

    consensus: ConsensusRule = field(default_factory=NoConsensus)
    assignment: AssignmentRule = field(default_factory=IndexAssignment)
    channel: Channel | None = None
    membership: Membership = field(default_factory=Membership)
    safety: Safety = field(default_factory=Safety)
    verifier: Checker = field(default_factory=Checker)
