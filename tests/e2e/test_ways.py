"""Swarms of processes, and drones on radio links, fly through a gap of 2.1 safe distances to their places."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from flights import yes
from swarms import fly, swarm_config

from llm_flock.arrays import Point
from llm_flock.obstacles import Obstacle, segment_clearance
from llm_flock.record._reader import read_record
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight

SAFE = 3.0


def wall(left: float, middle: float, high: float) -> list[dict[str, list[list[float]]]]:
    """Two boxes, 3 units wide, with the gap around a height."""
    low, up, right = middle - 1.05 * SAFE, middle + 1.05 * SAFE, left + 3
    below = [[left, -5.0], [right, -5.0], [right, low], [left, low]]
    return [{"polygon": below}, {"polygon": [[left, up], [right, up], [right, high + 5.0], [left, high + 5.0]]}]


def clearance(path: list[Point], obstacles: list[dict[str, list[list[float]]]]) -> float:
    stones = [Obstacle.model_validate(stone) for stone in obstacles]
    return min(segment_clearance(a, b, stones) for a, b in pairwise(path))


def test_a_swarm_of_processes(tmp_path: Path) -> None:
    obstacles = wall(55.0, 50.0, 100.0)
    room = {"center": (72, 50), "arena": ((0, 0), (120, 100)), "obstacles": obstacles, "start": "separated"}
    result = fly(swarm_config(3, start_area=((42, 42), (52, 58)), out=str(tmp_path), **room))
    assert result.formed and result.min_separation >= SAFE - 1e-6
    seen = np.array([state.positions for state in read_record(tmp_path / "run.mcap").states])
    assert seen[0, :, 0].max() < 55.0 and seen[-1, :, 0].min() > 58.0


def test_drones_with_a_radio() -> None:
    pytest.importorskip("cflib")
    from llm_flock_flight._testing.crtp import StandIns

    starts, obstacles = [(-0.4, -0.3, 0.0), (-0.4, 0.3, 0.0)], wall(13.0, 15.0, 30.0)
    room = {"shape": "line", "n_robots": 2, "center": [20, 15], "spacing": 6, "arena": [[0, 0], [30, 30]]}
    brisk = {"round_s": 0.6, "max_speed_m_s": 6.0, "take_off_s": 0.5, "land_s": 0.5, "settle_s": 0.3, "deadman": False}
    brisk["stall_s"] = 5.0  # the stand-ins share a busy machine, and this is about ways
    with StandIns(starts, controller=2) as stand_ins:  # Mellinger: none that lags is let fly so fast
        drones = [{"name": f"d{k}", "uri": uri, "start": starts[k][:2]} for k, uri in enumerate(stand_ins.uris)]
        mission = {"mission": {**room, "obstacles": obstacles}}
        fields = {
            "robot": "crazyflie",
            "drones": drones,
            "take_off_group": 2,
            "model": "geometry",
        }
        config = FlightConfig.build(mission, **brisk, **fields)
        result = asyncio.run(Flight(config, build_fleet(config)).run(yes)).result
    assert result is not None
    assert result.summary.formed and result.summary.flight is not None and result.summary.flight.safe
    # Where drones are is measured, and they follow their commands to within millimetres.
    assert result.summary.min_separation is not None and result.summary.min_separation >= SAFE - 0.05
    for robot in range(2):
        path = [tuple(row) for row in result.positions[:, robot].tolist()]
        assert path[0][0] < 13.0 and path[-1][0] > 16.0
        assert clearance(path, obstacles) >= SAFE / 2 - 0.05
