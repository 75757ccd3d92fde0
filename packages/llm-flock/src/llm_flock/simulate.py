"""Bodies of a team with their sensors; simulated ones are points that fly straight to their waypoints in a round."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np

from llm_flock import graph
from llm_flock.arrays import Pairwise, Point, Points, Vector, flattened
from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock.obstacles import Mover, MovingObstacle, clearance

StartRule: TypeAlias = Literal["separated", "uniform", "connected"]

MAX_DRAWS = 10_000  #: Draws of one robot's position before the arena counts as full.


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """One robot's sensor readings: its own position, and those of the robots in sensing range by id [units]."""

    position: Point
    sensed: Mapping[int, Point]
    moving: tuple[Mover, ...] = ()  #: Moving obstacles in sensing range.


Area: TypeAlias = tuple[Point, Point] | None  #: Two opposite corners in the arena [units]; None for all of it.


def start_positions(
    mission: Mission,
    given: Sequence[Sequence[float]] | None,
    rule: StartRule,
    rng: np.random.Generator,
    area: Area = None,
) -> Points:
    """Start positions, given or else drawn in an area, shape (n, d) [units].

    Raises:
        InputError: no room was found; or positions given have a wrong shape, a number that is not finite, or a robot
            outside the arena.
    """
    if given is None:
        return draw_start(mission, rule, rng, area)
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("start_positions", given, "rows of numbers") from None
    if array.shape != (mission.n_robots, mission.dim) or not bool(np.isfinite(array).all()):
        raise InputError("start_positions", given, f"{mission.n_robots} finite positions of {mission.dim} coordinates")
    low, high = (np.array(corner) for corner in mission.arena)
    outside = np.flatnonzero(((array < low) | (array > high)).any(axis=1))
    if outside.size:
        robot = int(outside[0])
        allowed = f"every robot inside the arena {low.tolist()} .. {high.tolist()}; robot {robot} is not"
        raise InputError("start_positions", array[robot].tolist(), allowed)
    return array


def draw_start(mission: Mission, rule: StartRule, rng: np.random.Generator, area: Area = None) -> Points:
    """Random start positions in the arena (paper, line 184) or in an area, clear of obstacles, shape (n, d) [units].

    `separated` redraws a robot that is nearer than the safe distance to one placed before; `uniform` is the paper's raw
    draw, which may start in violation. Both are uniform. `connected` is `separated` with each robot drawn within radio
    range of a robot placed before, chosen at random, so that the radio graph is connected.

    Raises:
        InputError: no room was found, or the area does not lie in the arena.
    """
    low, high = (np.array(corner) for corner in _area(mission, area))
    if rule == "uniform" and not mission.obstacles:
        return rng.uniform(low, high, size=(mission.n_robots, mission.dim))
    placed = np.empty((mission.n_robots, mission.dim))
    for k in range(mission.n_robots):
        for _ in range(MAX_DRAWS):
            draw = _near(placed[:k], mission.comm_range, rng) if k and rule == "connected" else rng.uniform(low, high)
            apart = rule == "uniform" or not k or _nearest(placed[:k] - draw, mission) >= mission.safe_distance
            inside = bool((low <= draw).all() and (draw <= high).all())
            if apart and inside and clearance(tuple(draw.tolist()), mission.obstacles) >= mission.body_radius:
                placed[k] = draw
                break
        else:
            where = "the arena" if area is None else f"the area {area}"
            raise InputError("n_robots", mission.n_robots, f"room for that many starts (found {k}) in {where}")
    return placed


def _area(mission: Mission, area: Area) -> tuple[Point, Point]:
    if area is None:
        return mission.arena
    (low, high), (least, most) = area, mission.arena
    if {len(low), len(high)} != {mission.dim} or not all(
        a <= x < y <= b for a, x, y, b in zip(least, low, high, most, strict=True)
    ):
        raise InputError("start_area", area, f"two corners of {mission.dim} coordinates in the arena, the lower first")
    return area


def _nearest(offsets: Points, mission: Mission) -> float:
    return float(np.linalg.norm(flattened(offsets, mission.downwash), axis=1).min())


def _near(placed: Points, reach: float, rng: np.random.Generator) -> Vector:
    """A uniform point in the ball of radius `reach` about a random one of the points placed."""
    about = placed[int(rng.integers(len(placed)))]
    while True:
        offset = np.array([rng.uniform(-reach, reach) for _ in about])
        if float(np.linalg.norm(offset)) <= reach:
            return about + offset


