"""The mission: a validated, immutable description of the formation, the team, and the team's limits."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sized
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from llm_flock import shapes as formations
from llm_flock.arrays import MAX_COORDINATE, Pairwise, Point, Points, flattened, separation
from llm_flock.bounds import (
    MAX_CORNERS,
    MAX_LENGTH,
    MAX_OBSTACLES,
    MAX_ROBOTS,
    MAX_ROUNDS,
    MIN_LENGTH,
    max_places,
    mission_room,
)
from llm_flock.errors import InputError
from llm_flock.obstacles import Obstacle, clearance
from llm_flock.printable import hidden, shape_title
from llm_flock.validation import checked

if TYPE_CHECKING:
    from llm_flock.roadmap import Roadmap  # imported where it is used: few missions have obstacles

Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=MIN_LENGTH, le=MAX_LENGTH, allow_inf_nan=False)]

ORIENTATIONS = 72  #: Number of evenly spaced orientations in which the shape is tried among the obstacles.

CENTER_TOLERANCE = 0.05
"""Largest distance of the mean of a plan's places from the centre, as a share of the spacing: half a unit at the
paper's spacing of 10, the largest error of whole-number coordinates. The shape does not depend on it."""

SHIFTS = 8  #: Directions in which the shape is also shifted, by a little less than that, if no orientation fits.

OPTIONAL: Mapping[str, Any] = {"turn": None, "hold": 0, "prefer": (), "then": ()}
"""Fields that are left out of JSON, and of a digest, where they have these values."""

MISSION_FIELDS = frozenset({"shape", "points", "center", "spacing", "places", "velocity", "since", *OPTIONAL})
"""Fields that travel by radio. All other fields belong to the robot, and no message changes them."""

MAX_STAGES = 20  #: Most stages of a mission: each is checked with all that follow.

MAX_DOWNWASH = 3.7  #: Largest `downwash` for which docs/explanation/theory.md proves the shield with late positions.

START_DENSITY = 0.35  #: Largest share of the arena under discs of the safe distance, so that starts can be drawn.


def optional(name: str, description: str) -> Any:
    """A field that is left out of JSON where it has its value of `OPTIONAL`."""
    return Field(default=OPTIONAL[name], exclude_if=lambda value: value == OPTIONAL[name], description=description)


class Preference(BaseModel):
    """Which robots should take which places.

    With `group`, a group of the program gets this robot, or those farthest to the `side`. With `way`, a robot gets a
    short way, or a place near the centre or far from it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    robot: int | None = Field(default=None, ge=0, lt=MAX_ROBOTS)
    side: Literal["west", "east", "north", "south"] | None = None
    group: int | None = Field(default=None, ge=0)
    way: Literal["shortest", "center", "edge"] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = {name for name, value in self if value is not None}
        if given not in ({"robot", "group"}, {"side", "group"}, {"robot", "way"}):
            raise InputError("prefer", sorted(given), "robot and group, side and group, or robot and way")
        return self


class Stage(BaseModel):
    """A later stage of a mission: the fields that it changes, and when the team goes on to it.

    `formed`: when a robot sees that the team has formed. `order`: on an operator's order. A number: in this round.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    set: dict[str, Any]
    when: Literal["formed", "order"] | Annotated[int, Field(ge=1, le=MAX_ROUNDS)] = "formed"


