"""The simulated robot keeps the contract of a robot, and can lose its link."""

from __future__ import annotations

import asyncio

import pytest

from llm_flock.robots._base import RobotError
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock.testing import check_emergency_stop, check_robot

pytestmark = pytest.mark.usefixtures("skipped_waits")


def test_the_simulated_robot_keeps_the_contract() -> None:
    asyncio.run(check_robot(SimulatedRobot("one", (0.0, 0.0, 0.0)), patience_s=1.0))


def test_simulated_robot_obeys_an_emergency_stop() -> None:
    asyncio.run(check_emergency_stop(SimulatedRobot("one", (0.0, 0.0, 0.0))))


def test_a_simulated_robot_loses_its_link() -> None:
    async def flight() -> None:
        robot = SimulatedRobot("one", (0.0, 0.0, 0.0))
        await robot.connect(1.0)
        robot.lose_link()
        assert robot.state().link_lost and not await robot.stop_motors()
        with pytest.raises(RobotError, match="link is lost"):
            await robot.arm()
        with pytest.raises(RobotError, match="no answer within"):
            await robot.connect(0.01)

    asyncio.run(flight())
