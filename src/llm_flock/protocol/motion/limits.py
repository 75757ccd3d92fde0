"""The limits on a robot's motion: its own and those of its surroundings, fixed for a whole run."""

from __future__ import annotations

from typing import Self

import msgspec

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """The part of a mission that limits the robot's motion: no mission received by radio changes it.

    Attributes:
        safe_distance: smallest distance between the centres of two robots d_s [units].
        max_step: longest move in one round v_m [units].
        body_radius: smallest distance of the robot's centre from an obstacle [units].
        arena: lower and upper corner of the flight space [units; world frame].
        obstacles: obstacles in the flight space.
    """

    safe_distance: float
    max_step: float
    body_radius: float
    arena: tuple[Point, Point]
    obstacles: tuple[Obstacle, ...]

    @classmethod
    def of(cls, mission: Mission) -> Self:
        """The limits that a mission sets. Call once, when the robot starts."""
        return cls(
            safe_distance=mission.safe_distance,
            max_step=mission.max_step,
            body_radius=mission.body_radius,
            arena=mission.arena,
            obstacles=mission.obstacles,
        )
