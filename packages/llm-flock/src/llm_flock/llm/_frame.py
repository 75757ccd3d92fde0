"""The coordinates of a prompt: those of the world, or a frame in which the numbers are small and near zero.

A small model cannot add 57.31 and 3.18 reliably. Its own frame avoids that: it plans around the origin with the spacing
as unit, and steps from the origin with a hundredth of the step limit as unit. The question is moved and scaled before
it is rendered, and the answer is moved and scaled back before it is checked. Of a plan, directions stay; for a step,
the frame is turned so that the goal lies ahead, on the first axis: it need not find a direction, only whether the way
is free.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Generic, TypeVar

from llm_flock.arrays import Point
from llm_flock.llm._port import FrameName
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.planner import (
    JudgementAnswer,
    JudgementQuestion,
    PlanAnswer,
    PlanQuestion,
    StepAnswer,
    StepQuestion,
)
from llm_flock.shapes import is_drawn, shape_name

Q = TypeVar("Q", PlanQuestion, StepQuestion, JudgementQuestion)
A = TypeVar("A", PlanAnswer, StepAnswer, JudgementAnswer)
_Located = TypeVar("_Located", PlanQuestion, StepQuestion)


@dataclass(frozen=True, slots=True, kw_only=True)
class PromptFrame:
    """Moved, scaled and turned coordinates: `(point - origin) / unit`, with `ahead` as the first axis.

    Observed and planned points have `decimals`.
    """

    origin: Point
    unit: float
    decimals: int
    ahead: Point = (1.0, 0.0)  #: A direction of the plane, of length 1.

    def rounded(self, point: Point) -> Point:
        """A point of the world in this frame, rounded: to whole numbers where there are no decimals."""
        # Adding zero turns -0.0 into 0.0.
        return tuple(round(x, self.decimals) + 0.0 if self.decimals else round(x) for x in self.exact(point))

    def exact(self, point: Point) -> Point:
        """A point of the world in this frame, not rounded."""
        return self._turned(tuple((x - o) / self.unit for x, o in zip(point, self.origin, strict=True)), -1)

    def world(self, point: Point) -> Point:
        """A point of this frame in the world [units]."""
        return tuple(o + x * self.unit for x, o in zip(self._turned(point), self.origin, strict=True))

    def _turned(self, point: Point, sense: int = 1) -> Point:
        (x, y), (cos, sin) = point[:2], self.ahead
        return (cos * x - sense * sin * y, sense * sin * x + cos * y, *point[2:]) if sin or cos < 0 else point

    def mission(self, mission: Mission) -> Mission:
        """The mission in this frame; it is valid in the world, so it is not validated again."""
        fields: dict[str, Any] = {name: getattr(mission, name) for name in Mission.model_fields}
        for name in ("spacing", "safe_distance", "max_step", "comm_range", "sense_range"):
            fields[name] = None if fields[name] is None else fields[name] / self.unit
        safe, coarse = fields["safe_distance"], 10**self.decimals  # fewer digits to read; less would be refused
        fields["safe_distance"] = max(safe, min(math.ceil(round(safe * coarse, 6)) / coarse, fields["spacing"]))
        corners = [self.exact(corner) for corner in product(*zip(*mission.arena, strict=True))]
        fields["center"], fields["arena"] = (
            self.exact(mission.center),
            tuple(tuple(map(f, *corners)) for f in (min, max)),
        )
        fields["obstacles"] = tuple(map(self._obstacle, mission.obstacles))
        if mission.velocity is not None:
            fields["velocity"] = self._turned(tuple(v / self.unit for v in mission.velocity), -1)
        if mission.points is not None:
            fields["points"] = tuple(tuple(x / self.unit for x in row) for row in mission.points)
        oriented = mission.turn or (mission.turn is not None and self.ahead != (1.0, 0.0))
        if (is_drawn(mission.shape) or oriented) and mission.ideal:  # a program may have lengths in units
            fields["shape"], fields["points"] = "points", tuple(map(self.exact, mission.ideal))
            fields["turn"] = None if mission.turn is None else 0.0
        return Mission.model_construct(**fields)

    def _obstacle(self, obstacle: Obstacle) -> Obstacle:
        if obstacle.polygon is not None:
            return Obstacle.model_construct(polygon=tuple(map(self.exact, obstacle.polygon)))
        assert obstacle.center is not None and obstacle.radius is not None, "an obstacle is a polygon or a disc"
        return Obstacle.model_construct(center=self.exact(obstacle.center), radius=obstacle.radius / self.unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class FramedQuestion(Generic[Q]):
    """A question in the world and in the frame of its prompt."""

    question: Q
    framed: Q  #: The question in the frame of the prompt; the same question if that is the world.
    frame: PromptFrame | None = None  #: The frame of the prompt, None for the world.

    def to_world(self, answer: A) -> A:
        """An answer in the world. If the model repeats the goal, the waypoint is exactly the goal."""
        if self.frame is None or isinstance(answer, JudgementAnswer):
            return answer
        if isinstance(answer, PlanAnswer):
            return replace(answer, plan=answer.plan.mapped(self.frame.origin, self.frame.unit))
        return replace(answer, waypoint=self._waypoint(answer.waypoint), path=tuple(map(self._waypoint, answer.path)))

    def _waypoint(self, point: Point) -> Point:
        assert self.frame is not None
        assert isinstance(self.framed, StepQuestion) and isinstance(self.question, StepQuestion)
        return self.question.goal if point == self.framed.goal else self.frame.world(point)


def frame_plan(question: PlanQuestion, name: FrameName) -> FramedQuestion[PlanQuestion]:
    """Frame a question for a plan: around the origin, in spacings. Free text may name lengths, so it stays."""
    mission = question.mission
    if name == "world" or shape_name(mission.shape) == "text":
        return FramedQuestion(question=question, framed=question)
    frame = _frame(mission.center, mission.spacing, mission)
    return _framed(question, frame, still=tuple(map(frame.rounded, question.still)))


def frame_step(question: StepQuestion, name: FrameName) -> FramedQuestion[StepQuestion]:
    """Frame a question for a step: from the origin, in hundredths of the step limit, which need no decimals."""
    if name == "world":
        return FramedQuestion(question=question, framed=question)
    x, y = (goal - here for goal, here in zip(question.goal[:2], question.position, strict=False))
    far = math.hypot(x, y)
    frame = _frame(question.position, question.mission.max_step, question.mission)
    frame = replace(
        frame, unit=frame.unit / 100, decimals=frame.decimals - 2, ahead=(x / far, y / far) if far else frame.ahead
    )
    return _framed(
        question,
        frame,
        plan=Plan.of(map(frame.rounded, question.plan.points)),
        target=None if question.target is None else frame.rounded(question.target),
        corner=None if question.corner is None else frame.rounded(question.corner),
    )


def _framed(question: _Located, frame: PromptFrame, **own: Any) -> FramedQuestion[_Located]:
    """A question in a frame: the fields of both kinds of questions, and its `own` ones."""
    position, neighbors = frame.rounded(question.position), tuple(map(frame.rounded, question.neighbors))
    framed = replace(question, mission=frame.mission(question.mission), position=position, neighbors=neighbors, **own)
    return FramedQuestion(question=question, framed=framed, frame=frame)


def _frame(origin: Point, unit: float, mission: Mission) -> PromptFrame:
    """A frame with two decimals, or more if those would be coarse beside the spacing or the safe distance."""
    finest = 10 * min(mission.spacing, mission.safe_distance)
    return PromptFrame(origin=origin, unit=unit, decimals=2 + max(0, math.ceil(math.log10(unit / finest))))
