"""The search for missing robots, and the way of a robot that is lost: see membership.md in the docs."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from functools import lru_cache

import msgspec
import numpy as np
from msgspec.structs import replace

from llm_flock.arrays import Point, spread
from llm_flock.message import NO_OWNER
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.plan import Plan
from llm_flock.protocol._parts import Situation

PATIENCE = 1  # rounds at the goal before a robot next to a vacant slot sets out; doubled by every visit in vain
NEXT_TO = 1.5  # a vacant slot within this many spacings of the robot's own slot is next to it
PATIENCE_PER_PLACE = 4  # more rounds of waiting for each spacing that a vacant slot is away: nearer robots go first
LOOKS = 4  # visits to a vacant slot while robots are missing that were never heard of, or last had no plan
LOOKS_FOR_SILENT = 1  # visits where all missing robots have been heard of before, and are probably dead
MANY = 20  # while more robots are missing, every round brings news, and a search goes on until its next slot is taken
ARRIVED = 0.5  # a point of the tour counts as visited within this share of the spacing
NEAR = 0.5  # a robot waits within this share of the spacing from where it wants to be found
WAIT = 3  # rounds that a robot waits at the first point; each further wait is as much longer
ALONE = 8  # heartbeat periods out of touch with its team after which a robot without a place is lost
LONG = 64  # heartbeat periods out of touch after which a robot looks everywhere
LANE = 0.6  # lanes over the arena, and their ends from its edge: this share of the radio range from every point
FAR = 2.0  # in a formation that reaches this many radio ranges from its centre, robots are sought at places


class Search(msgspec.Struct, frozen=True, kw_only=True):
    """State of a robot's search."""

    known: tuple[str, tuple[int, ...]] = ("", ())  # digest of the plan, and its vacant slots; news restarts a search
    looks: int = 0  # number of visits to the least visited of these slots
    waited: int = 0  # rounds spent at the goal since the last tour or visit
    way: tuple[Point, ...] = ()  # points still to visit [units; frame of the mission]; empty while the robot waits
    gaps: tuple[int, ...] = ()  # vacant slots that will not be visited any more
    looked: tuple[int, ...] = ()  # vacant slots that this robot has just visited

    @property
    def target(self) -> Point | None:
        """The next point to visit; None while no tour is under way."""
        return self.way[0] if self.way else None

    @property
    def given_up(self) -> bool:
        """Whether every vacant slot is a gap."""
        return bool(self.gaps) and self.gaps == self.known[1]


