"""Whether a team has agreed and arrived: plans in use, distinct goals, the lower bound, and when it is `formed`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial.distance import cdist

from llm_flock.arrays import Point

AT_GOAL = 0.05
"""A robot is at its goal within this share of the spacing."""

IN_SHAPE = 0.1
"""A team is in shape when its mean error is at most this share of the spacing."""

HELD_ROUNDS = 3
"""A team is formed when it has been in order for so many rounds on end."""

ROUNDING = 1e-9
"""A bound that exceeds a whole number of rounds by less than this is that number."""


def plans_in_use(plan_ids: Sequence[str | None]) -> int:
    """Number of different plans in the team; robots without one do not count."""
    return len({plan for plan in plan_ids if plan is not None})


def distinct_goals(plan_ids: Sequence[str | None], slots: Sequence[int | None]) -> int:
    """Number of different goals, a plan and a slot of it each; robots without a goal do not count."""
    goals = zip(plan_ids, slots, strict=True)
    return len({(plan, slot) for plan, slot in goals if plan is not None and slot is not None})


def robots_at_goal(goal_distances: Sequence[float], spacing: float) -> int:
    """Number of robots within 5 % of the spacing of their goal.

    Args:
        goal_distances: each robot's distance from its goal [units], infinite for a robot without one.
        spacing: desired distance between neighbouring robots [units].
    """
    return sum(distance <= AT_GOAL * spacing for distance in goal_distances)


def bottleneck_distance(start: ArrayLike, goals: ArrayLike) -> float:
    """Smallest distance D such that each robot can have a goal of its own within D [units], exactly.

    Where there are more robots than goals, each goal gets a robot of its own instead.

    Args:
        start: positions, shape (n, d) [units].
        goals: shape (m, d) [units].
    """
    apart = cdist(np.asarray(start, dtype=np.float64), np.asarray(goals, dtype=np.float64))
    robots, places = apart.shape
    wanted = min(robots, places)
    # Nobody can do better than the nearest goal, and no goal better than the nearest robot.
    to_goal = float(apart.min(axis=1).max()) if robots == wanted else 0.0
    to_robot = float(apart.min(axis=0).max()) if places == wanted else 0.0
    least = max(to_goal, to_robot)
    candidates = np.unique(apart[apart >= least])
    low, high = 0, len(candidates) - 1
    while low < high:
        middle = (low + high) // 2
        partner = maximum_bipartite_matching(csr_array(apart <= candidates[middle]), perm_type="column")
        found = int((np.asarray(partner) >= 0).sum())
        low, high = (middle + 1, high) if found < wanted else (low, middle)
    return float(candidates[low])


def lower_bound_rounds(
    start: ArrayLike, plan_points: ArrayLike, max_step: float, drift: Callable[[int], Point] | None = None
) -> int:
    """Rounds that any team needs from its start to the agreed plan, were it perfectly assigned and never in its way.

    Args:
        start: positions at the start, shape (n, d) [units].
        plan_points: shape (m, d) [units].
        max_step: longest move in one round [units].
        drift: how far the plan has travelled so many rounds after the start [units], at most max_step / 2 in each;
            None where it stands still.
    """
    if drift is None:
        return max(0, math.ceil(bottleneck_distance(start, plan_points) / max_step - ROUNDING))
    points = np.asarray(plan_points, dtype=np.float64)
    rounds = 0
    while bottleneck_distance(start, points + drift(rounds)) > (rounds + ROUNDING) * max_step:
        rounds += 1
    return rounds


def within_limit(rounds_to_formed: int, lower_bound: int) -> bool:
    """Whether a team formed in time: within three times the lower bound plus 20 rounds."""
    return rounds_to_formed <= 3 * lower_bound + 20


@dataclass(slots=True, kw_only=True)
class FormedTracker:
    """Watches a run round by round, and notes when the team has formed.

    A team is in order when all robots are on one plan, as many of them as there are places (or robots, if those are
    fewer) have goals of their own, stand within 5 % of the spacing of them, and, where the ideal shape is known, are
    within 10 % of the spacing of it on average. It has formed when it was in order for three rounds on end; the first
    of the three counts, and later disorder does not take it back.

    Attributes:
        spacing: desired distance between neighbouring robots [units].
        in_order: whether the team was in order in the last round seen.
        formed_at: first of the first three rounds in order on end; None as long as there were none.
    """

    spacing: float
    in_order: bool = field(default=False, init=False)
    formed_at: int | None = field(default=None, init=False)
    _since: int | None = field(default=None, init=False)
    _last: int | None = field(default=None, init=False)

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
        """Take note of the state at the end of a round; True once the team has formed.

        Args:
            round_number: higher than in the call before; a round that is left out breaks the series.
            plan_ids: each robot's plan, None for a robot without one. Robots that are not awake are in no list.
            slots: each robot's place in its plan, None for a robot without one.
            goal_distances: each robot's distance from its goal [units], infinite without one.
            residual: mean error to the ideal shape [units], None where no ideal is known.
            usable: places of the plan that a robot can take; one for each robot if left out.
        """
        assert self._last is None or round_number > self._last, f"round {round_number} after round {self._last}"
        on_end = self._last is not None and round_number == self._last + 1
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
        self._since = None if not self.in_order else self._since if on_end and self._since is not None else round_number
        self._last = round_number
        if self.formed_at is None and self._since is not None and round_number - self._since + 1 >= HELD_ROUNDS:
            self.formed_at = self._since
        return self.formed_at is not None