class Mission(BaseModel):
    """A formation to build, the team that builds it, and the limits that the team must respect.

    The defaults are those of the paper (section 4: spacing 10, safe distance 3, 6 units per round, radio range 15,
    arena 100 x 100, centre [50, 50]). Lengths are in mission units, positions in the world frame.

    Raises:
        ValidationError: a single field is invalid (`Mission(n_robots=0)`); raised by pydantic.
        InputError: fields contradict each other. `build_mission` raises InputError in both cases.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    shape: str = Field(
        default="circle", description="Named shape, optionally with an argument: circle, polygon:5, text:..."
    )
    n_robots: int = Field(
        default=10, ge=1, le=MAX_ROBOTS, description="Number of robots N", json_schema_extra={"flag": "robots"}
    )
    places: int | None = Field(
        default=None, ge=1, le=MAX_ROBOTS, description="Number of places in the formation; one per robot if unset"
    )
    center: tuple[Coordinate, ...] = Field(default=(50.0, 50.0), description="Centre of the formation [units]")
    velocity: tuple[Coordinate, ...] | None = Field(
        default=None, description="Velocity of the centre [units per round]; the formation stands still if unset"
    )
    since: int = Field(default=0, ge=0, description="Round at which a moving formation's centre is at `center`")
    spacing: Length = Field(default=10.0, description="Desired distance between neighbouring robots d_d [units]")
    safe_distance: Length = Field(default=3.0, description="Smallest allowed distance between two robots d_s [units]")
    downwash: Annotated[float, Field(ge=1, le=MAX_DOWNWASH)] = Field(
        default=1.0,
        exclude_if=lambda value: value == 1.0,
        description="In space, how many times the safe distance applies to robots above each other: 2 to 3 for rotors",
    )
    max_step: Length = Field(default=6.0, description="Longest move in one round v_m [units]")
    comm_range: Length = Field(default=15.0, description="Radio range r_comm [units]")
    sense_range: Length | None = Field(
        default=None, description="Range of the position sensors [units]; comm_range if unset"
    )
    arena: tuple[tuple[Coordinate, ...], tuple[Coordinate, ...]] = Field(
        default=((0.0, 0.0), (100.0, 100.0)), description="Lower and upper corners of the flight space [units]"
    )
    points: tuple[tuple[Coordinate, ...], ...] | None = Field(
        default=None, description="Target points of the shape 'points' [units]; only their relative positions matter"
    )
    obstacles: tuple[Obstacle, ...] = Field(
        default=(), description="Discs {center, radius} and polygons {polygon: corners} that robots must avoid"
    )
    turn: Annotated[float, Field(ge=-360, le=360)] | None = optional(
        "turn", "Orientation of the formation, anticlockwise from that of the shape [degrees]; any if unset"
    )
    hold: Annotated[int, Field(ge=0, le=MAX_ROUNDS)] = optional(
        "hold", "Rounds for which the team stays formed, before the next stage or the end"
    )
    prefer: Annotated[tuple[Preference, ...], Field(max_length=100)] = optional(
        "prefer", "Who takes which place: {robot, group}, {side, group} or {robot, way: shortest, center or edge}"
    )
    then: Annotated[tuple[Stage, ...], Field(max_length=MAX_STAGES)] = optional(
        "then", "Stages that follow: {set: {field: value, ...}, when: formed, order or a round}"
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_points(cls, data: Any) -> Any:
        """Derive the shape, the number of places and, unless given, the number of robots from `points`."""
        if not isinstance(data, dict):
            return data
        given = cast("dict[str, Any]", data)
        shape, points = given.get("shape"), given.get("points")
        if isinstance(shape, str) and shape.startswith("program:"):
            from llm_flock.formation import program_of

            program = program_of(shape)
            given = given | {"shape": program.spec if program else shape}  # equal programs are equal missions
        if isinstance(shape, str) and not given.keys() & {"center", "arena"} and formations.in_space(shape):
            given = given | {"center": (50.0,) * 3, "arena": ((0.0,) * 3, (100.0,) * 3)}
        if not isinstance(points, Sized):
            return given  # absent, or of a type that the field's own validation rejects
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
            raise InputError("center", list(self.center), f"a point inside the arena {list(low)} .. {list(high)}")
        if self.spacing < self.safe_distance:
            raise InputError("spacing", self.spacing, f"at least safe_distance = {self.safe_distance:g}")
        if self.downwash != 1.0 and dim == 2:
            raise InputError("downwash", self.downwash, "1 in the plane, where no robot is above another")
        if (letter := hidden(self.shape)) is not None:
            raise InputError("shape", self.shape, f"visible letters only, not {letter!a}")
        self._check_velocity()
        self._check_room()
        self.check_shape()
        self._check_obstacles()
        self._check_optional()
        return self

    def _check_velocity(self) -> None:
        """Check that robots can catch up with their moving places."""
        if self.velocity is None:
            return
        if len(self.velocity) != self.dim:
            raise InputError("velocity", list(self.velocity), f"{self.dim} numbers, as the centre has")
        speed, most = math.hypot(*self.velocity), self.max_step / 2
        if speed > most + 1e-9:
            why = f"so that robots can catch up with their places (here {speed:.4g})"
            raise InputError("velocity", list(self.velocity), f"at most max_step / 2 = {most:g} per round, {why}")

    def _check_optional(self) -> None:
        """Check orientation and preferences, and build all later stages."""
        if self.turn is not None and self.ideal is None:
            raise InputError(
                "turn", self.turn, says="has no effect on a shape in words: say in the words where it points"
            )
        groups = 1
        if self.prefer and formations.is_drawn(self.shape):
            from llm_flock.formation import program_of

            groups = len(getattr(program_of(self.shape), "groups", None) or (self.shape,))
        for one in self.prefer:
            if (one.robot or 0) >= self.n_robots or (one.group or 0) >= groups:
                allowed = f"robots from 0 to {self.n_robots - 1}, and groups from 0 to {groups - 1}"
                raise InputError("prefer", one.model_dump(exclude_none=True), allowed)
        if self.then:
            self.following()

    def following(self, round_: int = 0) -> Mission:
        """The next stage, if the team goes on to it at the start of a round.

        Raises:
            InputError: it is no valid mission, or names a field that does not travel by radio.
        """
        return _following(self, round_)

    def proceeding(self) -> dict[str, Any]:
        """The fields of an order to go on to the next stage now; InputError if none is left."""
        if not self.then:
            raise InputError("then", None, says="no stage of the mission is left")
        return self.following().order(self, self.then[0].set)

    def order(self, base: Mission, given: Iterable[str]) -> dict[str, Any]:
        """The order to fly this mission, made of `base`, as plain values for JSON, whatever is flown by then.

        Only a formation that travels goes on from where it is by then, unless its centre is `given`.
        """
        kept = {"since"} if base.velocity is None or "center" in given else {"since", "center"}
        return {**OPTIONAL, **self.model_dump(mode="json", include={*MISSION_FIELDS, *given} - kept)}

    def _check_room(self) -> None:
        """Check that messages have room for the mission, and the arena for random starts `safe_distance` apart."""
        team = f"for {self.n_robots} robots: their messages have room for no more"
        if self.n_places > (most := max_places(self.n_robots, self.dim)):
            raise InputError("places", self.n_places, f"at most {most} {team}")
        most = mission_room(self.n_robots, self.n_places, self.dim) - len(mission_text(self).encode())
        if most < 0:
            sizes = {name: len(self.model_dump_json(include={name}).encode()) for name in MISSION_FIELDS}
            long = max(("shape", "points", "then", "prefer"), key=sizes.__getitem__)
            size = sizes[long]
            room = f"at most {size + most:,} bytes of JSON" if size + most > 0 else f"less than {size:,} bytes of JSON"
            says = f"{room} with {self.n_places} places {team} (here {size:,})"
            raise InputError(long, None, says)
        low, high = self.arena
        volume = math.prod(b - a for a, b in zip(low, high, strict=True))
        most = max(1, int(volume / self.start_volume(1)))
        if self.n_robots > most:
            allowed = f"at most {most} with safe_distance = {self.safe_distance:g} in this arena"
            raise InputError("n_robots", self.n_robots, allowed)

    def check_shape(self) -> None:
        """Check the shape alone. Call after a change of `places`; the constructor calls it too.

        Raises:
            InputError: the shape does not exist for this number of places, violates the safe distance, or does not
                fit into the arena.
        """
        if (self.points is not None) != (formations.shape_name(self.shape) == "points"):
            says = "given, although the shape is another; they belong to shape 'points'"
            if not self.points:
                says = "none given, although the shape is 'points'; on the command line, --shape points:FILE"
            raise InputError("points", None, says=says)
        if self.points is not None and any(len(p) != len(self.center) for p in self.points):
            raise InputError("points", f"{len(self.points)} rows", f"{len(self.center)} coordinates in each row")
        if self.ideal is None:
            return
        nearest = formations.smallest_distance(flattened(self.ideal, self.downwash))
        if nearest < self.safe_distance - 1e-9:
            allowed = f"points at least safe_distance = {self.safe_distance:g} apart{self.by_height}, not {nearest:.3g}"
            raise InputError("shape", self.shape, allowed)
        if formations.is_drawn(self.shape) and (gap := formations.widest_gap(self.ideal)) > self.comm_range + 1e-9:
            says = f"at least {gap:.4g}, so that all robots of '{shape_title(self.shape)}' hear each other"
            raise InputError("comm_range", self.comm_range, f"{says}; more robots or less spacing would do, too")
        low, high = self.arena
        least, most = self._extent
        if self.turn is not None:
            if not all(a <= x + 1e-9 and y <= b + 1e-9 for a, b, x, y in zip(low, high, least, most, strict=True)):
                spans = (
                    f"one that holds {[round(x, 2) for x in least]} .. {[round(x, 2) for x in most]}, all its places"
                )
                raise InputError("arena", [list(low), list(high)], spans)
            return
        reach = formations.circumradius(self.ideal, self.center)
        room = min(min(c - a, b - c) for a, c, b in zip(low, self.center, high, strict=True))
        if reach > room + 1e-9:
            size = f"{self.n_places} {'robots' if self.places is None else 'places'} with spacing {self.spacing:g}"
            shape = f"'{shape_title(self.shape)}' of {size}"
            needed = f"at least {reach:.4g} units from center to every wall, the radius of {shape}"
            raise InputError("arena", [list(low), list(high)], f"{needed} (here {room:.4g})")

    def _check_obstacles(self) -> None:
        """Check that obstacles have the mission's dimension and leave room for the shape in some orientation."""
        corners = sum(len(obstacle.polygon or ()) for obstacle in self.obstacles)
        if len(self.obstacles) > MAX_OBSTACLES or corners > MAX_CORNERS:
            says = f"at most {MAX_OBSTACLES} obstacles, whose polygons have at most {MAX_CORNERS:,} corners in all"
            raise InputError("obstacles", f"{len(self.obstacles)} obstacles with {corners} corners", says)
        for obstacle in self.obstacles:
            if obstacle.dim != self.dim:
                allowed = f"{self.dim} coordinates, as the centre has"
                raise InputError("obstacles", obstacle.model_dump(exclude_none=True), allowed)
        if not self.obstacles or self.ideal is None:
            return
        if next(self.placements(), None) is None:
            shape = shape_title(self.shape)
            room = f"obstacles that leave room for '{shape}' around the centre in some orientation"
            clear = f"with every place at least safe_distance / 2 = {self.body_radius:g} from every obstacle"
            raise InputError(
                "obstacles", f"{len(self.obstacles)} obstacles", f"{room}, {clear}, and a way between any two"
            )

    def placements(self, angle_rad: float = 0.0) -> Iterator[tuple[float, Point]]:
        """Turns [rad] and shifts [units] of the ideal points that keep clear of obstacles; none without an ideal.

        The first is turned about the centre by `angle_rad`. Then come `ORIENTATIONS` evenly spaced steps, then the same
        slightly shifted. Without obstacles, all orientations come.
        """
        if self.ideal is None:
            return
        reach = 0.9 * CENTER_TOLERANCE * self.spacing
        around = [2 * math.pi * k / SHIFTS for k in range(SHIFTS)] if self.obstacles else []
        turns, angle_rad = (ORIENTATIONS, angle_rad) if self.turn is None else (1, 0.0)
        for shift in ((0.0, 0.0), *((reach * math.cos(a), reach * math.sin(a)) for a in around)):
            for k in range(turns):
                turn_rad = angle_rad + 2 * math.pi * k / ORIENTATIONS
                rows: list[list[float]] = self.placed(turn_rad, shift).tolist()
                fits = all(clearance(tuple(row), self.obstacles) >= self.body_radius for row in rows)
                if fits and len(self.regions_of(map(tuple, rows))) <= 1:
                    yield turn_rad, shift

    def placed(self, turn_rad: float, shift: Point = (0.0, 0.0)) -> Points:
        """The ideal points turned about the centre, in space about the third axis, then moved in the plane [units]."""
        points = formations.rotated(self.ideal or (), self.center, turn_rad)
        points[:, :2] += np.array(shift)
        return points

    def regions_of(self, points: Iterable[Point]) -> frozenset[int]:
        """Regions of the plane between obstacles and walls in which these points are; robots cannot change regions.

        Empty without obstacles and in space, where robots can reach every point.
        """
        if not self.obstacles or self.dim != 2:
            return frozenset()
        from llm_flock.roadmap import free_regions, region_of

        regions = free_regions(self.arena, self.obstacles, self.body_radius)
        return frozenset(region_of(point, regions) for point in points)

    @property
    def roadmap(self) -> Roadmap | None:
        """The ways round the obstacles [world frame]; None without any."""
        if not self.obstacles:
            return None
        from llm_flock.roadmap import roadmap_of

        return roadmap_of(self.arena, self.obstacles, self.body_radius)

    def shortest_ways(self, starts: Points, goals: Points) -> Pairwise:
        """As `llm_flock.roadmap.shortest_ways`, among the obstacles of this mission."""
        if not self.obstacles:
            return np.linalg.norm(starts[:, None] - goals[None], axis=2)
        from llm_flock.roadmap import shortest_ways

        return shortest_ways(self.arena, self.obstacles, self.body_radius, starts, goals)

    @property
    def n_places(self) -> int:
        """Number of places in the formation. Fewer than robots leave spare robots, more leave empty places."""
        return self.n_robots if self.places is None else self.places

    @property
    def body_radius(self) -> float:
        """Smallest allowed distance of a robot's centre from an obstacle: half the safe distance [units]."""
        return self.safe_distance / 2

    @property
    def height_apart(self) -> float:
        """The safe distance between robots above each other: the longest half axis of the ellipsoid [units]."""
        return self.safe_distance * self.downwash

    @property
    def by_height(self) -> str:
        """How heights count where robots' distances are named in a sentence; empty if they count as they are."""
        return "" if self.downwash == 1.0 else f" (with differences of z divided by {self.downwash:g})"

    def separation(self, one: Point, other: Point) -> float:
        """The distance of two robots to which `safe_distance` applies [units]."""
        return separation(one, other, self.downwash)

    def start_volume(self, n_robots: int) -> float:
        """Volume of the smallest arena that has room for random starts, the safe distance apart [units^dim]."""
        ball = math.pi ** (self.dim / 2) / math.gamma(self.dim / 2 + 1) * self.body_radius**self.dim
        return n_robots * ball * self.downwash / START_DENSITY

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Mission) and self.digest == other.digest)

    @cached_property
    def dim(self) -> int:
        """Dimension d of the flight space, 2 or 3."""
        return len(self.center)

    @property
    def sensing(self) -> float:
        """Range of the position sensors [units]."""
        return self.comm_range if self.sense_range is None else self.sense_range

    @cached_property
    def ideal(self) -> tuple[Point, ...] | None:
        """Ideal target points of the shape in its reference orientation [units]; None for a shape described in text."""
        try:
            points = formations.ideal_points(self.shape, self.n_places, self.center, self.spacing, self.points)
        except InputError as error:
            if error.field != "n_robots" or self.places is None:
                raise
            # Name the field that sets this number.
            raise InputError("places", error.value, says=error.says.replace("robots", "places")) from None
        if points is not None and self.turn:
            points = formations.rotated(points, self.center, math.radians(self.turn))
        return None if points is None else tuple(tuple(row) for row in points.tolist())

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits that identify the content of this mission."""
        return hashlib.blake2b(self.model_dump_json().encode(), digest_size=8).hexdigest()

    @property
    def _extent(self) -> tuple[Point, Point]:
        """The lowest and highest coordinates of places, in every orientation that the formation may have."""
        if self.turn is not None and self.ideal is not None:
            return tuple(map(min, *self.ideal, self.ideal[0])), tuple(map(max, *self.ideal, self.ideal[0]))
        reach = 0.0 if self.ideal is None else formations.circumradius(self.ideal, self.center)
        return tuple(c - reach for c in self.center), tuple(c + reach for c in self.center)

    @cached_property
    def travel_rounds(self) -> float:
        """Rounds after `since` at which the formation stops at a wall; infinite for a formation that stands still."""
        if self.velocity is None:
            return math.inf
        (low, high), (least, most) = self.arena, self._extent
        room = [
            (b - y) / v if v > 0 else (x - a) / -v
            for a, b, x, y, v in zip(low, high, least, most, self.velocity, strict=True)
            if v != 0
        ]
        return max(0.0, min(room, default=math.inf))

    def drift(self, round_: int) -> Point:
        """Displacement of the centre from `center` at the end of a round [units].

        The formation stops as a whole when the circle around its shape reaches a wall.
        """
        if self.velocity is None:
            return (0.0,) * self.dim
        rounds = min(max(0, round_ - self.since), self.travel_rounds)
        return tuple(rounds * v for v in self.velocity)

    def at(self, round_: int) -> Mission:
        """The mission as it stands at the end of a round: `center` is the centre's position then, `since` that round.

        A formation that has stopped at a wall has no velocity any more. A formation that stands still returns itself.
        """
        return self if self.velocity is None else _at(self, round_)

    def resized(self, places: int) -> Mission:
        """The same mission with another number of places. Call to check a plan for a smaller team.

        Use the result of a moving mission for the size of its plan only: a formation of another size stops elsewhere
        at a wall.

        Raises:
            InputError: the shape does not exist for this number of places, or does not fit.
        """
        return self if places == self.n_places else _resize(self, places)

    def among(self, obstacles: tuple[Obstacle, ...]) -> Mission:
        """The same mission with more obstacles, for the maps of robots that know of them."""
        return _among(self, obstacles) if obstacles else self

    def change(self, /, **fields: Any) -> Mission:
        """A changed copy, validated as a whole. New points set the shape to `points`; a new shape drops the points.

        Stages that were to follow are dropped; a new shape also drops orientation, preferences and `hold`.

        Raises:
            InputError: a field is invalid; names the first such field, its value, and what is allowed.
        """
        changed = {**self.model_dump(), "then": (), **fields}
        if fields.get("points") is not None:
            changed["shape"] = fields.get("shape", "points")
            changed["places"] = fields.get("places")
        elif "shape" in fields and fields["shape"] != self.shape:
            changed["points"] = None
        if {"shape", "points"} & fields.keys() and (changed["shape"], changed["points"]) != (self.shape, self.points):
            changed |= {name: fields.get(name, default) for name, default in OPTIONAL.items()}
        return build_mission(**changed)

    def check_sensing(self) -> None:
        """Check that robots sense far enough for the shield. Call before a run with the shield on.

        Two robots that do not see each other approach by at most 2 * max_step in one round, so the proof needs
        sense_range >= safe_distance * downwash + 2 * max_step (Zhou et al. 2017, lockstep form).

        Raises:
            InputError: the range is shorter.
        """
        needed = self.height_apart + 2 * self.max_step
        if self.sensing < needed:
            ways = "(raise sense_range or comm_range, lower max_step, or switch the shield off)"
            safe = "safe_distance" if self.downwash == 1.0 else "safe_distance * downwash"
            allowed = f"at least {safe} + 2 * max_step = {needed:g} while the shield is on {ways}"
            raise InputError("sense_range", self.sensing, allowed)


def mission_text(mission: Mission) -> str:
    """The mission's fields as JSON, for a message."""
    return mission.model_dump_json(include=set(MISSION_FIELDS))


