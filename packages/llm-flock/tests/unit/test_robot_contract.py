"""The contract of a robot notices drivers that break it."""

from __future__ import annotations

import asyncio
import time

import pytest

from llm_flock.robots._base import Commanded, Position
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock.testing import check_robot

pytestmark = pytest.mark.usefixtures("skipped_waits")


class Hovering(SimulatedRobot):
    """Believes itself in the air once it has landed."""

    async def land(self, height_m: float, duration_s: float) -> None:
        await super().land(height_m, duration_s)
        self.body.jump((0.0, 0.0, 0.3), time.monotonic())


@pytest.mark.clock(4)
def test_contract_reports_height_of_a_failed_landing() -> None:
    with pytest.raises(AssertionError, match=r"a landed robot is on the ground: at 0 m, not 0\.\d+ m"):
        asyncio.run(check_robot(Hovering("one", (0.0, 0.0, 0.0))))


class Careless(SimulatedRobot):
    """Clips a target aside instead of along its line."""

    async def go_to(self, target: Position, duration_s: float) -> Commanded:
        x, y, z = target
        return await super().go_to((min(x, 2.0), y if x <= 2.0 else -1.0, z), duration_s)


def test_the_contract_notices_a_target_moved_aside() -> None:
    with pytest.raises(AssertionError, match="along the segment"):
        asyncio.run(check_robot(Careless("one", (0.0, 0.0, 0.0)), patience_s=0.5))
