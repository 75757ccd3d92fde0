"""Drones that land only if they are told where they are, as a driver that another process can import."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from llm_flock.robots._base import Pose, RobotError
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import start_of
from llm_flock_flight._flight.sections import DroneConfig

PATIENCE_S = 0.9
"""Longest wait for a pose [s]."""


class Blind(SimulatedRobot):
    """Refuses to land without a pose."""

    async def take_pose(self, pose: Pose) -> None:
        self.told = pose

    async def land(self, height_m: float, duration_s: float) -> None:
        for _ in range(int(PATIENCE_S / 0.02)):
            if hasattr(self, "told"):
                return await super().land(height_m, duration_s)
            await asyncio.sleep(0.02)
        raise RobotError(self.name, "does not know where it is")


def blind(config: FlightConfig, drones: Sequence[DroneConfig]) -> list[Blind]:
    """Their driver."""
    return [Blind(drone.name, start_of(config, drone)) for drone in drones]
