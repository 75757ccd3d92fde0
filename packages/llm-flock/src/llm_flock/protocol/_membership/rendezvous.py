"""Meeting points of a team in pieces, on a circle or at the centre: "Gathering" and "Rendezvous" in membership.md."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
import scipy

from llm_flock import shapes as formations
from llm_flock.arrays import Point, between
from llm_flock.message import NO_OWNER, BidEntry
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.plan import Plan

HOLLOW = 0.5  # shapes have a circle if their nearest place is at least at this share of the farthest one's distance
ENOUGH = 0.5  # share of a plan's slots that must be taken before robots fly to their places
WITHIN = 0.95  # the radius of the circle on which robots wait, as a share: a smaller circle closes more easily
NEAR = 1.0  # a robot within this many spacings of the circle is on it
HOLD = 0.8  # waiting robots spread out to at most this share of the radio range
LINK = 0.95  # robots keep within this share of the radio range of their neighbours on the circle
FEW = 0.45  # while more than this share of the team has never been heard of, a robot gathers
CLOSE = 0.3  # robots gather at this many spacings from the centre, each on its own side
WAIT = 4  # rounds without news at the centre after which a robot stops gathering
ANGLES = 72  # orientations of a formation that are tried
UNTURNED = 0.1  # places this share of the spacing from those of the reference orientation are in it


def meeting_places(mission: Mission, plan: Plan, table: Sequence[BidEntry]) -> Plan:
    """The places to fly to: on the circle of the mean radius while most slots are vacant, then those of the plan."""
    places = on_circle(plan, mission.center)
    if places is None or sum(owner > NO_OWNER for _, _, owner in table) >= ENOUGH * len(plan):
        return plan
    return places if _clear(mission, places) else plan


def landing(mission: Mission, plan: Plan, here: Point) -> Point | None:
    """The point of the circle at which a robot `here` waits for others [units; frame of the mission], or None."""
    places = on_circle(plan, mission.center)
    if mission.dim != 2 or places is None or not _clear(mission, places):
        return None
    radius = WITHIN * _polar(places.points[0], mission.center)[0]
    return _at(mission.center, radius, _polar(here, mission.center)[1])


def meeting_point(mission: Mission, plan: Plan, here: Point, others: Iterable[Point]) -> Point | None:
    """The point on the circle at which to wait for unknown robots; None if there is no such circle.

    Known robots (at `others`) that follow each other on the circle within radio range spread out evenly around their
    mean position, up to `HOLD` apart, so that the ends of such a chain meet others.
    """
    point = landing(mission, plan, here)
    near = NEAR * mission.spacing
    if point is None or math.dist(here, point) > near:
        return point
    radius, direction = _polar(point, mission.center)
    seen = (_polar(place, mission.center) for place in others)
    arcs = sorted(radius * _wrap_angle(angle - direction) for away, angle in seen if abs(away - radius) <= near)
    along = _spread(arcs, math.tau * radius, mission.comm_range)
    return _at(mission.center, radius, direction + min(max(along, -mission.spacing), mission.spacing) / radius)


def _spread(arcs: Sequence[float], around: float, reach: float) -> float:
    """The move along the circle of length `around`, with other robots at sorted positions `arcs` along it [units]."""
    mine = bisect_left(arcs, 0.0)
    once = [*arcs[:mine], 0.0, *arcs[mine:]]
    unrolled = [arc + turn for turn in (-around, 0.0, around) for arc in once]
    first = last = mine = mine + len(once)
    while mine - first < len(once) and unrolled[first] - unrolled[first - 1] <= reach:
        first -= 1
    if mine - first == len(once):
        return 0.0  # the circle is closed
    while unrolled[last + 1] - unrolled[last] <= reach:
        last += 1
    chain = unrolled[first : last + 1]
    apart = min(HOLD * reach, around / len(chain))
    along = sum(chain) / len(chain) + (mine - first - (len(chain) - 1) / 2) * apart
    # A robot that moves away from the middle of the chain may use up the rest of a link.
    if mine < last:
        along = max(along, min(0.0, unrolled[mine + 1] - LINK * reach) if mine - first < last - mine else 0.0)
    if mine > first:
        along = min(along, max(0.0, unrolled[mine - 1] + LINK * reach) if mine - first > last - mine else 0.0)
    return along


def _polar(point: Point, center: Point) -> tuple[float, float]:
    """Distance [units] and direction [rad] from the centre, in the plane."""
    x, y = point[0] - center[0], point[1] - center[1]
    return math.hypot(x, y), math.atan2(y, x)


def _at(center: Point, radius: float, direction_rad: float) -> Point:
    return center[0] + radius * math.cos(direction_rad), center[1] + radius * math.sin(direction_rad)


def _wrap_angle(angle_rad: float) -> float:
    return (angle_rad + math.pi) % math.tau - math.pi


def _clear(mission: Mission, places: Plan) -> bool:
    return not mission.obstacles or all(
        clearance(place, mission.obstacles) >= mission.body_radius for place in places.points
    )


@lru_cache(maxsize=256)
def on_circle(plan: Plan, center: Point) -> Plan | None:
    """The places of a hollow plan, each moved to or from the centre onto the circle of their mean radius."""
    offsets = plan.array - np.array(center)
    radii = np.linalg.norm(offsets, axis=1, keepdims=True)
    if radii.min() < HOLLOW * radii.max() or not radii.min():
        return None
    return Plan.of(tuple(place) for place in (np.array(center) + offsets * (radii.mean() / radii)).tolist())


class Gathering:
    def __init__(self) -> None:
        self._strangers = math.inf
        self._left = self._wait = 0
        self._beyond: Point | None = None

    def target(
        self, mission: Mission, plan: Plan, slot: int, here: Point, *, strangers: int, alone: bool
    ) -> Point | None:
        """The point to fly to instead of the place [units; frame of the mission], or None. Call once a round.

        `strangers` is the number of robots never heard of. A robot that is `alone` senses no other, and comes back as
        long as any robot is missing.
        """
        center, reach = mission.center, CLOSE * mission.spacing
        away = math.dist(here, center)
        if strangers < self._strangers:
            across = away + max(math.dist(place, center) for place in plan.points)
            self._left, self._wait = math.ceil(across / mission.max_step) + WAIT, WAIT
            self._strangers, self._beyond = strangers, None
        few = not alone and strangers <= FEW * mission.n_robots
        if not strangers or few or min(self._left, self._wait) < 0 or heard_when_turned(mission, plan, slot):
            return None
        if unturned(mission, plan):
            return None
        there, far = away <= reach + mission.spacing / 10, max(away, 1e-9)
        self._left, self._wait = self._left - 1, self._wait - there
        if alone and there and self._beyond is None:
            self._beyond = between(center, here, -reach / far)
        return self._beyond if alone and self._beyond is not None else between(center, here, min(reach, away) / far)


@lru_cache(maxsize=256)
def unturned(mission: Mission, plan: Plan) -> bool:
    """Whether the plan is in the shape's reference orientation, which other models are likely to have chosen, too."""
    if mission.ideal is None or len(mission.ideal) != len(plan):
        return False
    away = scipy.spatial.distance.cdist(plan.array, np.array(mission.ideal)).min(axis=1).max()
    return bool(away <= UNTURNED * mission.spacing)


@lru_cache(maxsize=4096)
def heard_when_turned(mission: Mission, plan: Plan, slot: int) -> bool:
    """Whether robots would hear a robot at its place, or meet it on a circle, in any orientation of the plan."""
    if on_circle(plan, mission.center) is not None:
        return True
    angles = np.linspace(0.0, math.tau, ANGLES, endpoint=False).tolist()
    turns = np.concatenate([formations.rotated(plan.array[[slot]], mission.center, angle) for angle in angles])
    return bool(scipy.spatial.distance.cdist(turns, plan.array).min(axis=1).max() <= mission.comm_range)
