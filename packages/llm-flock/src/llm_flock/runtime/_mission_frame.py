"""The place of a mission in the world: converts its units to metres and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, TypeAlias

from pydantic import Field

from llm_flock.arrays import Point
from llm_flock.robots._base import Position
from llm_flock.runtime._config import ConfigSection, metres

Metres: TypeAlias = Annotated[float, Field(ge=-1000, le=1000, allow_inf_nan=False)]  # a coordinate in the world [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionFrame:
    """Position, orientation and scale of a mission in the world; a mission in the plane is flown at one altitude."""

    anchor: Point  # point of the mission that lies at the origin, d coordinates [units]
    scale_m: float  # one unit [m]
    yaw: float  # from the mission's x axis to the world's, counterclockwise [rad]
    origin: tuple[float, float]  # of the plane [m; world frame]
    altitude_m: float  # z of the anchor, and of every point of a mission in the plane [m; world frame]

    def to_world(self, point: Point) -> Position:
        """A point of the mission in the world [m]."""
        dx, dy = ((x - a) * self.scale_m for x, a in zip(point[:2], self.anchor[:2], strict=True))
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        rise = (point[2] - self.anchor[2]) * self.scale_m if len(point) > 2 else 0.0
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
        return (*plane, self.anchor[2] + (position[2] - self.altitude_m) / self.scale_m)


class WorldConfig(ConfigSection):
    """Place of the mission in the world frame of the localisation system, z up."""

    scale_m: float = metres(0.1, "Length of one mission unit")
    yaw_deg: float = Field(
        default=0.0, ge=-360, le=360, description="The mission's x axis in the world, counterclockwise [degrees]"
    )
    origin_m: tuple[Metres, Metres] = Field(
        default=(0.0, 0.0), description="Middle of the arena in the world, x and y [m]"
    )
    altitude_m: float = metres(1.0, "Height of a mission in the plane, or of the middle of the arena: z")
    floor_m: Metres = Field(default=0.0, description="Height of the floor: z [m]")
    geofence: tuple[tuple[Metres, Metres, Metres], tuple[Metres, Metres, Metres]] = Field(
        default=((-6.0, -6.0, -0.5), (6.0, 6.0, 2.5)),
        description="Lower and upper corner of the box that no drone may leave, in the world [m]",
    )

    def frame(self, low: Point, high: Point) -> MissionFrame:
        """A mission in the world, by the corners of its arena [units]."""
        return MissionFrame(
            anchor=tuple((a + b) / 2 for a, b in zip(low, high, strict=True)),
            scale_m=self.scale_m,
            yaw=math.radians(self.yaw_deg),
            origin=self.origin_m,
            altitude_m=self.altitude_m,
        )
