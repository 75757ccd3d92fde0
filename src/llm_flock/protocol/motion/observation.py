"""What a robot observes in a round."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from llm_flock.arrays import Point, moved
from llm_flock.protocol.messages.message import Course

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
