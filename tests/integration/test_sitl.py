"""Flights on whatever answers at LLM_FLOCK_SITL_URIS, firmware in the loop say; skipped where that is not set.

    LLM_FLOCK_SITL_URIS=udp://127.0.0.1:19850,udp://127.0.0.1:19851 python -m pytest tests/integration/test_sitl.py

Drones stand on free ground, a metre free above and half a metre on the side of increasing x and y, at least 0.6 m from
one another. The emergency stop lets one fall from 0.4 m: LLM_FLOCK_SITL_FALL=1 asks for it. Without hardware:
`llm-flock stand-ins 2`.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import time

import pytest

from llm_flock.robots.base import MotionLimits
from llm_flock.robots.crazyflie import CrazyflieRobot
from llm_flock.testing import check_emergency_stop, check_robot
from llm_flock.testing.robots import distance, wait_until

URIS = [uri for uri in os.environ.get("LLM_FLOCK_SITL_URIS", "").split(",") if uri]
pytestmark = [
    pytest.mark.skipif(not URIS, reason="LLM_FLOCK_SITL_URIS is not set"),
    pytest.mark.filterwarnings("default"),
]
LIMITS = MotionLimits(low=(-50.0, -50.0, -1.0), high=(50.0, 50.0, 3.0), max_speed_m_s=1.0)


def robots() -> list[CrazyflieRobot]:
    return [CrazyflieRobot(f"sitl{k}", uri, limits=LIMITS) for k, uri in enumerate(URIS)]


def test_each_drone_keeps_the_contract():
    for robot in robots():
        asyncio.run(check_robot(robot, patience_s=6.0, connect_timeout_s=30.0))


def test_all_fly_together_and_land_apart():
    async def flight() -> None:
        team = robots()
        await asyncio.gather(*(r.connect(30.0) for r in team))
        await wait_until(lambda: all(r.state().settled for r in team), 20.0, "all estimators settle")
        homes = [r.state().position for r in team]
        for a, b in itertools.combinations(homes, 2):
            assert distance(a, b) > 0.5, "drones stand too near for this test"
        await asyncio.gather(*(r.arm() for r in team))
        await asyncio.gather(*(r.take_off(h[2] + 0.5, 2.0) for r, h in zip(team, homes, strict=True)))
        await asyncio.sleep(3.0)
        targets = [(x + 0.2, y + 0.2, z + 0.5) for x, y, z in homes]
        await asyncio.gather(*(r.go_to(t, 2.0) for r, t in zip(team, targets, strict=True)))
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            for a, b in itertools.combinations(team, 2):
                assert distance(a.state().position, b.state().position) > 0.4
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.0)
        for r, t in zip(team, targets, strict=True):
            assert distance(r.state().position, t) < 0.15
        await asyncio.gather(*(r.land(h[2], 2.0) for r, h in zip(team, homes, strict=True)))
        await wait_until(lambda: not any(r.state().flying for r in team), 8.0, "all have landed")
        await asyncio.gather(*(r.close() for r in team))

    asyncio.run(flight())


@pytest.mark.skipif(os.environ.get("LLM_FLOCK_SITL_FALL") != "1", reason="LLM_FLOCK_SITL_FALL is not 1")
def test_an_emergency_stop_is_confirmed():
    asyncio.run(check_emergency_stop(robots()[0]))
