"""Where a robot goes that is lost, or has no plan: to the centre, or to places where others may stand."""

from __future__ import annotations

import math
from collections.abc import Collection
from functools import lru_cache

from llm_flock.arrays import Point
from llm_flock.mission import Mission

NEAR = 0.5  # a robot waits within this share of the spacing from where it wants to be found
WAIT = 3  # rounds that a robot waits at the first point; each further wait is as much longer
ALONE = 8  # heartbeat periods out of touch with its team after which a robot without a place is lost

FAR = 2.0
"""In a formation that reaches farther from its centre than this many radio ranges, robots are not sought at the
centre, but at places."""


class Seeking:
    """The way of one robot that is lost, or has no plan: to the centre, where searches end and others like it gather.

    In a large formation nobody at a place hears the centre. There the robot also visits two ideal places in reference
    orientation, other ones for each robot: however the formation is turned, robots with a plan stand near such places.
    """

    def __init__(self, robot: int, liars: int = 0) -> None:
        self._robot, self._liars = robot, liars
        self.start_again()

    def start_again(self) -> None:
        """Forget how far it has come."""
        self._leg = 0
        self._left: int | None = None
        self._alone = 0

    def count(
        self, living: Collection[int], silent: Collection[int], strangers: Collection[int], n_robots: int
    ) -> None:
        """Take note of the neighbours that live, and of the team's silent and unknown robots. Call once in each period.

        A robot that hears few of its team is not in touch with it, whoever stands beside it. Nor is one that might hear
        too few honest robots to free a slot, if all that may lie are among those it hears.
        """
        known = n_robots - len({*silent, *strangers})
        in_touch = bool(living) and 2 * len(silent) < n_robots and (not self._liars or known > 2 * self._liars)
        self._alone = 0 if in_touch else self._alone + 1

    @property
    def lost(self) -> bool:
        """Whether a robot without a place has been out of touch for so long that it should look for the others."""
        return self._alone >= ALONE

    def target(self, mission: Mission, here: Point) -> Point | None:
        """Where to fly from `here` [units; frame of the mission], or None to wait. Call once a round."""
        points = _points(mission, self._robot)
        point = points[self._leg % len(points)]
        away = math.dist(here, point)
        if self._left is None:  # a crowd may keep it from getting there, so it only stays for as long as others take
            across = max(math.dist(x, mission.center) for x in points)
            self._left = math.ceil((away + across) / mission.max_step) + WAIT * (self._leg + 1)
        self._left -= 1
        if self._left == 0:
            self._leg, self._left = self._leg + 1, None
        return point if away > NEAR * mission.spacing else None


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
