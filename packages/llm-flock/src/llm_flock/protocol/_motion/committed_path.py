"""The path that a planner gave in advance, flown step by step like fresh answers, and the events that end it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from itertools import pairwise
from typing import Self

import msgspec
from msgspec.structs import replace

from llm_flock.arrays import Point
from llm_flock.metrics import AT_GOAL
from llm_flock.obstacles import nearest_on_segment, segment_clearance
from llm_flock.planner import NoAnswer, StepAnswer, StepQuestion
from llm_flock.protocol._verification.steps import passing

HORIZON = 20  # largest number of waypoints in an answer


class Trigger(StrEnum):
    """The event that makes a robot ask its planner again."""

    NO_ANSWER = "no_answer"
    NEW_PLAN = "new_plan"
    NEW_GOAL = "new_goal"
    ALTERED = "altered"
    USED_UP = "used_up"
    OBSTACLE = "obstacle"
    NEIGHBOUR = "neighbour"
    UNFIT = "unfit"


class CommittedPath(msgspec.Struct, frozen=True, kw_only=True):
    """The last question to the planner, and the rest of its answer [units; frame of the mission].

    A last waypoint at the goal stays in the `path`, and holds the robot there. `in_sight` were the robots within
    sensing range when the planner was asked.
    """

    question: StepQuestion
    path: tuple[Point, ...]
    failed: bool
    altered: bool = False
    in_sight: frozenset[int]

    @classmethod
    def of(cls, question: StepQuestion, answer: StepAnswer | NoAnswer, sensed: Mapping[int, Point]) -> Self:
        """The path that an answer commits the robot to. Call with every answer of the planner."""
        usable = isinstance(answer, StepAnswer)
        path = (answer.waypoint, *answer.path) if usable else ()
        return cls(question=question, path=path, failed=not usable, in_sight=frozenset(sensed))

    def after_step(self, position: Point, waypoint: Point) -> Self:
        """The rest of the path after a step from `position` to `waypoint`, the shielded first waypoint."""
        if not self.path:
            return self
        sideways = _distance_to_path((position, *self.path), waypoint)
        shortfall = math.dist(waypoint, self.path[0])
        max_step = self.question.mission.max_step
        altered = sideways > 0.25 * max_step or shortfall > 0.75 * max_step  # so far, the step counts as flown
        ends = len(self.path) == 1 and _at_goal(self.question, self.path[0])
        return replace(self, altered=altered, path=self.path if ends else self.path[1:])

    def trigger(self, question: StepQuestion, sensed: Mapping[int, Point]) -> Trigger | None:
        """The event that makes this new question necessary, or None; `sensed` is in the mission's frame [units]."""
        mission = question.mission
        if self.failed:
            return Trigger.NO_ANSWER
        if question.goal != self.question.goal and not self._serves_goal(question):
            return Trigger.NEW_GOAL if question.plan == self.question.plan else Trigger.NEW_PLAN
        if self.path and _at_goal(question, question.position):
            return None
        if self.altered:
            return Trigger.ALTERED
        if not self.path:
            return Trigger.USED_UP
        path = (question.position, *self.path)
        new = [obstacle for obstacle in mission.obstacles if obstacle not in self.question.mission.obstacles]
        if any(segment_clearance(a, b, new) < mission.body_radius for a, b in pairwise(path)):
            return Trigger.OBSTACLE
        entered = [position for robot, position in sensed.items() if robot not in self.in_sight]
        # Only the next step counts: a robot farther ahead will have moved by the time this one arrives.
        if any(passing(mission, position, *path[:2]) < mission.safe_distance for position in entered):
            return Trigger.NEIGHBOUR
        return None

    def _serves_goal(self, question: StepQuestion) -> bool:
        """Whether the next waypoint gains at least 0.8 of the best possible: goals change often while groups meet."""
        if not self.path:
            return False
        before = math.dist(question.position, question.goal)
        gained = before - math.dist(self.path[0], question.goal)
        return gained >= 0.8 * min(before, question.mission.max_step)


def _at_goal(question: StepQuestion, position: Point) -> bool:
    return math.dist(position, question.goal) <= AT_GOAL * question.mission.spacing


def _distance_to_path(path: tuple[Point, ...], point: Point) -> float:
    """Distance of a point from a path of two or more points [units]."""
    return min(math.dist(point, nearest_on_segment(point, a, b)) for a, b in pairwise(path))
