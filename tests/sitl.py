"""Flights on the drones at some addresses: firmware in the loop, stand-ins, or real ones."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections.abc import Sequence
from pathlib import Path

from llm_flock.robots._base import MotionLimits, RobotError
from llm_flock.testing._robots import distance, wait_until
from llm_flock_flight._crazyflie import CrazyflieRobot

LIMITS = MotionLimits(low=(-50.0, -50.0, -1.0), high=(50.0, 50.0, 3.0), max_speed_m_s=1.0)
CONNECT_S = 60.0


def robots_at(uris: Sequence[str], cache: Path | None = None) -> list[CrazyflieRobot]:
    """A driver for each address."""
    return [CrazyflieRobot(f"sitl{k}", uri, limits=LIMITS, cache=cache) for k, uri in enumerate(uris)]


async def everybody_down(team: Sequence[CrazyflieRobot]) -> None:
    """Land all drones that are in the air, even after a failure, and close all links."""
    for robot in team:
        with contextlib.suppress(RobotError, TimeoutError):
            state = robot.state()
            if state.link_lost:
                await robot.connect(10.0)
            await robot.land(0.0, 2.0)
    with contextlib.suppress(RobotError, AssertionError):
        await wait_until(lambda: not any(robot.state().flying for robot in team), 8.0, "all have landed")
    await asyncio.gather(*(robot.close() for robot in team), return_exceptions=True)


async def fly_together(team: Sequence[CrazyflieRobot]) -> None:
    """Take off, fly half a metre, and land side by side; afterwards all are down, also if an assertion fails."""
    try:
        await asyncio.gather(*(r.connect(CONNECT_S) for r in team))
        await wait_until(lambda: all(r.state().settled for r in team), 20.0, "all estimators settle")
        homes = [r.state().position for r in team]
        for a, b in itertools.combinations(homes, 2):
            assert distance(a, b) > 0.5, "drones stand too near for this test"
        await asyncio.gather(*(r.arm() for r in team))
        await asyncio.gather(*(r.take_off(h[2] + 0.5, 2.0) for r, h in zip(team, homes, strict=True)))
        await asyncio.sleep(3.0)
        for r, h in zip(team, homes, strict=True):
            assert r.state().position[2] > h[2] + 0.3, f"{r.name} did not rise"
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
    finally:
        await everybody_down(team)
