"""The way to a goal: its next corner and its length, round obstacles and bodies that do not move."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from llm_flock.arrays import Point, moved
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle

if TYPE_CHECKING:
    from llm_flock.obstacles.roadmap import Roadmap  # only missions with obstacles or still bodies need it

STEP = 0.25
"""With uncertain positions, ways are as far from obstacles as a step of this share of the longest one needs."""


class Leg(msgspec.Struct, frozen=True, kw_only=True):
    """The way to a goal.

    Attributes:
        goal: where it ends [units; frame of the mission].
        stop: its next corner, or the goal [units; frame of the mission].
        left: its length [units].
    """

    goal: Point
    stop: Point
    left: float


def leg_to(
    mission: Mission,
    position: Point,
    goal: Point,
    drift: Point = (),
    ahead: Point = (),
    still: Sequence[Point] = (),
    noise: float = 0.0,
) -> Leg:
    """The way from a position [units; world frame] to a goal of the mission's frame, round the obstacles of the world.

    The frame is displaced by `drift` now, and by `ahead` at the end of the round; empty if the mission stands still.
    `still` are bodies that do not move [units; world frame].
    """
    roadmap = map_of(mission, position, still, noise)
    if roadmap is None:
        return Leg(goal=goal, stop=goal, left=math.dist(moved(position, drift, -1.0), goal))
    there = moved(goal, ahead)
    stop = roadmap.next_stop(position, there)
    left = roadmap.length(position, moved(goal, drift))
    return Leg(goal=goal, stop=goal if stop == there else moved(stop, ahead, -1.0), left=left)


def map_of(mission: Mission, position: Point, still: Sequence[Point], noise: float = 0.0) -> Roadmap | None:
    """The map of a mission's obstacles and of bodies that do not move; None where there is neither.

    With positions known to within `noise` [units], ways lie farther away from them.
    """
    if not mission.obstacles and not still:
        return None
    from llm_flock.obstacles.roadmap import roadmap_of

    radius = mission.body_radius
    if noise > 0.0:
        radius += noise * (1.0 + 2.0 * STEP * mission.max_step / radius)
    if not still:
        return roadmap_of(mission.arena, mission.obstacles, radius) if mission.obstacles else None
    # To build a map takes a while: it has at most 40 bodies, and noise must not change it in every round.
    near = sorted(still, key=lambda body: math.dist(body, position))[:40]
    # A centre keeps the radius of a body away from obstacles, and the safe distance, two radii, from other centres.
    spots = sorted(tuple(round(x, 1) for x in body) for body in near)
    discs = tuple(Obstacle(center=spot, radius=mission.body_radius) for spot in spots)
    return roadmap_of(mission.arena, (*mission.obstacles, *discs), radius)
