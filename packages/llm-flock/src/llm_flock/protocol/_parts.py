"""The exchangeable parts of a robot's decision process, each with a null part that does nothing.

`Parts()` with two rules is the paper's robot. The parts that do more are `TeamMembership`, `ShieldedSafety` and
`Validator`, and for teams with keys those of `llm_flock_swarm.signed_parts`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from llm_flock.arrays import Point, moved
from llm_flock.events import Note, Origin
from llm_flock.message import Course, Message, PositionReport, TeamPositions
from llm_flock.mission import Mission
from llm_flock.obstacles import Mover, Obstacle
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._agreement.assignment import AssignmentRule, Claim, IndexAssignment, Occupancy
from llm_flock.protocol._agreement.consensus import ConsensusRule, NoConsensus
from llm_flock.protocol._messages.channel import Channel
from llm_flock.protocol._motion.leg import Leg
from llm_flock.protocol._verification.steps import Verdict

if TYPE_CHECKING:
    from llm_flock.roadmap import Roadmap  # only missions with obstacles need it

NO_COURSES: Mapping[int, Course] = {}


class Observation(msgspec.Struct, frozen=True, kw_only=True):
    """Positions that a robot observes in a round."""

    round: int = 1
    position: Point  #: The robot's believed position [units; world frame].
    sensed: Mapping[int, Point]  #: Believed positions of the robots within sensing range, by id [units; world frame].
    observed: tuple[Point, ...] = ()  #: Positions of other robots for the planner's question [units; world frame].
    drift: Point = ()  #: Displacement of the mission's frame so far [units]; empty if the mission stands still.
    ahead: Point = ()  #: Displacement at the end of the round, for which goals are given [units]; empty as `drift`.
    courses: Mapping[int, Course] = NO_COURSES  #: Ways that others ask to be left free, by sender.
    moving: tuple[Mover, ...] = ()  #: Moving obstacles within sensing range.
    still: tuple[Point, ...] = ()  #: Bodies in sight that do not move [units; world frame].
    period: int | None = None  #: Heartbeat period; None where each round counts as one.

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


Gaps: TypeAlias = Literal["report", "replan"]  # what to do about slots that no living robot can take


class Situation:
    """One robot's mission, plan, claim and sensed positions [units; frame of the mission]; `Agreement` decides."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.plan: Plan | None = None
        self.claim = Claim(slot=None)
        self.position: Point = ()
        self.sensed: Mapping[int, Point] = {}
        self.weights: Mapping[int, float] = {}  #: Of robots whose ways count for more than others' in exchanges.
        self.earlier: tuple[Point, ...] = ()  #: Where robots may stand that missed the last orders.
        self.resting: tuple[Obstacle, ...] = ()  #: Moving obstacles that the team takes to stay where they are.

    @property
    def terrain(self) -> Mission:
        """The mission with these obstacles besides its own."""
        return self.mission.among(self.resting)

    @property
    def ways(self) -> Roadmap | None:
        """The ways round obstacles; None if straight lines count, as for a formation that moves."""
        return self.mission.roadmap if self.mission.velocity is None else None


class Membership:
    """A robot's knowledge of its team beyond the last messages of its neighbours. This part has none."""

    @property
    def beats(self) -> tuple[int, ...]:
        """The highest known heartbeat of each robot, by id; empty if none are counted."""
        return ()

    @property
    def lost(self) -> bool:
        """Whether a robot without a place has been out of touch for so long that it should look for the others."""
        return False

    @property
    def deserted(self) -> bool:
        """Whether a robot has been alone at its place for so long that it should look for the others."""
        return False

    @property
    def replans(self) -> bool:
        """Whether its plan does not fit the living team, as far as it knows, so that it will propose another one."""
        return False

    @property
    def missing(self) -> int:
        """Number of robots that were heard of and are silent."""
        return 0

    @property
    def known(self) -> object:
        """The collected positions; a new object after each change."""
        return None

    def begin_mission(self) -> None:
        """Another mission has come into force."""

    def begin_plan(self) -> None:
        """The robot follows another plan."""

    def begin_round(self, period: int, near: frozenset[int], now: Situation, *, cannot_fly: bool) -> None:
        """Begin a round or heartbeat period; robots `near` are sensed within radio range."""

    def hear_beats(self, beats: Sequence[NDArray[np.int64]]) -> None:
        """Merge the heartbeats of a communication round's messages, each of shape (N,)."""

    def hear_positions(self, reports: Mapping[int, PositionReport]) -> None:
        """Merge the positions that a neighbour knows."""

    def hear_claims(self, heard: Sequence[Message], plan: Plan | None) -> None:
        """Take note of the neighbours' claims after a decision. The robot follows `plan`."""

    def report(self, now: Situation, *, greeting: bool) -> dict[int, PositionReport] | None:
        """The positions to broadcast; `greeting` is the first broadcast of a round."""
        return None

    def places(self, now: Situation) -> int | None:
        """Number of places of the plan that the robot is to propose now; None while it need not propose."""
        return now.mission.n_places if now.plan is None else None

    def still(self, now: Situation) -> tuple[Point, ...]:
        """Bodies in sight whose heartbeats have stopped."""
        return ()

    def occupancy(self, now: Situation, *, hears_others: bool, knows_blocked: bool) -> Occupancy | None:
        """The knowledge of the plan's slots from sensors and heartbeats. Call once a round."""
        return None

    def positions(self, now: Situation) -> TeamPositions | None:
        """Positions of the robots to assign jointly; None if there is nothing new to assign."""
        return None

    def route(self, now: Situation) -> tuple[Point | None, Claim, list[Note]]:
        """The next intermediate target on the way to the claimed place, None to fly straight there. Call once a round.

        Also returns the claim, which may have changed on the way, and notes.
        """
        return None, now.claim, []

    def seek(self, now: Situation) -> Point | None:
        """The point at which a robot, lost or without plan, looks for others; None to wait. Call once a round."""
        return None

    def wait(self, now: Situation) -> Point:
        """The point at which a spare robot waits."""
        return now.position