def advance(
    search: Search,
    now: Situation,
    plan: Plan,
    *,
    strangers: int,
    silent: int,
    without_plan: int = 0,
    standing: Collection[int] = (),
) -> Search:
    """The search one round later, for a robot with a slot of this plan.

    The bid of a vacant slot is its number of visits. Slots with a body `standing` on them are not searched.
    `strangers` were never heard of, and heartbeats of `silent` ones have stopped. Robots `without_plan` may also wait
    elsewhere than in vacant slots, so each tour then ends at the centre.
    """
    slot, table, center, spacing = now.claim.slot, now.claim.table, now.mission.center, now.mission.spacing
    assert slot is not None and table is not None, "a robot without a place does not search"
    vacant = tuple(a for a, entry in enumerate(table) if entry[2] == NO_OWNER and a not in standing)
    search = _update(search, plan, slot, vacant, center, many=strangers + silent + without_plan > MANY)
    if not vacant or not (strangers or silent or without_plan):  # a team in touch fills its vacant slots by agreement
        return replace(search, way=(), waited=0, gaps=(), looked=())
    most = LOOKS if strangers or without_plan else LOOKS_FOR_SILENT
    due = [a for a in vacant if table[a][1] < most]
    gaps = tuple(a for a in vacant if table[a][1] >= most)
    looks = int(min((table[a][1] for a in due), default=most))
    waited = search.waited if looks == search.looks else 0
    search = replace(search, gaps=gaps, looks=looks, waited=waited, looked=())
    if search.way:
        if math.dist(now.position, search.way[0]) > ARRIVED * spacing:
            return search
        here = tuple(a for a in vacant if plan.points[a] == search.way[0])
        return replace(search, way=search.way[1:], waited=0, looked=here)
    if not due or math.dist(now.position, plan.points[slot]) > AT_GOAL * spacing:
        return search
    nearest = min(math.dist(plan.points[slot], plan.points[a]) for a in due) / spacing
    if waited < PATIENCE * 2**looks + int(PATIENCE_PER_PLACE * max(0.0, nearest - NEXT_TO)):
        return replace(search, waited=waited + 1)
    tour = [plan.points[a] for a in due]
    if now.mission.velocity is None:  # robots that missed an order stand where they were sent before
        tour += spread(now.earlier, 0.5 * now.mission.comm_range, plan.points)
    way = _tour(plan.points[slot], tour)
    return replace(search, way=(*way, center) if without_plan or looks >= LOOKS // 2 else way)


def longest_search(mission: Mission, missing: int) -> int:
    """Rounds within which robots in touch give up all places of this many others, if nobody is found there."""
    places = np.array(mission.ideal or (mission.center,))
    across = float(np.ptp(places, axis=0).max())
    tour = min((missing + 1) * across, len(places) * 1.5 * mission.spacing + across) / mission.max_step
    waits = PATIENCE * 2**LOOKS + LOOKS * PATIENCE_PER_PLACE * across / mission.spacing
    return math.ceil(LOOKS * tour + waits)


def _update(search: Search, plan: Plan, slot: int, vacant: tuple[int, ...], center: Point, *, many: bool) -> Search:
    """The search with the present vacant slots. With `many` robots missing, news neither end a tour nor the wait."""
    digest, before = search.known
    if digest != plan.digest or (vacant != before and not many):
        return Search(known=(plan.digest, vacant))
    if vacant == before:
        return search
    still = {plan.points[a] for a in vacant} | {center}
    way = search.way if search.way and search.way[0] in still else ()
    same = _nearest(plan, slot, vacant) == _nearest(plan, slot, before)
    return replace(search, known=(digest, vacant), waited=search.waited if same else 0, way=way)


@lru_cache(maxsize=4096)
def _nearest(plan: Plan, slot: int, vacant: tuple[int, ...]) -> int | None:
    points = plan.points
    here = points[slot]
    return min(((math.dist(here, points[a]), a) for a in vacant), default=(0.0, None))[1]


def _tour(start: Point, points: Sequence[Point]) -> tuple[Point, ...]:
    """A tour of some points, always to the nearest one left."""
    places = np.array(points)
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    to_each = np.linalg.norm(places - np.array(start), axis=1)
    way = list[Point]()
    for _ in points:
        following = int(to_each.argmin())
        way.append(points[following])
        apart[:, following] = math.inf  # it has been visited
        to_each = apart[following]
    return tuple(way)


class Seeking:
    """The way of a robot without plan, or lost: to the centre and in a large formation to two places, then everywhere.

    A robot that meets nobody at its place goes there once, comes back, and waits twice as long each time; from the
    second time on it flies over the arena as well.
    """

    def __init__(self, robot: int, liars: int = 0) -> None:
        self._robot, self._liars = robot, liars
        self.start_again()

    def start_again(self) -> None:
        self._leg = 0
        self._left: int | None = None
        self._alone = self._deserted = 0
        self._patience, self.sets_out = ALONE, False

    def _way(self, mission: Mission) -> tuple[tuple[Point, ...], tuple[Point, ...]]:
        """Points to wait at, and lanes over the arena for a robot that has been alone for long."""
        everywhere = self._alone > LONG or (self.sets_out and self._patience > 2 * ALONE + self._robot)
        lanes = _lanes(mission)[:: -1 if self._robot % 2 else 1] if everywhere else ()
        return _points(mission, self._robot), lanes

    def wait_for_neighbours(self, now: Situation, *, met: bool) -> None:
        """Count a period in which no body was `met` in radio range of the own place, though others belong there."""
        if met:
            self._deserted, self._patience, self.sets_out = 0, ALONE, False
        elif self.sets_out:
            self.sets_out = self._leg < sum(map(len, self._way(now.mission)))
        elif _should_meet_others(now):
            self._deserted += 1
            if self._deserted > self._patience:
                self._deserted, self._patience = 0, 2 * self._patience + self._robot  # not all at the same time
                self.sets_out, self._leg, self._left = True, 0, None

    def count(
        self, living: Collection[int], silent: Collection[int], strangers: Collection[int], n_robots: int
    ) -> None:
        """Count a period out of touch, if the robot hears few of its team, or too few to outnumber liars."""
        known = n_robots - len({*silent, *strangers})
        in_touch = bool(living) and 2 * len(silent) < n_robots and (not self._liars or known > 2 * self._liars)
        self._alone = 0 if in_touch else self._alone + 1

    @property
    def lost(self) -> bool:
        """Whether a robot without a place has been out of touch for so long that it should look for the others."""
        return self._alone >= ALONE

    def target(self, mission: Mission, here: Point) -> Point | None:
        """The point to fly to from `here` [units; frame of the mission], or None to wait. Call once a round."""
        points, lanes = self._way(mission)
        turn, at = divmod(self._leg, len(points) + len(lanes))
        point = (*points, *lanes)[at]
        away = math.dist(here, point)
        if self._left is None and at >= len(points):  # nobody is expected there: it flies on
            self._left = math.ceil(away / mission.max_step) + WAIT
        elif self._left is None:  # time for any robot to get there: a crowd may keep this one away
            across = max(math.dist(x, mission.center) for x in points)
            self._left = math.ceil((away + across) / mission.max_step) + WAIT * (turn * len(points) + at + 1)
        self._left -= 1
        if at >= len(points) and away <= NEAR * mission.spacing:
            self._left = 0
        if self._left == 0:
            self._leg, self._left = self._leg + 1, None
        return point if away > NEAR * mission.spacing else None


@lru_cache(maxsize=256)
def _lanes(mission: Mission) -> tuple[Point, ...]:
    """The corners of a way to and fro that comes within radio range of every point of the arena."""
    (low, *lows), (high, *highs) = mission.arena
    width = 2.0 * LANE * mission.comm_range / math.sqrt(len(lows))
    rows = [()]
    for a, b in zip(lows, highs, strict=True):
        lanes = max(1, math.ceil((b - a) / width))
        across = [a + (b - a) * (k + 0.5) / lanes for k in range(lanes)]
        rows = [(*row, x) for k, row in enumerate(rows) for x in (across if k % 2 == 0 else across[::-1])]
    edge = min(LANE * mission.comm_range, (high - low) / 2.0)
    ends = low + edge, high - edge
    way = [(end, *row) for k, row in enumerate(rows) for end in (ends if k % 2 == 0 else ends[::-1])]
    return tuple(point for point in way if clearance(point, mission.obstacles) >= mission.body_radius)


def _should_meet_others(now: Situation) -> bool:
    """Whether the robot is at its place, and other places are in radio range of it."""
    plan, slot, mission = now.plan, now.claim.slot, now.mission
    if plan is None or slot is None or math.dist(now.position, plan.points[slot]) > AT_GOAL * mission.spacing:
        return False
    return any(0.0 < math.dist(place, plan.points[slot]) <= mission.comm_range for place in plan.points)


@lru_cache(maxsize=4096)
def _points(mission: Mission, robot: int) -> tuple[Point, ...]:
    """The points that a robot visits in turn; only the centre if it is in radio range of all places."""
    ideal = mission.ideal or ()
    reach = max((math.dist(place, mission.center) for place in ideal), default=0.0)
    if reach <= mission.comm_range:
        return (mission.center,)
    n = len(ideal)
    places = ideal[robot % n], ideal[(robot + n // 2) % n]
    return (*places, mission.center) if reach > FAR * mission.comm_range else (mission.center, *places)
