"""Agreement, lower bound and the definition of `formed`."""

import math
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from llm_flock.metrics import (
    FormedTracker,
    bottleneck_distance,
    deadline,
    distinct_goals,
    lower_bound_rounds,
    plans_in_use,
    robots_at_goal,
)


def test_plans_in_use_ignores_robots_without_one() -> None:
    assert plans_in_use(["a", "b", "a", None]) == 2
    assert plans_in_use([None, None]) == 0


def test_distinct_goals_are_pairs_of_plan_and_slot() -> None:
    assert distinct_goals(["a", "a", "a"], [0, 1, 1]) == 2
    assert distinct_goals(["a", "b"], [0, 0]) == 2
    assert distinct_goals(["a", "a", None, None], [0, None, 0, None]) == 1
    with pytest.raises(ValueError, match="zip"):
        distinct_goals(["a"], [0, 1])


def test_robots_at_goal_counts_up_to_five_percent_of_the_spacing() -> None:
    assert robots_at_goal([0.0, 0.5, 0.501, math.inf], spacing=10) == 2


@pytest.mark.parametrize("seed", range(20))
def test_bottleneck_is_the_best_of_all_assignments(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, dim = int(rng.integers(1, 7)), int(rng.integers(2, 4))
    # Half the cases on a lattice, where many distances are equal.
    start, goals = (
        rng.integers(0, 4, (n, dim)).astype(float) if seed % 2 else rng.uniform(0, 9, (n, dim)) for _ in "ab"
    )
    best = min(max(math.dist(start[i], goals[j]) for i, j in enumerate(order)) for order in permutations(range(n)))
    assert bottleneck_distance(start, goals) == pytest.approx(best, abs=1e-12)


def test_bottleneck_is_not_largest_distance_to_nearest_goal() -> None:
    """Both robots are nearest to the same goal, so one must go on to the other."""
    assert bottleneck_distance([(0, 0), (1, 0)], [(1, 0), (10, 0)]) == 9.0


@pytest.mark.parametrize(
    ("distance", "rounds"),
    [(0.0, 0), (1e-12, 0), (5.9, 1), (6.0, 1), (6 + 1e-11, 1), (6.001, 2), (18.0, 3), (60.0, 10)],
)
def test_lower_bound_rounds_up_but_not_for_rounding(distance: float, rounds: int) -> None:
    assert lower_bound_rounds([(0, 0)], [(distance, 0)], max_step=6) == rounds


def test_a_robot_that_is_near_enough_to_its_goal_has_arrived() -> None:
    assert lower_bound_rounds([(0, 0)], [(12.4, 0)], max_step=6, within=0.5) == 2
    assert lower_bound_rounds([(0, 0)], [(12.6, 0)], max_step=6, within=0.5) == 3
    assert lower_bound_rounds([(0, 0)], [(0.3, 0)], max_step=6, within=0.5) == 0
    along = [lower_bound_rounds([(0, 0)], [(8.0, 0)], 6, lambda k: (3.0 * k, 0.0), within=w) for w in (0.0, 2.5)]
    assert along == [3, 2], "a goal that moves away"


def test_the_deadline_is_three_times_the_lower_bound_and_twenty() -> None:
    assert [deadline(10), deadline(0)] == [50, 20]


IN_ORDER: dict[str, Any] = {
    "plan_ids": ["p", "p", "p"],
    "slots": [2, 0, 1],
    "goal_distances": [0.5, 0.0, 0.1],
    "residual": 1.0,
}


def but(**changes: Any) -> dict[str, Any]:
    """The state of a team in order, but for these changes."""
    return {**IN_ORDER, **changes}


def test_formed_is_the_first_of_three_rounds_in_order() -> None:
    tracker = FormedTracker(spacing=10)
    results = [tracker.update(t, **(IN_ORDER if t >= 4 else but(slots=[0, 0, 1]))) for t in range(9)]
    assert results == [False] * 6 + [True] * 3
    assert tracker.formed_at == 4


@pytest.mark.parametrize(
    "fault",
    [
        {"plan_ids": ["p", "q", "p"]},
        {"plan_ids": ["p", None, "p"]},
        {"plan_ids": [None, None, None]},
        {"slots": [2, 0, 2]},
        {"slots": [2, 0, None]},
        {"goal_distances": [0.5, 0.0, 0.51]},
        {"goal_distances": [0.5, 0.0, math.inf]},
        {"goal_distances": [0.5, 0.0, math.nan]},
        {"residual": 1.01},
        {"residual": math.nan},
    ],
)
def test_each_condition_is_needed(fault: dict[str, Any]) -> None:
    tracker = FormedTracker(spacing=10)
    for t in range(5):
        assert not tracker.update(t, **but(**fault))
        assert not tracker.in_order
    assert tracker.formed_at is None


def test_free_text_has_no_residual_to_meet() -> None:
    tracker = FormedTracker(spacing=10)
    assert [tracker.update(t, **but(residual=None)) for t in range(3)] == [False, False, True]


def test_disorder_starts_the_count_again() -> None:
    tracker = FormedTracker(spacing=10)
    for t, fine in enumerate([True, True, False, True, True, True]):
        tracker.update(t, **(IN_ORDER if fine else but(residual=2.0)))
    assert tracker.formed_at == 3


def test_a_missing_round_starts_the_count_again() -> None:
    tracker = FormedTracker(spacing=10)
    for t in (0, 1, 3, 4):
        assert not tracker.update(t, **IN_ORDER)
    assert tracker.update(5, **IN_ORDER)
    assert tracker.formed_at == 3


def test_later_disorder_leaves_a_formed_team_formed() -> None:
    tracker = FormedTracker(spacing=10)
    for t in range(3):
        tracker.update(t, **IN_ORDER)
    assert tracker.update(3, **but(residual=5.0))
    assert not tracker.in_order
    for t in range(4, 8):
        tracker.update(t, **IN_ORDER)
    assert tracker.formed_at == 0


def test_a_team_that_leaves_its_plan_has_to_form_again() -> None:
    tracker = FormedTracker(spacing=10)
    for t in range(4):
        tracker.update(t, **IN_ORDER)
    assert tracker.held and tracker.formed_at == tracker.since == 0
    # A robot is about to leave the plan.
    assert not tracker.update(4, **but(plan_ids=["p", None, "p"]))
    assert tracker.left and not tracker.held and tracker.formed_at is None
    for t in range(5, 7):
        assert not tracker.update(t, **IN_ORDER)
    # Another plan begins another series, though no round was out of order.
    for t in range(7, 9):
        assert not tracker.update(t, **but(plan_ids=["q"] * 3))
    assert tracker.update(9, **but(plan_ids=["q"] * 3))
    assert tracker.formed_at == tracker.since == 7 and not tracker.left


def test_rounds_only_go_forward() -> None:
    tracker = FormedTracker(spacing=10)
    tracker.update(3, **IN_ORDER)
    with pytest.raises(AssertionError, match="round 3 after round 3"):
        tracker.update(3, **IN_ORDER)


@pytest.mark.parametrize("seed", range(20))
def test_with_more_robots_or_more_goals_the_fewer_are_all_served(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robots, goals = int(rng.integers(1, 6)), int(rng.integers(1, 6))
    start, places = (
        rng.integers(0, 4, (n, 2)).astype(float) if seed % 2 else rng.uniform(0, 9, (n, 2)) for n in (robots, goals)
    )
    few, many = (start, places) if robots <= goals else (places, start)
    orders = permutations(range(len(many)), len(few))
    best = min(max(math.dist(few[i], many[j]) for i, j in enumerate(order)) for order in orders)
    assert bottleneck_distance(start, places) == pytest.approx(best, abs=1e-12)


def test_lower_bound_to_a_moving_plan_is_when_it_can_be_met() -> None:
    def bound(x: float, velocity: float) -> int:
        return lower_bound_rounds([(0, 0)], [(x, 0)], 6, lambda rounds: (velocity * rounds, 0.0))

    assert bound(18, 0) == lower_bound_rounds([(0, 0)], [(18, 0)], 6) == 3
    assert bound(18, 3) == 6 and bound(18.1, 3) == 7, "it flees at half the speed"
    assert bound(18, -3) == 2, "it comes to meet the robot"
    assert bound(0, 3) == 0


def test_spares_need_no_goal_and_unusable_places_no_robot() -> None:
    spare = but(slots=[2, 0, None], goal_distances=[0.5, 0.0, math.inf])
    for usable, fine in ((2, True), (3, False), (1, False)):
        tracker = FormedTracker(spacing=10)
        tracker.update(0, **spare, usable=usable)
        assert tracker.in_order is fine
    gaps = FormedTracker(spacing=10)
    gaps.update(0, **IN_ORDER, usable=5)
    assert gaps.in_order
