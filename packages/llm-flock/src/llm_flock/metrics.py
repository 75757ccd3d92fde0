"""Metrics of a run: agreement, whether the team has formed, separation, and shape error.

Points have the shape (n, d), lengths are in mission units. Lists have an item for each robot: None for a robot without
a plan or a slot, an infinite distance for a robot without a goal.

The paper's Procrustes error (Error(t), line 236; appendix, lines 573-645) does not say which robot belongs to which
target point. Here correspondence and rotation minimise the sum of squares jointly.
"""

from __future__ import annotations

import cmath
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from llm_flock import shapes as formations
from llm_flock.arrays import Pairwise, Point, Points, Vector, flattened
from llm_flock.correspondence import as_complex, longest, proven_match
from llm_flock.errors import InputError

AT_GOAL = 0.05
"""Largest distance at which a robot counts as at its goal, as a share of the spacing."""

IN_SHAPE = 0.1
"""Largest mean error at which a team counts as in shape, as a share of the spacing."""

HELD_ROUNDS = 3
"""Number of consecutive rounds in order after which a team has formed."""


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
        matched = int((np.asarray(partner) >= 0).sum())
        low, high = (middle + 1, high) if matched < wanted else (low, middle)
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
    """Smallest number of rounds from the start to the agreed plan, with a perfect assignment and no robot in the way.

    Args:
        start: positions at the start.
        plan_points: places of the plan, as many or not.
        max_step: longest move in one round.
        drift: displacement of the plan after a number of rounds [units], at most max_step / 2 per round; None for a
            plan that stands still.
        within: distance at which a robot counts as at its goal [units].
        ways: lengths of ways to a plan that stands still: round obstacles, for instance.
    """
    rounding = 1e-9  # a bound less than this above a whole number of rounds is rounded down
    if drift is None:
        return max(0, math.ceil((bottleneck_distance(start, plan_points, ways) - within) / max_step - rounding))
    points = np.asarray(plan_points, dtype=np.float64)
    rounds = 0
    while bottleneck_distance(start, points + drift(rounds)) > (rounds + rounding) * max_step + within:
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
    the three counts. Later disorder does not change it, but a team that leaves its plan for another one has to form
    again.
    """

    spacing: float
    #: First of the consecutive rounds in order up to the last round; None if that was not in order.
    since: int | None = field(default=None, init=False)
    left: bool = field(default=False, init=False)  #: Whether robots have left the plan of the last round in order.
    #: First of the first three consecutive rounds in order; None before, and after the team has left their plan.
    formed_at: int | None = field(default=None, init=False)
    _plan: str | None = field(default=None, init=False)  # of the last round in order
    _last: int = field(default=-1, init=False)

    @property
    def in_order(self) -> bool:
        """Whether the team was in order in the last round."""
        return self.since is not None

    @property
    def held(self) -> bool:
        """Whether the team has been in order for three consecutive rounds up to the last one."""
        return self.since is not None and self._last - self.since + 1 >= HELD_ROUNDS

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
            plan_ids: each robot's plan; None for a robot that has none, or is about to leave it.
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
        in_order = (
            None not in plan_ids
            and plans_in_use(plan_ids) == 1
            and owners == (n if usable is None else min(n, usable))
            and distinct_goals(plan_ids, slots) == owners
            and robots_at_goal(goal_distances, self.spacing) == owners
            and (residual is None or residual <= IN_SHAPE * self.spacing)
        )
        self.left = self._plan is not None and {*plan_ids} != {self._plan}
        if not in_order:
            self.since = None
        elif self.since is None or self.left or round_number != self._last + 1:
            self.since, self._plan = round_number, plan_ids[0]
        self._last = round_number
        if self.left:
            self.formed_at = None
        if self.formed_at is None and self.held:
            self.formed_at = self.since
        return self.formed_at is not None


ROUNDING = 1e-6
"""A pair nearer than allowed by up to this still counts as separated [units]."""


def min_separation(positions: ArrayLike, downwash: float = 1.0) -> float:
    """Distance of the closest pair, by the norm of `arrays.flattened` [units]; infinite for a single robot."""
    return formations.smallest_distance(flattened(positions, downwash))


def segment_separation(
    before: ArrayLike,
    after: ArrayLike,
    without: frozenset[tuple[int, int]] = frozenset(),
    *,
    downwash: float = 1.0,
) -> float:
    """Smallest distance of any pair during a lockstep round, as `min_separation` [units]; infinite for a single robot.

    All robots start and arrive together, on straight segments at constant speed. A pair with offset p and change of
    offset v over the round is nearest after the share t = -<p, v> / |v|^2 of the round, clipped to 0 .. 1. Pairs
    (lower id, higher id) in `without` are left out.
    """
    start, end = flattened(before, downwash), flattened(after, downwash)
    if len(start) < 2:
        return math.inf
    few = len(start) <= 200 or bool(without)  # beyond, a k-d tree selects the pairs that can come near
    one, two = _pairs(len(start)) if few else _near_pairs(start, end)
    if without:
        kept = np.array([pair not in without for pair in zip(one.tolist(), two.tolist(), strict=True)])
        one, two = one[kept], two[kept]
        if len(one) == 0:
            return math.inf
    move = end - start
    closest = _closest(start[one] - start[two], move[one] - move[two])
    return math.sqrt(float((closest * closest).sum(axis=1).min()))


def passing_distances(before: Points, after: Points, start: Vector, end: Vector) -> Vector:
    """Smallest distance of each robot from a body that flies from `start` to `end` in step, shape (n,) [units]."""
    return np.linalg.norm(_closest(before - start, (after - before) - (end - start)), axis=1)


def _closest(offset: Points, change: Points) -> Points:
    """The shortest offset while each changes evenly by `change`."""
    squared = (change * change).sum(axis=1)
    share = np.clip(-(offset * change).sum(axis=1) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    return offset + share[:, None] * change


@functools.lru_cache(maxsize=16)
def _pairs(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of all pairs of n robots, the lower one first. Cached: do not modify."""
    one, two = np.triu_indices(n, 1)
    return one, two


