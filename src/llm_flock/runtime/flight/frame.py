"""Where a mission lies in the world: from its units to metres, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

from llm_flock.arrays import Point
from llm_flock.robots.base import Position


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionFrame:
    """Position, orientation and scale of a mission in the world.

    A mission in the plane is flown at one altitude. In space, z is scaled by `stretch` more than x and y, so that the
    sphere of the safe distance becomes an ellipsoid that is higher by as much: downwash reaches far down.

    Attributes:
        anchor: point of the mission that lies at the origin, d coordinates [units].
        scale_m: one unit in the plane [m].
        stretch: one unit of height over one unit in the plane, in metres.
        yaw: from the mission's x axis to the world's, counterclockwise [rad].
        origin: of the plane [m; world frame].
        altitude_m: z of the anchor, and of every point of a mission in the plane [m; world frame].
    """

    anchor: Point
    scale_m: float
    stretch: float
    yaw: float
    origin: tuple[float, float]
    altitude_m: float

    def to_world(self, point: Point) -> Position:
        """A point of the mission in the world [m]."""
        dx, dy = ((x - a) * self.scale_m for x, a in zip(point[:2], self.anchor[:2], strict=True))
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        rise = (point[2] - self.anchor[2]) * self.scale_m * self.stretch if len(point) > 2 else 0.0
        return (self.origin[0] + cos * dx - sin * dy, self.origin[1] + sin * dx + cos * dy, self.altitude_m + rise)

    def to_mission(self, position: Position) -> Point:
        """A position of the world in the mission [units]; a mission in the plane drops the altitude."""
        east, north = position[0] - self.origin[0], position[1] - self.origin[1]
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        plane = (
            self.anchor[0] + (cos * east + sin * north) / self.scale_m,
            self.anchor[1] + (-sin * east + cos * north) / self.scale_m,
        )
        if len(self.anchor) == 2:
            return plane
        return (*plane, self.anchor[2] + (position[2] - self.altitude_m) / (self.scale_m * self.stretch))
