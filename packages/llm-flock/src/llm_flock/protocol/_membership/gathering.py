"""Gathering of a team in pieces at the centre, before its robots fly to places far out.

Robots out of touch follow plans of their own, which have the same shape in other orientations. A robot whose place is
at the end of a line may be alone there, and the others fill another line. So as long as a robot does not know most of
the team, it flies to its place only if, however the formation is turned, a robot at some place would hear it there.
Otherwise it goes to the centre, where all pieces meet.

A robot alone at the centre goes on to its other side, in case the formation is open towards it. A robot that gathers
without news for too long stops: the others may be dead.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy

from llm_flock import shapes as formations
from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._membership.rendezvous import on_circle

FEW = 0.45  # while more than this share of the team has never been heard of, a robot gathers

CLOSE = 0.3
"""Robots gather at this many spacings from the centre, each on its own side, so as not to be in each other's way."""

WAIT = 4  # rounds without news at the centre after which a robot stops gathering
ANGLES = 72  # orientations of a formation that are tried


class Gathering:
    """The gathering of one robot."""

    def __init__(self) -> None:
        self._strangers = math.inf
        self._left = self._wait = 0
        self._beyond: Point | None = None

    def target(
        self, mission: Mission, plan: Plan, slot: int, here: Point, *, strangers: int, alone: bool
    ) -> Point | None:
        """Where to fly from `here` [units; frame of the mission] instead of the place; None to fly there.

        Call once a round. `strangers` robots have never been heard of; a robot that sees no other is `alone`, and
        returns from a far place while any are missing.
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
        there = away <= reach + mission.spacing / 10
        self._left, self._wait = self._left - 1, self._wait - there
        if alone and there and self._beyond is None:
            self._beyond = _towards(center, here, -reach)
        return self._beyond if alone and self._beyond is not None else _towards(center, here, min(reach, away))


def _towards(center: Point, here: Point, distance: float) -> Point:
    """The point at this distance from the centre on the way to `here` [units]."""
    share = distance / max(math.dist(here, center), 1e-9)
    return tuple(c + share * (x - c) for x, c in zip(here, center, strict=True))


@lru_cache(maxsize=4096)
def heard_when_turned(mission: Mission, plan: Plan, slot: int) -> bool:
    """Whether robots with this plan in any other orientation would hear a robot at its place, or meet it elsewhere.

    Shapes with a circle meet there.
    """
    if on_circle(plan, mission.center) is not None:
        return True
    turns = np.repeat(plan.array[[slot]], ANGLES, axis=0)
    for k, angle in enumerate(np.linspace(0.0, math.tau, ANGLES, endpoint=False).tolist()):
        turns[k, :2] = formations.rotated(turns[k, :2], mission.center[:2], angle)
    return bool(scipy.spatial.distance.cdist(turns, plan.array).min(axis=1).max() <= mission.comm_range)
