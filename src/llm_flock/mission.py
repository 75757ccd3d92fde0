"""What a team is asked to do: validated, immutable, the same object for every part of the system."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sized
from functools import cached_property, lru_cache
from typing import Annotated, Any, Self, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from llm_flock import formations
from llm_flock.arrays import MAX_COORDINATE, Point, Points
from llm_flock.errors import InputError
from llm_flock.obstacles import Obstacle, clearance

MIN_LENGTH = 1e-3
"""Smallest length that a mission may ask for [units]: plans are rounded to a thousandth of it."""

MAX_ROBOTS = 2_000
"""Most robots of a mission. The figures of a run are exact and look at all pairs of robots: at 1,000 robots the shape
error of one round takes a minute, and it grows with about the third power."""

Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=MIN_LENGTH, allow_inf_nan=False)]

ORIENTATIONS = 72
"""In so many turns of the shape room among the obstacles is looked for."""
SAFETY_FIELDS = ("n_robots", "safe_distance", "max_step", "comm_range", "sense_range", "arena", "obstacles")
"""What a robot knows of itself and its surroundings: no mission that comes over the radio may change it."""
START_DENSITY = 0.35
"""Largest share of the arena that discs of the safe distance may cover, so that random starts can be drawn."""


def start_volume(n_robots: int, dim: int, safe_distance: float) -> float:
    """Volume of the smallest arena in which that many random starts, safe_distance apart, are drawn [units^dim]."""
    ball = math.pi ** (dim / 2) / math.gamma(dim / 2 + 1) * (safe_distance / 2) ** dim
    return n_robots * ball / START_DENSITY


class Mission(BaseModel):
    """A formation to build, the team that builds it, and the limits it must respect.

    Defaults are the paper's (section 4: spacing 10, safe distance 3, 6 units a round, radio range 15,
    arena 100 x 100, centre [50, 50]). Lengths are in mission units, in the world frame.

    Raises:
        ValidationError: pydantic's, where a field by itself is wrong (`Mission(n_robots=0)`).
        InputError: where fields do not go together. `build_mission` raises this one for both.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    shape: str = Field(
        default="circle", description="Named shape, optionally with an argument: circle, polygon:5, text:..."
    )
    n_robots: int = Field(default=10, ge=1, le=MAX_ROBOTS, description="Number of robots N")
    places: int | None = Field(
        default=None, ge=1, le=MAX_ROBOTS, description="Places of the formation; one for each robot if unset"
    )
    center: tuple[Coordinate, ...] = Field(default=(50.0, 50.0), description="Centre of the formation [units]")
    velocity: tuple[Coordinate, ...] | None = Field(
        default=None, description="Velocity of the centre [units per round]; it stands still if unset"
    )
    since: int = Field(default=0, ge=0, description="Round in which a moving centre is at `center`")
    spacing: Length = Field(default=10.0, description="Desired distance between neighbouring robots d_d [units]")
    safe_distance: Length = Field(
        default=3.0, description="Smallest distance allowed between any two robots d_s [units]"
    )
    max_step: Length = Field(default=6.0, description="Longest move in one round v_m [units]")
    comm_range: Length = Field(default=15.0, description="Radio range r_comm [units]")
    sense_range: Length | None = Field(
        default=None, description="Range of the position sensors [units]; comm_range if unset"
    )
    arena: tuple[tuple[Coordinate, ...], tuple[Coordinate, ...]] = Field(
        default=((0.0, 0.0), (100.0, 100.0)), description="Lower and upper corner of the flight space [units]"
    )
    points: tuple[tuple[Coordinate, ...], ...] | None = Field(
        default=None, description="Target points of the shape 'points' [units], used relative to their own mean"
    )
    obstacles: tuple[Obstacle, ...] = Field(
        default=(), description="Discs {center, radius} and polygons {polygon: corners} that robots keep clear of"
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_points(cls, data: Any) -> Any:
        """`points` alone says what the shape is, how many places it has, and, unless given, how many robots."""
        if not isinstance(data, dict):
            return data
        given = cast("dict[str, Any]", data)
        points = given.get("points")
        if not isinstance(points, Sized):
            return given  # nothing was given, or what the field itself will refuse
        if not len(points):
            raise InputError("points", points, "at least one point")
        filled = {"shape": "points", "n_robots": len(points), **given}
        if filled.get("places") is None and filled["n_robots"] != len(points):
            filled["places"] = len(points)
        return filled

    @model_validator(mode="after")
    def _check(self) -> Self:
        low, high = self.arena
        dim = len(self.center)
        if not 2 <= dim <= 3:
            raise InputError("center", list(self.center), "2 or 3 coordinates")
        if len(low) != dim or len(high) != dim or any(a >= b for a, b in zip(low, high, strict=True)):
            raise InputError("arena", [list(low), list(high)], f"two corners of {dim} numbers, each lower < upper")
        if any(not a <= c <= b for a, c, b in zip(low, self.center, high, strict=True)):
            raise InputError("center", list(self.center), f"inside the arena {list(low)} .. {list(high)}")
        if self.spacing < self.safe_distance:
            raise InputError("spacing", self.spacing, f"at least safe_distance = {self.safe_distance:g}")
        self._check_velocity()
        self._check_room()
        self.check_shape()
        self._check_obstacles()
        return self

    def _check_velocity(self) -> None:
        """Robots must be able to catch up with their places."""
        if self.velocity is None:
            return
        if len(self.velocity) != self.dim:
            raise InputError("velocity", list(self.velocity), f"{self.dim} numbers, as the centre has")
        speed = math.hypot(*self.velocity)
        if speed > self.max_step / 2 + 1e-9:
            raise InputError(
                "velocity",
                list(self.velocity),
                f"at most max_step / 2 = {self.max_step / 2:g} a round, so that robots can catch up with their places "
                f"(here {speed:.4g})",
            )

    def _check_room(self) -> None:
        """Random starts at least `safe_distance` apart must exist, and be found by drawing."""
        low, high = self.arena
        volume = math.prod(b - a for a, b in zip(low, high, strict=True))
        most = max(1, int(volume / start_volume(1, len(low), self.safe_distance)))
        if self.n_robots > most:
            raise InputError(
                "n_robots", self.n_robots, f"at most {most} with safe_distance = {self.safe_distance:g} in this arena"
            )

    def check_shape(self) -> None:
        """Raise InputError unless the shape exists for that number, keeps the safe distance, and fits the arena."""
        if (self.points is not None) != (formations.shape_name(self.shape) == "points"):
            raise InputError("points", "given" if self.points else "missing", "points together with shape 'points'")
        if self.points is not None and any(len(p) != len(self.center) for p in self.points):
            raise InputError("points", f"{len(self.points)} rows", f"{len(self.center)} coordinates in each row")
        ideal = self._ideal_points()
        if ideal is None:
            return
        nearest = formations.smallest_distance(ideal)
        if nearest < self.safe_distance - 1e-9:
            raise InputError(
                "shape", self.shape, f"points at least safe_distance = {self.safe_distance:g} apart, not {nearest:.3g}"
            )
        reach = formations.circumradius(ideal, self.center)
        low, high = self.arena
        room = min(min(c - a, b - c) for a, c, b in zip(low, self.center, high, strict=True))
        if reach > room + 1e-9:
            raise InputError(
                "arena",
                [list(low), list(high)],
                f"at least {reach:.4g} units from center to every wall: '{self.shape}' of {self.n_places} "
                f"{'robots' if self.places is None else 'places'} with spacing {self.spacing:g} reaches that far "
                f"(here {room:.4g})",
            )

    def _check_obstacles(self) -> None:
        """Obstacles must be of this space, and leave the shape room in some orientation."""
        for obstacle in self.obstacles:
            if obstacle.dim != self.dim:
                allowed = f"{self.dim} coordinates, as the centre has"
                raise InputError("obstacles", obstacle.model_dump(exclude_none=True), allowed)
        if not self.obstacles or self.ideal is None:
            return
        points = np.array(self.ideal)
        for k in range(ORIENTATIONS):
            turned = points.copy()
            turned[:, :2] = formations.rotated(points[:, :2], self.center[:2], 2 * math.pi * k / ORIENTATIONS)
            if all(clearance(tuple(row), self.obstacles) >= self.body_radius for row in turned.tolist()):
                return
        raise InputError(
            "obstacles",
            f"{len(self.obstacles)} obstacles",
            f"room for '{self.shape}' around the centre in some orientation, every place at least "
            f"safe_distance / 2 = {self.body_radius:g} from every obstacle",
        )

    def _ideal_points(self) -> Points | None:
        """What `ideal` gives, shape (n_places, d); what the shape says against a number is said of the right field."""
        try:
            return formations.ideal_points(self.shape, self.n_places, self.center, self.spacing, self.points)
        except InputError as error:
            if error.field != "n_robots" or self.places is None:
                raise
            raise InputError("places", error.value, error.allowed) from None

    @property
    def n_places(self) -> int:
        """How many places the formation has: fewer than robots leave spares, more leave gaps."""
        return self.n_robots if self.places is None else self.places

    @property
    def body_radius(self) -> float:
        """How far the centre of a robot stays from obstacles: half the safe distance [units]."""
        return self.safe_distance / 2

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Mission) and self.digest == other.digest)

    @cached_property
    def dim(self) -> int:
        """Dimension d of space."""
        return len(self.center)

    @property
    def sensing(self) -> float:
        """Range of the position sensors [units]."""
        return self.comm_range if self.sense_range is None else self.sense_range

    @cached_property
    def ideal(self) -> tuple[Point, ...] | None:
        """Ideal target points of the shape in its reference orientation, or None where none is known."""
        points = self._ideal_points()
        return None if points is None else tuple(tuple(float(x) for x in row) for row in points)

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits that stand for the content of this mission."""
        return hashlib.blake2b(self.model_dump_json().encode(), digest_size=8).hexdigest()

    @cached_property
    def travel_rounds(self) -> float:
        """After so many rounds the formation stops at a wall; infinite for a centre that stands still."""
        if self.velocity is None:
            return math.inf
        reach = 0.0 if self.ideal is None else formations.circumradius(self.ideal, self.center)
        low, high = self.arena
        room = [
            (b - reach - c) / v if v > 0 else (c - reach - a) / -v
            for a, c, b, v in zip(low, self.center, high, self.velocity, strict=True)
            if v != 0
        ]
        return max(0.0, min(room, default=math.inf))

    def drift(self, round_: int) -> Point:
        """How far the centre is from `center` at the end of a round [units].

        The formation stops as a whole where the circle around its shape would touch a wall.
        """
        if self.velocity is None:
            return (0.0,) * self.dim
        rounds = min(max(0, round_ - self.since), self.travel_rounds)
        return tuple(rounds * v for v in self.velocity)

    def at(self, round_: int) -> Mission:
        """The same mission as it is at the end of a round: `center` is where the centre is then, `since` is that round.

        Where the formation has stopped at a wall, it has no velocity any more. A mission that stands still is its own.
        """
        return self if self.velocity is None else _at(self, round_)

    def resized(self, places: int) -> Mission:
        """The same mission for a plan of so many places.

        A formation of another size stops elsewhere at a wall: of a moving one, this is about the size alone.

        Raises:
            InputError: the shape does not exist for that number, or it does not fit.
        """
        return self if places == self.n_places else _resized(self, places)

    def change(self, **fields: Any) -> Mission:
        """A changed mission, validated as a whole. New points make the shape `points`, a new shape drops the points.

        Raises:
            InputError: naming the first offending field, its value, and what is allowed.
        """
        changed = {**self.model_dump(), **fields}
        if fields.get("points") is not None:
            changed["shape"] = fields.get("shape", "points")
            changed["places"] = fields.get("places")
        elif "shape" in fields and fields["shape"] != self.shape:
            changed["points"] = None
        return build_mission(**changed)

    def refuses(self, new: Mission) -> str | None:
        """Why a mission that came over the radio may not replace this one, or None.

        Shape, places, centre, spacing and velocity are the operator's to change; a robot's limits and surroundings
        are its own.
        """
        if new.dim != self.dim:
            return f"it has {new.dim} dimensions, not {self.dim}"
        for field in SAFETY_FIELDS:
            if getattr(new, field) != getattr(self, field):
                return f"it changes {field}, which is not up to a mission"
        return None

    def check_sensing(self) -> None:
        """Raise InputError unless the safety shield's proof holds: no robot may appear out of nowhere in one round.

        Two robots that do not see each other close in by at most 2 * max_step, so
        sense_range >= safe_distance + 2 * max_step (Zhou et al. 2017, lockstep form).
        """
        needed = self.safe_distance + 2 * self.max_step
        if self.sensing < needed:
            raise InputError(
                "sense_range",
                self.sensing,
                f"at least safe_distance + 2 * max_step = {needed:g} while the shield is on "
                "(raise sense_range or comm_range, lower max_step, or switch the shield off)",
            )


@lru_cache(maxsize=256)
def _at(mission: Mission, round_: int) -> Mission:
    """`Mission.at`, without validation: what was valid stays so on the way, and nothing cached is taken on."""
    center = tuple(c + d for c, d in zip(mission.center, mission.drift(round_), strict=True))
    stopped = round_ - mission.since >= mission.travel_rounds
    fields: dict[str, Any] = {name: getattr(mission, name) for name in Mission.model_fields}
    fields.update(center=center, since=max(round_, mission.since))
    if stopped:
        fields.update(velocity=None, since=0)
    return Mission.model_construct(**fields)


@lru_cache(maxsize=256)
def _resized(mission: Mission, places: int) -> Mission:
    fields: dict[str, Any] = {name: getattr(mission, name) for name in Mission.model_fields}
    fields["places"] = None if places == mission.n_robots else places
    resized = Mission.model_construct(**fields)
    # Nothing but the shape depends on the number; obstacles may be anywhere once a formation travels.
    resized.check_shape()
    return resized


def build_mission(**fields: Any) -> Mission:
    """A `Mission` from plain values.

    Raises:
        InputError: naming the first offending field, its value, and what is allowed.
    """
    try:
        return Mission(**fields)
    except ValidationError as error:
        raise input_error(error) from None


def input_error(error: ValidationError) -> InputError:
    """The first fault of a pydantic validation as this package's own error.

    The field is named without its section, as flags and our own checks name it; an index in it is kept: `center.1`.
    """
    first = error.errors(include_url=False)[0]
    place = list(first["loc"])
    while len(place) > 1 and isinstance(place[0], str) and isinstance(place[1], str):
        del place[0]
    field = ".".join(map(str, place)) or "value"
    return InputError(field, first.get("input"), first["msg"])
