"""Flights on the drones at LLM_FLOCK_SITL_URIS, such as firmware in the loop; skipped if it is not set.

    LLM_FLOCK_SITL_URIS=udp://127.0.0.1:19850,udp://127.0.0.1:19851 python -m pytest tests/integration/test_sitl.py

Drones stand on free ground, a metre free above and half a metre on the side of increasing x and y, at least 0.6 m from
one another. All are landed after any failure. The emergency stop drops one from 0.4 m: LLM_FLOCK_SITL_FALL=1 asks for
it. Without hardware: `llm-flock stand-ins 2`; what these flights have to survive is in test_sitl_stories.py.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

pytest.importorskip("cflib")

from sitl import CONNECT_S, everybody_down, fly_together, robots_at

from llm_flock.testing import check_emergency_stop, check_robot

URIS = [uri for uri in os.environ.get("LLM_FLOCK_SITL_URIS", "").split(",") if uri]
pytestmark = [
    pytest.mark.skipif(not URIS, reason="LLM_FLOCK_SITL_URIS is not set"),
    pytest.mark.filterwarnings("default"),
]


def test_each_drone_keeps_the_contract(tmp_path: Path) -> None:
    async def check() -> None:
        for robot in robots_at(URIS, tmp_path):
            try:
                await check_robot(robot, patience_s=6.0, connect_timeout_s=CONNECT_S)
            except BaseException:
                await robot.connect(CONNECT_S)  # the check has closed its link
                raise
            finally:
                await everybody_down([robot])

    asyncio.run(check())


def test_all_fly_together_and_land_apart(tmp_path: Path) -> None:
    asyncio.run(fly_together(robots_at(URIS, tmp_path)))


@pytest.mark.skipif(os.environ.get("LLM_FLOCK_SITL_FALL") != "1", reason="LLM_FLOCK_SITL_FALL is not 1")
def test_an_emergency_stop_is_confirmed(tmp_path: Path) -> None:
    asyncio.run(check_emergency_stop(robots_at(URIS, tmp_path)[0]))