def _copy(mission: Mission, **fields: Any) -> Mission:
    """A changed copy without validation, and without the values of cached properties."""
    return Mission.model_construct(**{name: getattr(mission, name) for name in Mission.model_fields} | fields)


@lru_cache(maxsize=256)
def _among(mission: Mission, obstacles: tuple[Obstacle, ...]) -> Mission:
    return _copy(mission, obstacles=(*mission.obstacles, *obstacles))


@lru_cache(maxsize=256)
def _at(mission: Mission, round_: int) -> Mission:
    center = tuple(c + d for c, d in zip(mission.center, mission.drift(round_), strict=True))
    if round_ - mission.since >= mission.travel_rounds:
        return _copy(mission, center=center, velocity=None, since=0)
    return _copy(mission, center=center, since=max(round_, mission.since))


@lru_cache(maxsize=64)
def _following(mission: Mission, round_: int) -> Mission:
    stage, *rest = mission.then
    given = {"hold": 0} | stage.set
    if unknown := sorted(given.keys() - MISSION_FIELDS | given.keys() & {"since", "then"}):
        raise InputError("then", unknown, f"only {', '.join(sorted(MISSION_FIELDS - {'since', 'then'}))}")
    travels = given.get("velocity", mission.velocity) is not None  # else all robots that go on give the same order
    return mission.at(round_).change(**given, since=round_ if travels else 0, then=tuple(rest))


@lru_cache(maxsize=256)
def _resize(mission: Mission, places: int) -> Mission:
    resized = _copy(mission, places=None if places == mission.n_robots else places)
    # Only the shape depends on the number. Obstacles are not checked: a moving formation may be anywhere among them.
    resized.check_shape()
    return resized


def build_mission(**fields: Any) -> Mission:
    """A `Mission` from plain values. Call it for values from an operator.

    Raises:
        InputError: a field is invalid; names the first such field, its value, and what is allowed.
    """
    return checked(Mission, fields)