class SafeStep(msgspec.Struct, frozen=True, kw_only=True):
    """A waypoint to fly, its origin, and notes for the record."""

    waypoint: Point
    origin: Origin
    notes: tuple[Note, ...] = ()


class Safety:
    """Turns the planner's waypoints into safe ones. This part leaves them unchanged."""

    @property
    def course(self) -> Course | None:
        """The way that this robot asks others to leave free; None if nothing is in its way."""
        return None

    def begin_mission(self) -> None:
        """Begin another mission: heed all requests for a way again."""

    def rests(self, round_: int) -> bool:
        """Whether the whole team stands still in a round, so that sensors that are late see it where it is."""
        return False

    def stay(self, scene: Observation) -> SafeStep:
        """The step of a robot without a waypoint."""
        return SafeStep(waypoint=scene.position, origin=Origin.HOLD)

    def resting(self, scene: Observation) -> tuple[Obstacle, ...]:
        """Moving obstacles in sight that have come to rest, as large as robots keep away from them."""
        return ()

    def room(self, scene: Observation, leg: Leg) -> float:
        """How much nearer to the leg's stop a straight step leads now, as far as others leave it free [units]."""
        return 0.0

    def step(self, scene: Observation, wish: Point, leg: Leg, tolerance: float) -> SafeStep:
        """The safe waypoint for the planner's waypoint `wish` [units; world frame]."""
        return SafeStep(waypoint=wish, origin=Origin.MODEL)


class Checker:
    """Checks plans before they are followed, and waypoints before they are flown. This part accepts everything."""

    verify: bool = False  #: Whether anything is checked.

    def __init__(self, *, any_size: bool = False) -> None:
        self.any_size = any_size  #: Whether a plan may have fewer places than the mission, as for a smaller team.

    def objection(self, mission: Mission, plan: Plan | None) -> str | None:
        """The reason to reject a plan, or None. Call before a plan is adopted or forwarded."""
        return None

    def plan_class(self, mission: Mission, plan: Plan | None) -> int:
        """The plan's class in the total order of plans; 0 for every plan if nothing is checked."""
        return 0

    def plan(self, question: PlanQuestion, answer: PlanAnswer | NoAnswer) -> PlanAnswer | NoAnswer:
        """The planner's answer, perhaps slightly enlarged, or the reason to reject its plan. Call with every answer."""
        return answer

    def judge(self, question: StepQuestion, answer: StepAnswer) -> Verdict:
        """The verdict of the checks on the planner's answer."""
        return Verdict(reason=None, fit=answer)


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """The parts of one robot. Rules are pure functions. Every other part keeps state, and belongs to one robot."""

    consensus: ConsensusRule = field(default_factory=NoConsensus)  #: Which plan to follow.
    assignment: AssignmentRule = field(default_factory=IndexAssignment)  #: Which place of it to claim.
    #: Between the radio's bytes and the agreement; None for a channel that believes every well-formed message.
    channel: Channel | None = None
    membership: Membership = field(default_factory=Membership)  #: The robots of the team, and where to look for them.
    safety: Safety = field(default_factory=Safety)  #: Makes waypoints safe before they are flown.
    verifier: Checker = field(default_factory=Checker)  #: Checks of plans and waypoints.
