"""The frame of coordinates in which a model is asked: the world's, or one in which the numbers are small and near zero.

A small model cannot add 57.31 and 3.18 safely. In its own frame it need not: a plan is asked for around the origin with
the spacing as unit, and a step from the origin with the step limit as unit. The question is moved and scaled before it
is put into words, and the answer is moved and scaled back before anything else looks at it. Directions stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, TypeAlias, TypeVar

from llm_flock.arrays import Point
from llm_flock.formations import shape_name
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import PlanAnswer, PlanQuestion, StepAnswer, StepQuestion

FrameName: TypeAlias = Literal["world", "own"]

Q = TypeVar("Q", PlanQuestion, StepQuestion)
A = TypeVar("A", PlanAnswer, StepAnswer)

TRAINED = "local:smollm2"
"""The model that is trained for its own frame and for few words; an adapter may follow after a plus sign."""


def trained_for(model: str) -> bool:
    """Whether a model, as `--model` names it, is trained for its own frame and the brief words."""
    return model.partition("+")[0] == TRAINED


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """Coordinates that are moved and scaled: `(point - origin) / unit`.

    Attributes:
        origin: what becomes zero [units; world frame].
        unit: what becomes one [units].
        decimals: observed and planned points are rounded to so many in this frame.
    """

    origin: Point
    unit: float
    decimals: int

    def told(self, point: Point) -> Point:
        """A point of the world as it is told, rounded."""
        # Adding zero turns -0.0 into 0.0.
        return tuple(round(x, self.decimals) + 0.0 for x in self.exact(point))

    def exact(self, point: Point) -> Point:
        """A point of the world in this frame, not rounded."""
        return tuple((x - o) / self.unit for x, o in zip(point, self.origin, strict=True))

    def world(self, point: Point) -> Point:
        """A point of this frame in the world [units]."""
        return tuple(o + x * self.unit for x, o in zip(point, self.origin, strict=True))

    def mission(self, mission: Mission) -> Mission:
        """The mission in this frame. It was valid in the world's, so it is not validated again."""
        fields: dict[str, Any] = {name: getattr(mission, name) for name in Mission.model_fields}
        for name in ("spacing", "safe_distance", "max_step", "comm_range"):
            fields[name] = getattr(mission, name) / self.unit
        low, high = mission.arena
        fields["center"], fields["arena"] = self.exact(mission.center), (self.exact(low), self.exact(high))
        fields["obstacles"] = tuple(map(self._obstacle, mission.obstacles))
        if mission.sense_range is not None:
            fields["sense_range"] = mission.sense_range / self.unit
        if mission.velocity is not None:
            fields["velocity"] = tuple(v / self.unit for v in mission.velocity)
        if mission.points is not None:
            fields["points"] = tuple(tuple(x / self.unit for x in row) for row in mission.points)
        return Mission.model_construct(**fields)

    def _obstacle(self, obstacle: Obstacle) -> Obstacle:
        if obstacle.polygon is not None:
            return Obstacle.model_construct(polygon=tuple(map(self.exact, obstacle.polygon)))
        assert obstacle.center is not None and obstacle.radius is not None, "an obstacle is a polygon or a disc"
        return Obstacle.model_construct(center=self.exact(obstacle.center), radius=obstacle.radius / self.unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked(Generic[Q]):
    """A question as it is meant and as it is told.

    Attributes:
        question: in the world.
        told: in the frame of the model; the same one where that is the world's.
        frame: how to come from one to the other; None where there is nothing to do.
    """

    question: Q
    told: Q
    frame: Frame | None

    def meant(self, answer: A) -> A:
        """What an answer in the model's numbers means in the world; a goal that it repeats is the goal."""
        if self.frame is None:
            return answer
        if isinstance(answer, PlanAnswer):
            return replace(answer, plan=Plan.of(map(self.frame.world, answer.plan.points)))
        return replace(answer, waypoint=self._place(answer.waypoint), path=tuple(map(self._place, answer.path)))

    def _place(self, point: Point) -> Point:
        assert (
            self.frame is not None and isinstance(self.told, StepQuestion) and isinstance(self.question, StepQuestion)
        )
        return self.question.goal if point == self.told.goal else self.frame.world(point)


def ask_plan(question: PlanQuestion, name: FrameName) -> Asked[PlanQuestion]:
    """A plan is asked for around the origin, in spacings.

    A shape in words may speak of lengths, which nobody can scale: it is asked for in the world.
    """
    mission = question.mission
    if name == "world" or shape_name(mission.shape) == "text":
        return Asked(question=question, told=question, frame=None)
    frame = _frame(mission.center, mission.spacing, mission)
    told = replace(
        question,
        mission=frame.mission(mission),
        position=frame.told(question.position),
        neighbors=tuple(map(frame.told, question.neighbors)),
        still=tuple(map(frame.told, question.still)),
    )
    return Asked(question=question, told=told, frame=frame)


def ask_step(question: StepQuestion, name: FrameName) -> Asked[StepQuestion]:
    """A step is asked for from the origin, in step limits."""
    mission = question.mission
    if name == "world":
        return Asked(question=question, told=question, frame=None)
    frame = _frame(question.position, mission.max_step, mission)
    told = replace(
        question,
        mission=frame.mission(mission),
        position=frame.told(question.position),
        neighbors=tuple(map(frame.told, question.neighbors)),
        plan=Plan.of(map(frame.told, question.plan.points)),
        target=None if question.target is None else frame.told(question.target),
    )
    return Asked(question=question, told=told, frame=frame)


def _frame(origin: Point, unit: float, mission: Mission) -> Frame:
    """Two decimals, and more where they would be coarse beside the spacing or the safe distance."""
    finest = 10 * min(mission.spacing, mission.safe_distance)
    return Frame(origin=origin, unit=unit, decimals=2 + max(0, math.ceil(math.log10(unit / finest))))
