"""Short flights of one stand-in autopilot for tests of the MAVLink driver."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from llm_flock.robots._base import MotionLimits
from llm_flock_flight._mavlink import LocalFrame, MavlinkRobot
from llm_flock_flight._testing.mavlink import AutopilotStandIn, AutopilotStandIns

HOME = (1.0, 2.0, 0.0)
FLAVOURS = ("px4", "ardupilot")
GUIDED = {"px4": "Offboard", "ardupilot": "Guided"}
PILOT = {"px4": "Position", "ardupilot": "Loiter"}

CALM: dict[str, Any] = {
    "robot": "mavlink",
    "tracking_m": 0.12,
    "min_separation_m": 0.05,
    "off_course_s": 3.0,
    "stall_s": 3.0,
    "settle_s": 1.0,
    "take_off_s": 2.5,
    "land_s": 1.5,
    "round_s": 1.2,
    "max_speed_m_s": 3.0,
    "jump_m": 0.6,
    "ready_battery_v": 14.0,
    "low_battery_v": 13.0,
    "connect_s": 8.0,
}
"""A whole flight of stand-ins."""


def robot_of(vehicles: AutopilotStandIns, k: int = 0, **options: Any) -> MavlinkRobot:
    """The driver of a stand-in."""
    given = {"frame": LocalFrame(origin=HOME), "limits": MotionLimits(max_speed_m_s=2.0), **options}
    return MavlinkRobot(f"v{k}", vehicles.uris[k], system_id=k + 1, **given)


async def until(condition: Callable[[], bool], timeout_s: float = 5.0) -> None:
    """Wait for a condition; AssertionError if it does not hold in time."""
    loop = asyncio.get_running_loop()
    end = loop.time() + timeout_s
    while not condition():
        assert loop.time() < end, "not in time"
        await asyncio.sleep(0.01)


async def up(robot: MavlinkRobot, height_m: float = 0.6) -> None:
    """Connect, arm, and rise."""
    await robot.connect(5.0)
    await robot.arm()
    await robot.take_off(height_m, 0.8)
    await until(lambda: robot.state().position[2] > 0.9 * height_m, 6.0)


Act = Callable[[MavlinkRobot, AutopilotStandIn], Awaitable[None]]


def on_ground(flavour: str | Sequence[str], act: Act, *, connected: bool = True, **options: Any) -> None:
    """Do something with a connected robot on the ground."""
    _run(flavour, act, _connect if connected else _nothing, options)


def in_air(flavour: str | Sequence[str], act: Act, **options: Any) -> None:
    """Do something with a robot that hovers."""
    _run(flavour, act, up, options)


async def _connect(robot: MavlinkRobot) -> None:
    await robot.connect(5.0)


async def _nothing(robot: MavlinkRobot) -> None:
    pass


def _run(
    flavours: str | Sequence[str],
    act: Act,
    begin: Callable[[MavlinkRobot], Awaitable[None]],
    options: dict[str, Any],
) -> None:
    """Fly one robot of each flavour at the same time."""

    async def one(flavour: str) -> None:
        with AutopilotStandIns([HOME], flavour=flavour) as vehicles:
            robot = robot_of(vehicles, **options)
            try:
                await begin(robot)
                await act(robot, vehicles[0])
            finally:
                await robot.close()

    async def all_of_them() -> None:
        await asyncio.gather(*map(one, [flavours] if isinstance(flavours, str) else flavours))

    asyncio.run(all_of_them())
