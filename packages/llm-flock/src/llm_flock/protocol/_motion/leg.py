"""The way to a goal: its next corner and its length, round obstacles and bodies that do not move."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from llm_flock.arrays import Point, moved
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.planner import StepQuestion
from llm_flock.protocol._verification.plans import ROUNDING
from llm_flock.protocol._verification.steps import blocked

if TYPE_CHECKING:
    from llm_flock.roadmap import Roadmap  # only missions with obstacles or still bodies need it

SLOWEST = 0.4
"""Smallest average gain of a usable planner, as a share of the largest possible gain: at this pace it takes 2.5 times
the rounds of a straight flight, and a team should form in three times the lower bound."""


ROOM = 0.25  # share of a straight step that others have to leave free, before a robot that stays has itself to blame


class Pace:
    """Average gain of a planner's waypoints towards the goal, each as a share of the gain of a straight step.

    A round held because an answer was rejected counts as a gain of 0. Waypoints at the goal do not count, nor those of
    a robot that others leave no room. A travelling goal has to be reached from one step away: a robot that only closes
    a share of the gap would trail without end.
    """

    def __init__(self) -> None:
        self._average = 1.0

    def too_slow(self, question: StepQuestion, waypoint: Point, room: Callable[[], float]) -> str | None:
        """Count a waypoint that passed its checks. Returns the reason to reject it, or None.

        `room` is how far others let the robot fly straight ahead now [units]; it is called where they are in its way.
        """
        mission, goal = question.mission, question.goal
        before, after = math.dist(question.position, goal), math.dist(waypoint, goal)
        if min(before, after) <= ROUNDING * mission.spacing:
            return None
        longest = min(mission.max_step, before)
        most = room() if before - after < longest and blocked(question) else longest
        if most < ROOM * longest:
            # A robot that others leave no room may step back, but that is no sign that its planner has recovered.
            back = question.probe and after > before
            return "it leads away from the goal, and the last positions were too slow." if back else None
        gain = (before - after) / most
        if mission.velocity is not None and before <= mission.max_step:
            gain = float(after <= AT_GOAL * mission.spacing)
        self._count(min(gain, 1.0))
        if self._average >= SLOWEST:
            return None
        return (
            f"on average, the last positions led {100 * self._average:.0f} % of a step nearer to the goal, "
            f"at least {100 * SLOWEST:.0f} % is required."
        )

    def held(self) -> None:
        """Count a round in which the planner's answer was rejected and nothing replaced it."""
        self._count(0.0)

    def _count(self, gain: float) -> None:
        weight = 0.25  # of the newest waypoint
        self._average += weight * (gain - self._average)


STEP = 0.25  # with uncertain positions, ways are as far from obstacles as a step of this share of the longest one needs


class Leg(msgspec.Struct, frozen=True, kw_only=True):
    """The way to a goal, its next corner (or the goal) and its length left [units; frame of the mission]."""

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
    """The way from a position in the world frame to a goal in the mission's frame, round obstacles and `still` bodies.

    The frame is displaced by `drift` now, and by `ahead` at the end of the round; empty if the mission stands still.
    """
    roadmap = map_of(mission, position, still, noise)
    if roadmap is None:
        return Leg(goal=goal, stop=goal, left=math.dist(moved(position, drift, -1.0), goal))
    there = moved(goal, ahead)
    stop = roadmap.next_stop(position, there)
    left = roadmap.length(position, moved(goal, drift))
    return Leg(goal=goal, stop=goal if stop == there else moved(stop, ahead, -1.0), left=left)


def map_of(mission: Mission, position: Point, still: Sequence[Point], noise: float = 0.0) -> Roadmap | None:
    """The map of obstacles and bodies that stand `still`, farther away with noise [units]; None without either."""
    if not mission.obstacles and not still:
        return None
    from llm_flock.roadmap import roadmap_of

    radius = mission.body_radius
    if noise > 0.0:
        radius += noise * (1.0 + 2.0 * STEP * mission.max_step / radius)
    # A map takes time to build: it has at most 40 bodies, and rounding keeps noise from changing it in every round.
    near = sorted(still, key=lambda body: math.dist(body, position))[:40]
    # A centre keeps the radius of a body away from obstacles, and the safe distance, two radii, from other centres.
    spots = sorted(tuple(round(x, 1) for x in body) for body in near)
    if mission.downwash != 1.0:  # balls above each other, around the ellipsoid
        rise = mission.height_apart - mission.safe_distance
        rises = np.linspace(-rise, rise, 1 + 2 * math.ceil(2 * rise / mission.safe_distance)).tolist()
        spots = [(*spot[:2], spot[2] + up) for spot in spots for up in rises]
    discs = tuple(Obstacle(center=spot, radius=mission.body_radius) for spot in spots)
    return roadmap_of(mission.arena, (*mission.obstacles, *discs), radius)
