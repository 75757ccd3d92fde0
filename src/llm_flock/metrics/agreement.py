"""Metrics of agreement and arrival: plans in use, distinct goals, the lower bound, and whether a team has formed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike

from llm_flock.arrays import Pairwise, Point, Points

AT_GOAL = 0.05
"""Largest distance at which a robot counts as at its goal, as a share of the spacing."""

IN_SHAPE = 0.1
"""Largest mean error at which a team counts as in shape, as a share of the spacing."""

HELD_ROUNDS = 3
"""Number of consecutive rounds in order after which a team has formed."""

ROUNDING = 1e-9
"""A lower bound that exceeds a whole number of rounds by less than this is rounded down [rounds]."""


def plans_in_use(plan_ids: Sequence[str | None]) -> int:
    """Number of different plans in the team, without robots that have none."""
    return len({plan for plan in plan_ids if plan is not None})


def distinct_goals(plan_ids: Sequence[str | None], slots: Sequence[int | None]) -> int:
    """Number of different goals, each a plan and a slot, without robots that have none."""
    goals = zip(plan_ids, slots, strict=True)
    return len({(plan, slot) for plan, slot in goals if plan is not None and slot is not None})


def robots_at_goal(goal_distances: Sequence[float], spacing: float) -> int:
    """Number of robots whose distance from their goal is at most 5 % of the spacing."""
    return sum(distance <= AT_GOAL * spacing for distance in goal_distances)


Ways: TypeAlias = Callable[[Points, Points], Pairwise]
"""Lengths of the ways from each of some positions to each of some goals, shape (n, m) [units]."""


def straight(start: Points, goals: Points) -> Pairwise:
    """Straight distances from each of some positions to each of some goals, shape (n, m) [units]."""
    return scipy.spatial.distance.cdist(start, goals)


def bottleneck_distance(start: ArrayLike, goals: ArrayLike, ways: Ways = straight) -> float:
    """Smallest distance D for which all robots can have different goals within D [units], exactly.

    With more robots than goals, the smallest D for which all goals can have different robots. `ways` measures
    distances, straight ones by default.
    """
    apart = ways(np.asarray(start, dtype=np.float64), np.asarray(goals, dtype=np.float64))
    robots, places = apart.shape
    wanted = min(robots, places)
    # No robot can do better than its nearest goal, and no goal better than its nearest robot.
    to_goal = float(apart.min(axis=1).max()) if robots == wanted else 0.0
    to_robot = float(apart.min(axis=0).max()) if places == wanted else 0.0
    least = max(to_goal, to_robot)
    candidates = np.unique(apart[apart >= least])
    low, high = 0, len(candidates) - 1
    while low < high:
        middle = (low + high) // 2
        partner = scipy.sparse.csgraph.maximum_bipartite_matching(
            scipy.sparse.csr_array(apart <= candidates[middle]), perm_type="column"
        )
        found = int((np.asarray(partner) >= 0).sum())
        low, high = (middle + 1, high) if found < wanted else (low, middle)
    return float(candidates[low])


def lower_bound_rounds(
    start: ArrayLike,
    plan_points: ArrayLike,
    max_step: float,
    drift: Callable[[int], Point] | None = None,
    *,
    within: float = 0.0,
    ways: Ways = straight,
) -> int:
    """Smallest number of rounds from the start to the agreed plan, with a perfect assignment and nobody in the way.

    Args:
        start: positions at the start.
        plan_points: places of the plan, as many or not.
        max_step: longest move in one round.
        drift: displacement of the plan after a number of rounds [units], at most max_step / 2 per round; None for a
            plan that stands still.
        within: distance at which a robot counts as at its goal [units].
        ways: lengths of ways to a plan that stands still: round obstacles, for instance.
    """
    if drift is None:
        return max(0, math.ceil((bottleneck_distance(start, plan_points, ways) - within) / max_step - ROUNDING))
    points = np.asarray(plan_points, dtype=np.float64)
    rounds = 0
    while bottleneck_distance(start, points + drift(rounds)) > (rounds + ROUNDING) * max_step + within:
        rounds += 1
    return rounds


def deadline(lower_bound: int) -> int:
    """Rounds within which a team should form: three times the lower bound, plus 20."""
    return 3 * lower_bound + 20


@dataclass(slots=True, kw_only=True)
class FormedTracker:
    """Determines the round in which a team has formed. Call `update` at the end of every round.

    A team is in order if all robots follow one plan; as many robots as there are places (or all robots, if they are
    fewer) have different goals and are within 5 % of the spacing of them; and the mean error to the ideal shape, if
    known, is at most 10 % of the spacing. The team has formed after three consecutive rounds in order. The first of
    the three counts, and later disorder does not change it.

    Attributes:
        in_order: whether the team was in order in the last round.
        formed_at: first of the first three consecutive rounds in order; None before.
    """

    spacing: float
    in_order: bool = field(default=False, init=False)
    formed_at: int | None = field(default=None, init=False)
    _since: int | None = field(default=None, init=False)
    _last: int = field(default=-1, init=False)

    def update(
        self,
        round_number: int,
        *,
        plan_ids: Sequence[str | None],
        slots: Sequence[int | None],
        goal_distances: Sequence[float],
        residual: float | None,
        usable: int | None = None,
    ) -> bool:
        """Add the state at the end of a round. All lists leave out robots that are not awake.

        Args:
            round_number: higher than in the last call; a missing round breaks the series.
            plan_ids: each robot's plan.
            slots: each robot's slot in its plan.
            goal_distances: each robot's distance from its goal [units].
            residual: mean error to the ideal shape [units]; None if no ideal is known.
            usable: number of places of the plan that robots can take; None for one per robot.

        Returns:
            Whether the team has formed.
        """
        assert round_number > self._last, f"round {round_number} after round {self._last}"
        n = len(plan_ids)
        owners = sum(slot is not None for slot in slots)
        self.in_order = (
            None not in plan_ids
            and plans_in_use(plan_ids) == 1
            and owners == (n if usable is None else min(n, usable))
            and distinct_goals(plan_ids, slots) == owners
            and robots_at_goal(goal_distances, self.spacing) == owners
            and (residual is None or residual <= IN_SHAPE * self.spacing)
        )
        if not self.in_order:
            self._since = None
        elif self._since is None or round_number != self._last + 1:
            self._since = round_number
        self._last = round_number
        if self.formed_at is None and self._since is not None and round_number - self._since + 1 >= HELD_ROUNDS:
            self.formed_at = self._since
        return self.formed_at is not None
