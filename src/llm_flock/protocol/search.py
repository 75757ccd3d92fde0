"""Ends frozen partitions: a robot that sits in its place while others' places stay empty goes and looks for the others.

Random starts are rarely connected, and two groups can settle on places that never come into radio range of each
other: each then knows of empty slots, and no message will ever fill them. So a robot at its goal that still knows of
vacant slots after some rounds visits them, the nearest first, and the centre last, until it hears something new. Who
sits nearest to a vacant slot goes first; a tour that met nobody is followed by a longer wait, and after a few tours
the robot stays: its team may simply be smaller than the plan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from llm_flock.arrays import Point
from llm_flock.protocol.messages import NO_OWNER, Table
from llm_flock.protocol.plan import Plan

PATIENCE = 1
"""Rounds at the goal before a robot next to a vacant slot sets out; doubled by every tour in vain."""

NEXT_TO = 1.5
"""A vacant slot within this many spacings of the own one is next to it."""

PATIENCE_PER_PLACE = 4
"""More rounds to wait for each spacing that a vacant slot is farther away: who is nearer should go."""

MAX_TOURS = 4
"""Tours in vain on the same knowledge, after which the robot stays."""

SILENT_TOURS = 1
"""Tours in vain of a robot next to a vacant slot, where all that are missing have been heard of before."""

ARRIVED = 0.5
"""A point of the tour counts as visited within this share of the spacing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """How far a robot's search is.

    Attributes:
        known: what the search is about: digest of the plan, and its vacant slots; new knowledge starts afresh.
        waited: rounds spent at the goal since the last tour.
        tours: tours in vain.
        way: points still to visit [units; world frame]; empty while the robot waits.
    """

    known: tuple[str, tuple[int, ...]] = ("", ())
    waited: int = 0
    tours: int = 0
    way: tuple[Point, ...] = ()

    @property
    def given_up(self) -> bool:
        """Whether the robot has looked long enough, and takes the vacant slots for gaps."""
        return self.tours >= MAX_TOURS

    @property
    def target(self) -> Point | None:
        """Where the search leads next, None while there is none under way."""
        return self.way[0] if self.way else None


def advance(
    search: Search,
    *,
    position: Point,
    plan: Plan,
    slot: int,
    table: Table,
    center: Point,
    spacing: float,
    at_goal: bool,
    strangers: int,
    silent: int,
) -> Search:
    """The search one round later.

    Args:
        search: as it was.
        position: own believed position [units; world frame].
        plan: the plan that is followed.
        slot: own place in it.
        table: all claims known.
        center: centre of the formation.
        spacing: wanted distance between neighbours [units].
        at_goal: whether the robot is at its own place.
        strangers: how many robots of the team have never been heard of.
        silent: how many have been, but not for long. They are probably dead, so a short look must do.
    """
    empty = tuple(a for a, entry in enumerate(table) if entry[2] == NO_OWNER)
    if (plan.digest, empty) != search.known:
        return Search(known=(plan.digest, empty))
    if not empty or not (strangers or silent):  # with everybody in touch the talks will fill what is empty
        return search if not search.way else replace(search, way=(), waited=0)
    if search.way:
        way = search.way[1:] if math.dist(position, search.way[0]) <= ARRIVED * spacing else search.way
        return replace(search, way=way) if way else replace(search, way=(), waited=0, tours=search.tours + 1)
    if not strangers and (search.tours >= SILENT_TOURS or _nearest(plan, slot, empty) > NEXT_TO * spacing):
        return replace(search, tours=MAX_TOURS)
    if not at_goal or search.given_up:
        return search
    if search.waited < _patience(search.tours, plan, slot, empty, spacing):
        return replace(search, waited=search.waited + 1)
    tour = _tour(plan, slot, empty)
    return replace(search, way=tour if search.tours < 2 else (*tour, center))


def _patience(tours: int, plan: Plan, slot: int, empty: Sequence[int], spacing: float) -> int:
    """Rounds to wait before setting out."""
    nearest = _nearest(plan, slot, empty)
    return PATIENCE * 2**tours + int(PATIENCE_PER_PLACE * max(0.0, nearest / spacing - NEXT_TO))


def _nearest(plan: Plan, slot: int, empty: Sequence[int]) -> float:
    return min(math.dist(plan.points[slot], plan.points[a]) for a in empty)


def _tour(plan: Plan, slot: int, empty: Sequence[int]) -> tuple[Point, ...]:
    """The vacant slots, each time the nearest to the one before."""
    left, here, way = list(empty), plan.points[slot], list[Point]()
    while left:
        following = min(left, key=lambda a: (math.dist(here, plan.points[a]), a))
        left.remove(following)
        here = plan.points[following]
        way.append(here)
    return tuple(way)
