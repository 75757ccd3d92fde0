"""Whole runs in which robots die and join, places are short, missions change and centres move: formed, and safe."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import llm_flock

CIRCLE = llm_flock.Mission(shape="circle", n_robots=8)
SEEDS = range(3)
SAFE = 3 - 1e-6


def flown(mission: llm_flock.Mission, seed: int, **options: Any) -> llm_flock.RunResult:
    """A run that has to form, and to keep the safe distance all the way."""
    given: dict[str, Any] = {"model": "geometry", "rounds": 150, **options}
    result = llm_flock.run(mission, seed=seed, **given)
    figures = result.summary
    assert figures.rounds_to_formed is not None, (figures.plans_in_use, figures.distinct_goals)
    assert figures.min_separation is not None and figures.min_separation >= SAFE
    assert figures.plans_in_use == 1
    return result


@pytest.mark.parametrize("seed", SEEDS)
def test_those_left_form_with_a_gap(seed: int) -> None:
    figures = flown(CIRCLE, seed, kill="3@5", gaps="report").summary
    assert (figures.distinct_goals, figures.gaps) == (7, 1)


@pytest.mark.parametrize("seed", SEEDS)
def test_those_left_form_a_smaller_shape(seed: int) -> None:
    result = flown(CIRCLE, seed, kill="3@5", gaps="replan")
    assert (result.summary.distinct_goals, result.summary.gaps) == (7, 0)
    assert result.summary.procrustes_mean is not None and result.summary.procrustes_mean <= 0.1 * CIRCLE.spacing


ORDER = {"round": 64, "robot": 0, "set": {"center": (20, 50)}}


@pytest.mark.parametrize("rounds", [73, 79, None])
def test_a_team_that_is_about_to_replan_has_not_formed(rounds: int | None) -> None:
    """Robot 2 misses a death: in rounds 71 to 75 all stand in a plan for three that it will replace by one for four."""
    deaths = "3@14,4@50,5@29,6@58,7@49"
    result = llm_flock.run(
        CIRCLE, model="simulated:ideal", seed=103, gaps="replan", kill=deaths, changes=[ORDER], rounds=rounds
    )
    record = result.record()
    assert all(row.in_order_since is None for row in record.metrics[71:76])
    assert result.formed is (rounds is None)
    if rounds is None:  # it ends as soon as the last plan has been held for three rounds
        formed = result.summary.missions[-1].formed
        assert formed is not None and [row.in_order_since for row in record.metrics[-3:]] == [formed] * 3
        assert result.summary.rounds == formed + 2 and record.metrics[formed - 1].in_order_since is None


@pytest.mark.parametrize("seed", SEEDS)
def test_robot_that_joins_late_completes_the_shape(seed: int) -> None:
    figures = flown(CIRCLE, seed, join="2@15").summary
    assert (figures.distinct_goals, figures.gaps) == (8, 0)
    assert figures.procrustes_mean is not None and figures.procrustes_mean <= 0.1 * CIRCLE.spacing


@pytest.mark.parametrize("seed", SEEDS)
def test_spare_robots_block_no_place(seed: int) -> None:
    figures = flown(llm_flock.Mission(shape="circle", n_robots=8, places=6), seed).summary
    assert (figures.gaps, figures.spares) == (0, 2)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_shape_changes_in_flight(seed: int) -> None:
    change = {"round": 8, "robot": 1, "set": {"shape": "square"}}
    result = flown(CIRCLE, seed, changes=[change])
    assert result.summary.missions[-1].formed is not None and result.summary.distinct_goals == 8
    assert result.summary.procrustes_mean is not None and result.summary.procrustes_mean <= 0.1 * CIRCLE.spacing


@pytest.mark.parametrize("seed", SEEDS)
def test_formed_moving_team_keeps_shape_heading_and_spacing(seed: int) -> None:
    velocity = (1.5, 0.5)
    mission = llm_flock.Mission(
        shape="circle", n_robots=6, center=(30, 40), velocity=velocity, arena=((0, 0), (300, 200))
    )
    starts = tuple((12.0 + 12.0 * (k % 3), 30.0 + 12.0 * (k // 3) + seed) for k in range(6))
    result = flown(mission, seed, start_positions=starts, rounds=70, stop_when_formed=False)
    formed = result.summary.missions[0].formed
    assert formed is not None and formed <= 40
    later = result.positions[formed:]
    assert result.errors[formed:].max() < 0.1 * mission.spacing
    centers = later.mean(axis=1)
    assert np.allclose(np.diff(centers, axis=0), velocity, atol=0.1)
    expected = np.array([mission.at(k).center for k in range(formed, formed + len(later))])
    assert np.linalg.norm(centers - expected, axis=1).max() < 0.1 * mission.spacing
    assert np.linalg.norm((later - centers[:, None]) - (later[0] - centers[0]), axis=2).max() < 0.1 * mission.spacing


def test_a_large_team_in_contact_forms_nearly_as_fast_as_can_be() -> None:
    mission = llm_flock.Mission(shape="circle", n_robots=30, arena=((0, 0), (120, 120)), center=(60, 60))
    summary = llm_flock.run(mission, start="connected", seed=0, rounds=60).summary
    assert summary.formed and summary.rounds_to_formed is not None and summary.lower_bound_rounds is not None
    assert summary.rounds_to_formed <= 1.4 * summary.lower_bound_rounds + 1
    assert summary.min_separation is not None and summary.min_separation >= mission.safe_distance - 1e-6
