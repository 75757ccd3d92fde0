"""What a robot foresaw when it last asked its planner, and whether something has happened since that it did not.

A planner that answers with a path need not be asked every round. The robot flies the path, each step through its
checks and its shield as if it had just been asked for, and asks again on an event: event-triggered instead of periodic
control (Heemels, Johansson, Tabuada: An introduction to event-triggered and self-triggered control, CDC 2012).
"""

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
from llm_flock.obstacles import segment_clearance
from llm_flock.obstacles.polygons import nearest_on_segment
from llm_flock.protocol.planning import NoAnswer, StepAnswer, StepQuestion

HORIZON = 20
"""So many waypoints a planner may give at once."""

OFF = 0.25
"""A step that the shield turned aside by up to this share of `max_step` is still on the way that was foreseen."""

LATE = 0.75
"""And so is one that it cut short by up to this share."""

SAME_WAY = 0.8
"""A next waypoint that gains this share of what the best one could leads to another goal as well."""


class Reason(StrEnum):
    """Why a planner is asked again."""

    NO_ANSWER = "no_answer"
    NEW_PLAN = "new_plan"
    NEW_GOAL = "new_goal"
    ALTERED = "altered"
    USED_UP = "used_up"
    OBSTACLE = "obstacle"
    NEIGHBOUR = "neighbour"
    UNFIT = "unfit"


class CommittedPath(msgspec.Struct, frozen=True, kw_only=True):
    """The last question, and what is left of its answer.

    Attributes:
        question: what was known when the planner was asked.
        path: waypoints still to fly [units; frame of the mission]; one at the goal stays, and holds the robot there.
        failed: whether the planner had no answer, or a fallback stood in for it.
        altered: whether the last step was flown otherwise than foreseen, by more than a little.
        known: robots that were in sight then.
    """

    question: StepQuestion
    path: tuple[Point, ...]
    failed: bool
    altered: bool = False
    known: frozenset[int]

    @classmethod
    def of(cls, question: StepQuestion, answer: StepAnswer | NoAnswer, sensed: Mapping[int, Point]) -> Self:
        """What the answer to a question lets a robot foresee."""
        usable = isinstance(answer, StepAnswer)
        path = (answer.waypoint, *answer.path) if usable else ()
        return cls(
            question=question,
            path=path,
            failed=not usable or answer.instead_of is not None,
            known=frozenset(sensed),
        )

    @property
    def answer(self) -> StepAnswer:
        """What the planner would say now; call only where `surprise` finds nothing."""
        return StepAnswer(waypoint=self.path[0], path=self.path[1:])

    def flown(self, position: Point, waypoint: Point) -> Self:
        """What is left of the path after its first step, from `position`; the shield made `waypoint` of it."""
        if not self.path:
            return self
        off = _gap((position, *self.path), waypoint)
        late = math.dist(waypoint, self.path[0])
        max_step = self.question.mission.max_step
        altered = off > OFF * max_step or late > LATE * max_step
        ends = len(self.path) == 1 and _at_goal(self.question, self.path[0])
        return replace(self, altered=altered, path=self.path if ends else self.path[1:])

    def surprise(self, question: StepQuestion, sensed: Mapping[int, Point]) -> Reason | None:
        """What happened that was not foreseen, None if nothing did.

        Args:
            question: what the planner would be asked now.
            sensed: believed positions of the robots within sensing range, by id.
        """
        mission = question.mission
        if self.failed:
            return Reason.NO_ANSWER
        if question.goal != self.question.goal and not self._leads_there(question):
            return Reason.NEW_GOAL if question.plan == self.question.plan else Reason.NEW_PLAN
        if self.path and _at_goal(question, question.position):
            return None
        if self.altered:
            return Reason.ALTERED
        if not self.path:
            return Reason.USED_UP
        way = (question.position, *self.path)
        new = [obstacle for obstacle in mission.obstacles if obstacle not in self.question.mission.obstacles]
        if any(segment_clearance(a, b, new) < mission.body_radius for a, b in pairwise(way)):
            return Reason.OBSTACLE
        entered = [place for robot, place in sensed.items() if robot not in self.known]
        # Only the next step counts: who is farther ahead will have moved when this robot comes there.
        if any(_gap(way[:2], place) < mission.safe_distance for place in entered):
            return Reason.NEIGHBOUR
        return None

    def _leads_there(self, question: StepQuestion) -> bool:
        """Whether the next waypoint brings the robot nearer to another goal by almost as much as any could.

        Goals change often while groups meet, and many lie the same way: the robot asks when the ways part.
        """
        if not self.path:
            return False
        before = math.dist(question.position, question.goal)
        gained = before - math.dist(self.path[0], question.goal)
        return gained >= SAME_WAY * min(before, question.mission.max_step)


def _at_goal(question: StepQuestion, position: Point) -> bool:
    return math.dist(position, question.goal) <= AT_GOAL * question.mission.spacing


def _gap(way: tuple[Point, ...], point: Point) -> float:
    """Distance of a point from a way of two or more points [units]."""
    return min(math.dist(point, nearest_on_segment(point, a, b)) for a, b in pairwise(way))