def _near_pairs(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs that include the one that comes nearest.

    A robot is always within half a segment of its segment's midpoint. The nearest pair is at most as far apart as the
    closest pair at the start or the end, so its midpoints are at most that distance plus the longest segment apart.
    """
    known = min(min_separation(start), min_separation(end))
    longest = float(np.linalg.norm(end - start, axis=1).max())
    reach = (known + longest) * (1 + 1e-9)
    pairs = np.asarray(scipy.spatial.KDTree((start + end) / 2).query_pairs(reach, output_type="ndarray"))
    return pairs[:, 0], pairs[:, 1]


class StartSeparation:
    """Separation of a run without the pairs that start too close. Call `update` for the start and after every round.

    A pair that starts nearer than the safe distance is left out until it has first been separated.

    Attributes:
        start_violations: number of pairs that are too close at the start.
        separated_at: first round after which all of these pairs have been separated; 0 without such pairs, None before.
        smallest: smallest distance of any pair from its first separation on, including along segments [units].
    """

    def __init__(self, safe_distance: float, downwash: float = 1.0) -> None:
        self._limit, self._downwash = safe_distance - ROUNDING, downwash
        self._together: frozenset[tuple[int, int]] = frozenset()
        self._before: NDArray[np.float64] | None = None
        self.start_violations = 0
        self.separated_at: int | None = None
        self.smallest = math.inf

    def update(self, round_number: int, positions: NDArray[np.float64], closest: float) -> None:
        """Add a round (0 is the start), its last positions, and the smallest distance in it, segments included."""
        positions = flattened(positions, self._downwash)
        if self._before is None:
            self._before = positions
            self._together = frozenset(scipy.spatial.KDTree(positions).query_pairs(self._limit))
            self.start_violations = len(self._together)
        if self._together:
            closest = segment_separation(self._before, positions, self._together)
        self.smallest = min(self.smallest, closest)
        self._together = frozenset(
            (i, j) for i, j in self._together if math.dist(positions[i], positions[j]) < self._limit
        )
        self._before = positions
        if self.separated_at is None and not self._together:
            self.separated_at = round_number


LARGE = 300
"""Number of points above which `proven_match` is tried first, because `longest` costs O(n^3) many times."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeError:
    """Distance of a team from an ideal shape after the best translation, rotation and correspondence."""

    mean: float  #: Mean distance of a robot from its target point [units] (paper, line 236).
    mean_squared: float  #: Mean of the squared distances [units^2] (paper, line 637).
    assignment: tuple[int, ...]  #: For each robot, the index of its target point; a permutation of 0 .. n - 1.
    rotation: NDArray[np.float64]  #: Rotation of centred positions onto centred targets, shape (d, d), determinant +1.


class ShapeTarget:
    """An ideal shape for comparison with many teams; computes only once what depends on the shape alone.

    Args:
        target: ideal points, shape (n, d) [units], d = 2 or 3, in any position and orientation.
        turns: whether teams may have any orientation, or only that of the target.

    Raises:
        InputError: the points do not have this shape, or are not finite.
    """

    def __init__(self, target: ArrayLike, *, turns: bool = True) -> None:
        self._turns = turns
        rows = _rows("target", target)
        self._target = rows - rows.mean(axis=0)
        self._symmetry = formations.rotational_symmetry(rows, tolerance=1e-12)

    def error(self, positions: ArrayLike) -> ShapeError:
        """The team's distance from the shape: the global minimum for d = 2, a local minimum for d = 3.

        If several correspondences are equally good, the choice is arbitrary but repeatable. Their `mean_squared` is
        the same; their `mean` may differ.

        Args:
            positions: shape (n, d) [units], the shape of the target.

        Raises:
            InputError: the positions do not have this shape, or are not finite.
        """
        rows, shape = _rows("positions", positions), self._target.shape
        if rows.shape != shape:
            raise InputError("positions", rows.shape, f"an array of shape {shape}, the shape of the target")
        rows = rows - rows.mean(axis=0)
        if not self._turns:
            apart = scipy.spatial.distance.cdist(rows, self._target)
            columns, rotation = scipy.optimize.linear_sum_assignment(apart**2)[1], np.eye(rows.shape[1])
        elif rows.shape[1] == 2:
            columns, rotation = self._best_in_plane(rows)
        else:
            from llm_flock.correspondence import best_in_space

            columns, rotation = best_in_space(rows, self._target)
        squared = ((rows @ rotation.T - self._target[columns]) ** 2).sum(axis=1)
        return ShapeError(
            mean=float(np.sqrt(squared).mean()),
            mean_squared=float(squared.mean()),
            assignment=tuple(columns.tolist()),
            rotation=rotation,
        )

    def _best_in_plane(self, rows: Points) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        best = proven_match(rows, self._target, self._symmetry) if len(rows) > LARGE else None
        if best is None:
            best = longest(as_complex(rows), as_complex(self._target), self._symmetry)
        angle = cmath.phase(best.z)
        cos, sin = math.cos(angle), math.sin(angle)
        return best.columns, np.array([[cos, -sin], [sin, cos]])


def _rows(field: str, values: ArrayLike) -> Points:
    rows = np.asarray(values, dtype=np.float64)
    if rows.ndim != 2 or not len(rows) or rows.shape[1] not in (2, 3):
        raise InputError(field, rows.shape, "an array of shape (n, 2) or (n, 3)")
    if not np.isfinite(rows).all():
        raise InputError(field, rows.tolist(), "finite numbers")
    return rows
