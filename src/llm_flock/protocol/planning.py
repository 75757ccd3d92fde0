"""The two questions a robot's mind asks, and the answers it takes; who answers is not its business."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.plan import Plan


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanQuestion:
    """Propose a whole formation and your own place in it.

    Attributes:
        mission: what the question is about, as it is at the end of this round and for as many places as are asked for.
        robot: who asks (0-based id).
        round: motion round in which it asks.
        position: where the robot believes it is [units; world frame].
        neighbors: believed positions of the robots it observes, in ascending order of their ids.
        still: positions of bodies in sight that do not move any more: no place may be on one [units; world frame].
    """

    mission: Mission
    robot: int
    round: int
    position: Point
    neighbors: tuple[Point, ...]
    still: tuple[Point, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class StepQuestion:
    """Choose the next waypoint on the way to the goal, or several; fields as in PlanQuestion, and the agreed plan.

    Attributes:
        plan: the plan that is followed, as it stands at the end of this round.
        slot: own place in it; None for a spare robot, which goes to wait at `target`.
        target: where to go instead of the own place (a search is under way), None otherwise [units; world frame].
        horizon: so many waypoints may be given, one for each round; with 1 it is the paper's question.
    """

    mission: Mission
    robot: int
    round: int
    position: Point
    neighbors: tuple[Point, ...]
    plan: Plan
    slot: int | None
    target: Point | None = None
    horizon: int = 1

    @property
    def goal(self) -> Point:
        """Where the robot is to go: its own place in the plan, or `target` [units; world frame]."""
        if self.target is not None:
            return self.target
        assert self.slot is not None, "a robot without a place is told where to wait"
        return self.plan.points[self.slot]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanAnswer:
    """A usable plan and the index of the place that the planner chose for its own robot.

    Attributes:
        plan: the formation.
        slot: the planner's own choice of a place.
        instead_of: the failure that this fallback stands in for; None where the planner itself answered.
    """

    plan: Plan
    slot: int
    instead_of: NoAnswer | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StepAnswer:
    """A usable waypoint.

    Attributes:
        waypoint: the next one [units; world frame].
        path: those that follow it, one for each round after this.
        instead_of: as in PlanAnswer.
    """

    waypoint: Point
    path: tuple[Point, ...] = ()
    instead_of: NoAnswer | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class NoAnswer:
    """The planner could not help this time.

    Attributes:
        cause: `answer` (never usable), `budget`, or the kind of a ModelError (`timeout`, `server`, ...).
        reason: the whole story in words, for the record.
        waypoint: the last one that could be read but was rejected [units; world frame], None without one.
    """

    cause: str
    reason: str
    waypoint: Point | None = None


Question: TypeAlias = PlanQuestion | StepQuestion
Answer: TypeAlias = PlanAnswer | StepAnswer | NoAnswer


class Planner(Protocol):
    """Answers one robot's questions: a language model, or plain geometry."""

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """Propose a formation."""
        ...

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Propose a waypoint, or `question.horizon` of them at most."""
        ...
