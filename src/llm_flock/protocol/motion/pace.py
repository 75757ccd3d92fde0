"""The pace of a planner: whether its waypoints lead to the goal, or only just pass their checks."""

from __future__ import annotations

import math

from llm_flock.arrays import Point
from llm_flock.metrics import AT_GOAL
from llm_flock.protocol.planning import StepQuestion
from llm_flock.protocol.verification.plans import ROUNDING
from llm_flock.protocol.verification.steps import blocked

SLOWEST = 0.4
"""Smallest average gain of a usable planner, as a share of the largest possible gain: at this pace it takes 2.5 times
the rounds of a straight flight, and a team should form in three times the lower bound."""


class Pace:
    """Average gain of a planner's waypoints towards the goal, each as a share of the largest possible gain.

    Waypoints at the goal, and of a robot whose straight path is blocked, do not count. A round that the robot holds
    because the planner was refused counts as no gain. A goal that travels and is within one step has to be reached:
    whoever always closes a share of the gap trails behind it for ever.
    """

    def __init__(self) -> None:
        self._average = 1.0

    def too_slow(self, question: StepQuestion, waypoint: Point) -> str | None:
        """Count a waypoint that passed its checks. Returns the reason to refuse it, or None."""
        mission, goal = question.mission, question.goal
        before, after = math.dist(question.position, goal), math.dist(waypoint, goal)
        if min(before, after) <= ROUNDING * mission.spacing or blocked(question):
            return None
        gain = (before - after) / min(mission.max_step, before)
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
        """Count a round in which the planner's answer was refused and nothing replaced it."""
        self._count(0.0)

    def _count(self, gain: float) -> None:
        weight = 0.25  # of the newest waypoint
        self._average += weight * (gain - self._average)