class Readings:
    """Positions of all robots (`places`, shape (n, d) [units; world frame]), and the robots' readings of them.

    Each reading adds a uniform vector in the ball of radius `noise` [units], and the offset of that robot's
    localisation, which begins anywhere in the ball of radius `drift` and walks at random in it. A robot reads its own
    position of now, and where others were `delay` rounds ago, all of them flying evenly throughout a round.
    `nearest_read` is the smallest distance of another robot that any of them has read [units]. `moving` obstacles
    are seen up to the sensing range, by their surface, and as late as others.
    """

    def __init__(
        self,
        mission: Mission,
        positions: Points,
        noise: float,
        rng: np.random.Generator,
        *,
        drift: float = 0.0,
        delay: float = 0.0,
        moving: Sequence[MovingObstacle] = (),
    ) -> None:
        self._mission = mission
        self._noise, self._drift, self._delay = noise, drift, delay
        self._exact = noise == drift == delay == 0.0
        self._rng = rng
        self._offsets = np.array([self._in_ball(drift) for _ in positions]) if drift else np.zeros_like(positions)
        self._past = [positions] * (math.ceil(delay) + 1)
        self._moving, self._round = moving, -1
        self.nearest_read = math.inf
        self.place(positions.copy())

    def place(self, places: Points) -> None:
        """Set the positions of all robots, and compute which are in range. Call once per round."""
        self.places, self._round = places, self._round + 1
        if self._drift:
            self._offsets = self._walk()
        self._distances: Pairwise = graph.distances(places)
        self._past = [*self._past[1:], places]
        whole = math.ceil(self._delay)
        share = whole - self._delay  # of the round that was in flight then
        self._seen = self._past[0] + share * (self._past[min(1, whole)] - self._past[0]) if whole else places
        self._rows: list[Point] = [tuple(row) for row in places.tolist()]
        self.in_radio_range = self._within(self._mission.comm_range, self._distances)
        sensing, seen = self._mission.sensing, graph.distances(self._seen) if whole else self._distances
        same = sensing == self._mission.comm_range and not whole
        self.in_sense_range = self.in_radio_range if same else self._within(sensing, seen)

    def _walk(self) -> Points:
        """The offsets one step of a tenth of their bound later."""
        offsets = self._offsets + [self._in_ball(self._drift / 10) for _ in self.places]
        lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
        return offsets * np.minimum(1.0, self._drift / np.maximum(lengths, self._drift))

    def _in_ball(self, radius: float) -> Vector:
        """A uniform vector in the ball of this radius."""
        direction = self._rng.normal(size=self._mission.dim)
        direction /= np.linalg.norm(direction)
        return radius * float(self._rng.random()) ** (1.0 / self._mission.dim) * direction

    def _within(self, reach: float, distances: Pairwise) -> list[tuple[int, ...]]:
        close = distances <= reach
        np.fill_diagonal(close, False)
        return [tuple(np.flatnonzero(row).tolist()) for row in close]

    def connected(self, robots: Sequence[int]) -> bool:
        """Whether the radio graph of these robots is connected."""
        close = self._distances <= self._mission.comm_range
        return graph.is_connected(close if len(robots) == len(close) else close[np.ix_(robots, robots)])

    def sense(self, robot: int) -> Sensing:
        """One robot's readings, with new errors at every call."""
        if self._exact:
            rows = self._rows
            sensed = {j: rows[j] for j in self.in_sense_range[robot]}
            return Sensing(position=rows[robot], sensed=sensed, moving=self._movers(robot))
        here = self._reading(robot, self.places)
        sensed = {j: self._reading(j, self._seen) for j in self.in_sense_range[robot]}
        gaps = (self._mission.separation(here, there) for there in sensed.values())
        self.nearest_read = min(self.nearest_read, *gaps, math.inf)
        return Sensing(position=here, sensed=sensed, moving=self._movers(robot))

    def _movers(self, robot: int) -> tuple[Mover, ...]:
        seen = list[Mover]()
        for number, one in enumerate(self._moving):
            place = one.at(self._round - self._delay)
            if math.dist(self._rows[robot], place) - one.radius <= self._mission.sensing:
                if self._noise:
                    place = tuple((np.array(place) + self._in_ball(self._noise)).tolist())
                seen.append(Mover(number=number, position=place, radius=one.radius, speed=one.speed))
        return tuple(seen)

    def others(self, robot: int) -> tuple[Point, ...]:
        """Readings of all other robots, in ascending order of ids, at any distance (`observe = "all"`)."""
        return tuple(self._reading(j, self._seen) for j in range(len(self._rows)) if j != robot)

    def _reading(self, robot: int, places: Points) -> Point:
        if self._exact:
            return self._rows[robot]
        place = places[robot] + self._offsets[robot] if self._drift else places[robot]
        return tuple((place + self._in_ball(self._noise) if self._noise else place).tolist())

    def move(self, displacements: Points) -> None:
        """Fly every robot by its displacement, shape (n, d) [units], all at once."""
        self.place(self.places + displacements)


class Bodies(Protocol):
    """Positions and sensors of all robots, in mission units, and their joint motion."""

    @property
    def positions(self) -> Points:
        """Positions of all robots, as recorded, shape (n, d) [units; world frame]."""
        ...

    @property
    def readings(self) -> Readings:
        """The present readings of all robots, and which robots are in range of which."""
        ...

    async def fly(self, displacements: Points) -> None:
        """Fly every robot by its displacement, shape (n, d) [units], all at once; returns when they have arrived."""
        ...


class InstantBodies:
    """Simulated bodies whose motions take no time."""

    def __init__(self, readings: Readings) -> None:
        self.readings = readings

    @property
    def positions(self) -> Points:
        """True positions, shape (n, d) [units]."""
        return self.readings.places

    async def fly(self, displacements: Points) -> None:
        """Move at once."""
        self.readings.move(displacements)
