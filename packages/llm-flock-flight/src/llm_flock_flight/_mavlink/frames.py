"""Frames: the autopilot's (north, east, down) and the flight's world (east, north, up). The one place that converts.

An autopilot counts positions from an origin of its own, and every vehicle has another: the place where it was switched
on, or that of its first GPS fix. `LocalFrame` says where that origin lies in the world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from llm_flock.errors import InputError
from llm_flock.robots import Position

EQUATOR_M = 6_378_137.0
ECCENTRICITY_2 = 6.694_379_990_141_3e-3
"""Ellipsoid of WGS 84: the radius of the equator [m], and the square of the eccentricity."""

FARTHEST_M = 10_000.0
"""Farthest origin from the common one: up to there a plane stands for the Earth to within a few metres [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Geodetic:
    """A place on the Earth: latitude and longitude [degrees; WGS 84], altitude [m; above mean sea level]."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    def __post_init__(self) -> None:
        for field, value, most in (("latitude", self.latitude_deg, 85.0), ("longitude", self.longitude_deg, 180.0)):
            if not -most <= value <= most:
                raise InputError(field, value, f"degrees from -{most:g} to {most:g}")
        if not math.isfinite(self.altitude_m):
            raise InputError("altitude", self.altitude_m, "a number of metres")


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalFrame:
    """The autopilot's local frame, which has its zero at `origin` [m; world frame]."""

    origin: Position = (0.0, 0.0, 0.0)

    def to_world(self, ned: Position) -> Position:
        """A position of the autopilot, (north, east, down) [m], in the world [m]."""
        x, y, z = enu(ned)
        return (self.origin[0] + x, self.origin[1] + y, self.origin[2] + z)

    def to_ned(self, position: Position) -> Position:
        """A position of the world [m] as the autopilot counts it, (north, east, down) [m]."""
        x, y, z = (a - b for a, b in zip(position, self.origin, strict=True))
        return ned_of((x, y, z))


def enu(vector: Position) -> Position:
    """A vector (north, east, down) as (east, north, up): a velocity, or a difference of positions."""
    north, east, down = vector
    return (east, north, -down)


def ned_of(vector: Position) -> Position:
    """A vector (east, north, up) as (north, east, down)."""
    x, y, z = vector
    return (y, x, -z)


def between(origin: Geodetic, place: Geodetic) -> Position:
    """From an origin to a place: east, north, up [m] on the plane that touches the ellipsoid there; not too far."""
    sin = math.sin(math.radians(origin.latitude_deg))
    bend = 1.0 - ECCENTRICITY_2 * sin * sin
    meridian_m = EQUATOR_M * (1.0 - ECCENTRICITY_2) / bend**1.5
    parallel_m = EQUATOR_M / math.sqrt(bend) * math.cos(math.radians(origin.latitude_deg))
    turn_deg = (place.longitude_deg - origin.longitude_deg + 180.0) % 360.0 - 180.0
    east, north = (
        parallel_m * math.radians(turn_deg),
        meridian_m * math.radians(place.latitude_deg - origin.latitude_deg),
    )
    far = math.hypot(east, north)
    if far > FARTHEST_M:
        raise InputError("origin_lat_lon_alt", round(far), f"an origin within {FARTHEST_M:g} m of the vehicle")
    return (east, north, place.altitude_m - origin.altitude_m)
