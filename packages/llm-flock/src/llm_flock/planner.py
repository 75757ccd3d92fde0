"""The questions of a robot's decision process, and their answers. Any planner may answer them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias, cast

from llm_flock.arrays import Point
from llm_flock.message import Choice
from llm_flock.mission import Mission
from llm_flock.plan import Plan


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanQuestion:
    """Propose a whole formation and your own place in it."""

    mission: Mission  #: The mission as it stands at the end of this round, with as many places as the plan should have.
    robot: int  #: Own id, from 0.
    round: int  #: Motion round of the question.
    position: Point  #: Own believed position [units; world frame].
    #: Believed positions of observed robots, in ascending order of their ids [units; world frame].
    neighbors: tuple[Point, ...]
    #: Positions of sensed bodies that no longer move; no place may lie on one [units; world frame].
    still: tuple[Point, ...] = ()
    probe: bool = False  #: Whether the planner gets a single attempt, because its last answers could not be used.


@dataclass(frozen=True, slots=True, kw_only=True)
class StepQuestion:
    """Choose the next waypoint, or several. Has the fields of PlanQuestion except `still`, and more."""

    mission: Mission
    robot: int
    round: int
    position: Point
    neighbors: tuple[Point, ...]
    plan: Plan  #: The plan that is followed, as it stands at the end of this round.
    slot: int | None  #: Own slot in it; None for a spare robot, which goes to wait at `target`.
    #: Where to go instead of the own place, for example on a search; None otherwise [units; world frame].
    target: Point | None = None
    #: The next corner of the way there, where obstacles are in between; None otherwise [units; world frame].
    corner: Point | None = None
    horizon: int = 1  #: Largest number of waypoints in the answer, one for each round; 1 is the paper's question.
    probe: bool = False
    objection: str = ""  #: Why the last answer to this question is not flown, as a sentence; empty at first.

    @property
    def goal(self) -> Point:
        """The point to fly to: own place, `target`, or next `corner` on the way [units; world frame]."""
        if self.corner is not None:
            return self.corner
        if self.target is not None:
            return self.target
        assert self.slot is not None, "a robot without a place is told where to wait"
        return self.plan.points[self.slot]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanAnswer:
    """A usable plan, the slot that the planner chose for its own robot, and whether geometry made it for the model."""

    plan: Plan
    slot: int
    by: Literal["model", "geometry"] = "model"


@dataclass(frozen=True, slots=True, kw_only=True)
class StepAnswer:
    """A usable waypoint, and the `path` after it, a waypoint for each round [units; world frame].

    `by` says whether geometry computed it because there was nothing to ask the model.
    """

    waypoint: Point
    path: tuple[Point, ...] = ()
    by: Literal["model", "geometry"] = "model"


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgementOption:
    """Something that the team can do now, with the figures that code expects of it."""

    choice: Choice
    does: str  #: What would be done, as a sentence.
    rounds: int  #: Rounds until the robots that it moves have arrived.
    distance: float  #: What they fly together [units].
    gaps: int  #: Places of the shape that stay empty.
    lost: int = 0  #: Robots whose battery would be empty on their way.


Aim: TypeAlias = tuple[str, str, str]

AIMS: Mapping[str, Aim] = {
    "the fewest empty places count, then the fewest rounds, then the least flying.": ("gaps", "rounds", "distance"),
    "the fewest rounds count, then the fewest empty places, then the least flying.": ("rounds", "gaps", "distance"),
    "the least flying counts, then the fewest empty places, then the fewest rounds.": ("distance", "gaps", "rounds"),
}
"""Wishes by which code can tell the right option, each with its figures in their order; the first is the default."""


def best_option(options: Sequence[JudgementOption], aim: str = "") -> Choice:
    """The right one of some options by their figures: no robot may be lost, then an aim of `AIMS` counts.

    The name of an option, also with a colon and words behind it, asks for that one.
    """
    if (named := aim.partition(":")[0]) in [option.choice for option in options]:
        return cast("Choice", named)
    order = AIMS[aim or next(iter(AIMS))]
    return min(options, key=lambda option: (option.lost, *(getattr(option, name) for name in order))).choice


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgementQuestion:
    """Choose what the team should do after an event; asked once about each event."""

    mission: Mission
    robot: int
    round: int
    event: str  #: What has come up, as a sentence.
    options: tuple[JudgementOption, ...]  #: At least two; the first is what happens without a choice.
    probe: bool = False
    words: str = ""  #: The order that it is about, which then says what counts; empty for other events.


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgementAnswer:
    """The choice of one of the options, and the reason for it in the model's words."""

    choice: Choice
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoAnswer:
    """The planner could not answer this time."""

    cause: str  #: `answer` (never usable), `budget`, or the kind of a ModelError (`timeout`, `server`, ...).
    reason: str  #: The full reason, for the record.
    #: The last waypoint that could be read but was rejected [units; world frame]; None without one.
    waypoint: Point | None = None


Question: TypeAlias = PlanQuestion | StepQuestion | JudgementQuestion
Answer: TypeAlias = PlanAnswer | StepAnswer | JudgementAnswer | NoAnswer


class Planner(Protocol):
    """Answers one robot's questions: a language model, or plain geometry."""

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """Propose a formation."""
        ...

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Propose a waypoint, or up to `question.horizon` of them."""
        ...
