"""Drones with real dynamics; skipped without crazyflow, or without SCIPY_ARRAY_API=1 (docs/explanation/physics.md)."""

from __future__ import annotations

import asyncio
import os
from importlib.util import find_spec
from typing import Literal

import numpy as np
import pytest

from llm_flock.testing import check_emergency_stop, check_robot
from llm_flock_flight._physics import STEP_S, PhysicsWorld

pytestmark = [
    pytest.mark.skipif(find_spec("crazyflow") is None, reason="crazyflow is not installed"),
    pytest.mark.skipif(os.environ.get("SCIPY_ARRAY_API") != "1", reason="SCIPY_ARRAY_API is not 1"),
    pytest.mark.filterwarnings("default"),
]
HOMES = [(0.0, 0.0, 0.0), (0.6, 0.0, 0.0), (1.2, 0.0, 0.0)]


class Hand:
    """A clock that is set by hand."""

    time_s = 0.0

    def __call__(self) -> float:
        return self.time_s


@pytest.mark.parametrize(("controller", "least", "most"), [("mellinger", 0.0, 0.05), ("pid", 0.05, 0.15)])
def test_a_flight_follows_its_set_points_and_lands(
    controller: Literal["mellinger", "pid"], least: float, most: float
) -> None:
    clock = Hand()
    world = PhysicsWorld(HOMES, clock=clock, controller=controller)
    errors: list[float] = []

    def until(time_s: float) -> None:
        while clock.time_s < time_s:
            clock.time_s += STEP_S
            world.run_until(clock.time_s + STEP_S / 2)
            errors.extend(np.linalg.norm(world.positions - world.targets, axis=1).tolist())

    for body in world.bodies:
        assert body.arm(True) and body.take_off(0.5, 2.0, clock()) == 0
    until(3.0)
    assert all(p == pytest.approx(0.5, abs=0.06) for p in world.positions[:, 2])
    for body in world.bodies:
        assert body.go_to((body.home[0], 0.6, 0.5), 2.0, clock()) == 0
    until(4.0)
    assert 0.02 < world.positions[0, 1] < 0.5, "it takes time"
    until(6.0)
    assert world.positions[:, 1] == pytest.approx(0.6, abs=0.03)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert least < rms < most, "the stock controller lags behind moving set-points"
    for body in world.bodies:
        assert body.land(0.0, 2.0, clock()) == 0
    until(8.5)
    assert not any(body.flying for body in world.bodies)
    assert [body.position(clock())[2] for body in world.bodies] == [0.0, 0.0, 0.0]


def test_the_driver_keeps_the_contract():
    with PhysicsWorld(HOMES[:1]) as world:
        asyncio.run(check_robot(world.robot(0, "one"), tolerance_m=0.1, patience_s=3.0))


def test_driver_obeys_an_emergency_stop():
    with PhysicsWorld(HOMES[:1]) as world:
        asyncio.run(check_emergency_stop(world.robot(0, "one")))
