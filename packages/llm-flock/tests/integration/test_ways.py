"""Whole runs among obstacles: every robot finds its way, and no model sends it through a wall."""

from __future__ import annotations

import math
from typing import Any

import pytest

import llm_flock
from llm_flock.obstacles import Obstacle

SAFE = 3.0
LEFT = ((5.0, 20.0), (35.0, 80.0))
POCKET = ((10, 20), (55, 20), (55, 80), (10, 80), (10, 75), (50, 75), (50, 25), (10, 25))


def box(left: float, low: float, right: float, high: float) -> Obstacle:
    return Obstacle(polygon=((left, low), (right, low), (right, high), (left, high)))


def ball(x: float, y: float, z: float, radius: float) -> Obstacle:
    return Obstacle(center=(x, y, z), radius=radius)


PLANE: dict[str, Any] = {
    "shape": "circle",
    "n_robots": 5,
    "center": (85.0, 50.0),
    "arena": ((0.0, 0.0), (120.0, 100.0)),
}
RING = [[80.0, 50 + 10 * math.cos(k * math.pi / 2), 30 + 10 * math.sin(k * math.pi / 2)] for k in range(4)]
BLOCK = ((0.0, 0.0, 0.0), (100.0, 100.0, 60.0))
SPACE: dict[str, Any] = {"points": RING, "center": (80.0, 50.0, 30.0), "arena": BLOCK}
CASES = {
    "a gap": (PLANE, LEFT, [box(55, -5, 58, 46.85), box(55, 53.15, 58, 105)]),
    "a pocket": (PLANE, ((22.0, 32.0), (48.0, 68.0)), [Obstacle(polygon=POCKET)]),
    "a maze": (PLANE, LEFT, [box(42, -5, 45, 70), box(62, 30, 65, 105)]),
    "a ball": (SPACE, ((5.0, 30.0, 10.0), (25.0, 70.0, 50.0)), [ball(50, 50, 30, 12)]),
    "a column": (SPACE, ((5.0, 30.0, 10.0), (25.0, 70.0, 50.0)), [ball(50, 50, 5 + 8 * k, 6) for k in range(7)]),
}


@pytest.mark.parametrize(
    ("case", "model"), [*((case, "simulated:overshoot") for case in CASES), ("a gap", "simulated:ideal")]
)
def test_a_team_flies_round_what_is_in_between(case: str, model: str) -> None:
    fields, area, obstacles = CASES[case]
    mission = llm_flock.Mission(**fields, obstacles=tuple(obstacles))
    figures = llm_flock.run(mission, model=model, seed=5, start_area=area).summary
    assert figures.formed and figures.lower_bound_rounds is not None
    assert figures.min_separation is not None and figures.min_separation >= SAFE - 1e-6
    assert figures.min_clearance is not None and figures.min_clearance >= SAFE / 2 - 1e-6
    assert figures.waypoints["yield"] <= 0.1 * sum(figures.waypoints.values())


@pytest.mark.parametrize(
    ("shape", "n", "room", "seed"),
    [
        ("line", 7, 1.05, 1),
        ("circle", 10, 1.05, 3),
        ("grid", 16, 1.05, 2),
        ("line", 7, 1.0, 12),
        ("line", 7, 1.0, 13),
        ("grid", 16, 1.0, 21),
    ],
)
def test_a_formation_as_tight_as_the_safe_distance_fills_up(shape: str, n: int, room: float, seed: int) -> None:
    """Beside another robot, a place is approached by halves; that is progress, and no robot has to step aside."""
    mission = llm_flock.Mission(shape=shape, n_robots=n, spacing=room * SAFE)
    figures = llm_flock.run(mission, model="simulated:ideal", seed=seed).summary
    assert figures.formed
    assert figures.min_separation is not None and figures.min_separation >= SAFE - 1e-6


def test_a_spacing_without_room_to_move_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    for spacing in (3.16, 3.15, 3.1):
        llm_flock.run(llm_flock.Mission(shape="line", n_robots=2, spacing=spacing), model="geometry", rounds=0)
    (warning,) = [record.message for record in caplog.records if "room to move" in record.message]
    assert warning.startswith("spacing = 3.1 ") and "a spacing of 3.15 would do" in warning
