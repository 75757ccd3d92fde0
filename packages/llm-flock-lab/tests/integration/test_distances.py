"""What a trial of a sweep measures beyond its run's own summary."""

from __future__ import annotations

import asyncio
import itertools
import math
from typing import Any

import numpy as np
import pytest

import llm_flock
from llm_flock.runtime import build_config
from llm_flock_lab._experiments.grid import Cell
from llm_flock_lab._experiments.trial import fly


def summary(**options: Any) -> dict[str, Any]:
    result, _ = asyncio.run(fly(Cell(config=build_config(**options)).trial(options["seed"])))
    assert result.summary is not None
    return result.summary


def test_distance_flown_and_the_least_from_start_to_plan() -> None:
    options: dict[str, Any] = {"shape": "triangle", "n_robots": 3, "seed": 4}
    found, run = summary(**options), llm_flock.run(**options)
    assert found["distance_flown"] == pytest.approx(np.linalg.norm(np.diff(run.positions, axis=0), axis=2).sum())
    plan = run.plans[0]
    assert plan is not None
    apart = np.linalg.norm(run.positions[0][:, None] - plan.array, axis=2)
    least = min(apart[[0, 1, 2], list(order)].sum() for order in itertools.permutations(range(3)))
    assert found["distance_least"] == pytest.approx(least)
    assert found["distance_flown"] >= found["distance_least"] - 3 * 0.05 * run.mission.spacing


def test_without_one_plan_that_stands_there_is_no_least_distance() -> None:
    assert summary(n_robots=3, shape="triangle", seed=1, protocol="baseline", rounds=2)["distance_least"] is None
    moving = summary(n_robots=3, shape="triangle", seed=1, velocity=(1.0, 0.0))
    assert moving["distance_least"] is None and math.isfinite(moving["distance_flown"])


def test_a_place_that_cannot_be_reached_has_no_distance() -> None:
    wall = {"polygon": [(49.0, -5.0), (51.0, -5.0), (51.0, 105.0), (49.0, 105.0)]}
    area = ((5.0, 30.0), (40.0, 70.0))
    options = {"shape": "triangle", "n_robots": 3, "seed": 1, "rounds": 3, "obstacles": [wall], "start_area": area}
    found = summary(**options, center=(75.0, 50.0))
    assert found["distance_least"] is None and not found["formed"]
