"""The flights of test_sitl.py on stand-ins with what real firmware in the loop had, and this project's had not."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

pytest.importorskip("cflib")

from sitl import everybody_down, fly_together, robots_at

from llm_flock.testing import check_robot
from llm_flock_flight._testing.crtp import StandIns

pytestmark = pytest.mark.clock(2)

HOMES = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]


def test_three_drones_with_all_these_faults_fly_together(tmp_path: Path) -> None:
    """The stock controller, no battery in the log, another client before, and a tenth of all packets lost."""
    with StandIns(HOMES, missing=("pm.vbat",), loss=0.1, seed=2) as drones:
        for k in range(len(HOMES)):
            drones[k].serve_another_client()
        asyncio.run(fly_together(robots_at(drones.uris, tmp_path)))
        assert not any(drones[k].flying or drones[k].locked for k in range(len(HOMES)))
        assert all(drones[k].position[2] == 0.0 for k in range(len(HOMES)))


def test_drone_with_all_these_faults_keeps_the_contract(tmp_path: Path) -> None:
    with StandIns(HOMES[:1], missing=("pm.vbat",), loss=0.1, seed=4) as drones:
        drones[0].serve_another_client()
        asyncio.run(check_robot(robots_at(drones.uris, tmp_path)[0], patience_s=4.0))
        assert not drones[0].flying


def test_failed_flight_leaves_no_drone_hovering(tmp_path: Path) -> None:
    """Two stand too near: the assertion comes after all are connected; a third hovers from before."""
    with StandIns([(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (2.0, 0.0, 0.0)]) as drones:
        team = robots_at(drones.uris, tmp_path)

        async def flight() -> None:
            await team[2].connect(10.0)
            await team[2].arm()
            await team[2].take_off(0.5, 0.8)
            await asyncio.sleep(1.0)
            await fly_together(team)

        with pytest.raises(AssertionError, match="too near"):
            asyncio.run(flight())
        assert not any(drones[k].flying for k in range(3))


def test_all_drones_are_landed_even_if_a_link_is_lost(tmp_path: Path) -> None:
    with StandIns(HOMES[:2]) as drones:
        team = robots_at(drones.uris, tmp_path)

        async def flight() -> None:
            try:
                await asyncio.gather(*(robot.connect(10.0) for robot in team))
                await asyncio.gather(*(robot.arm() for robot in team))
                await asyncio.gather(*(robot.take_off(0.5, 0.8) for robot in team))
                await asyncio.sleep(1.0)
                drones[1].lose_link()
                await asyncio.sleep(1.5)
                drones[1].lose_link(False)
            finally:
                await everybody_down(team)

        asyncio.run(flight())
        assert not any(drones[k].flying for k in range(2))
