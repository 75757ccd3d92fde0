"""A MAVLink vehicle that somebody else flies or has armed, or that is not where it was led. Without sockets."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import pytest

from llm_flock.robots._base import RobotError, TakenOver
from llm_flock_flight._mavlink import MavlinkRobot, Ports
from llm_flock_flight._mavlink.codec import Codec
from llm_flock_flight._mavlink.port import Port
from llm_flock_flight._testing.mavlink.autopilot import Autopilot

pytest.importorskip("pymavlink")

SET_MODE, ARM, SET_INTERVAL, REQUEST_MESSAGE = 176, 400, 511, 512
LOITER = 5
LINK_S = 0.2


class DirectPort(Port):
    """A port whose packets go to a stand-in autopilot and back within the call."""

    def __init__(self) -> None:
        super().__init__("udp://127.0.0.1:1")
        self.autopilot = Autopilot("ardupilot", 1)
        self.ahead_s = 0.0
        self._own, self._other = Codec(), Codec()
        self._hears: Callable[[Any], None] | None = None

    async def attach(self, system_id: int, take: Callable[[Any], None]) -> None:
        self._hears = take
        self.tick(2.0)

    def detach(self, system_id: int) -> None:
        self._hears = None

    def attached(self, system_id: int) -> bool:
        return self._hears is not None

    def send(self, system_id: int, kind: str, *fields: Any) -> None:
        for message in self._other.datagram(self._own.encode(kind, *fields)):
            self._deliver(self.autopilot.handle(message, time.monotonic()))
        if kind == "command_long" and fields[2] == SET_INTERVAL:
            self.tick(0.0)

    def tick(self, ahead_s: float) -> None:
        """Everything that the autopilot sends within this time, at once."""
        self.ahead_s += ahead_s
        self._deliver(self.autopilot.tick(time.monotonic() + self.ahead_s))

    def _deliver(self, packets: list[bytes]) -> None:
        for packet in packets:
            for message in self._own.datagram(packet):
                if self._hears is not None:
                    self._hears(message)


class OnePort(Ports):
    def __init__(self) -> None:
        super().__init__()
        self.port = DirectPort()

    def __missing__(self, uri: str) -> Port:
        return self.port


async def on_ground(link_timeout_s: float = 2.0) -> tuple[MavlinkRobot, DirectPort]:
    ports = OnePort()
    robot = MavlinkRobot("a", "udp://127.0.0.1:1", ports=ports, link_timeout_s=link_timeout_s)
    await robot.connect(1.0)
    return robot, ports.port


async def in_the_air(link_timeout_s: float = 2.0) -> tuple[MavlinkRobot, DirectPort]:
    robot, port = await on_ground(link_timeout_s)
    await robot.arm()
    await robot.take_off(1.0, 2.0)
    await asyncio.sleep(0.35)  # heartbeats count again, a moment after the confirmed mode
    port.tick(1.5)
    assert robot.state().flying
    assert robot.state().taken_over is None
    return robot, port


def test_a_vehicle_that_somebody_else_armed_is_left_alone() -> None:
    async def scene() -> None:
        robot, port = await on_ground()
        port.autopilot.body.motors = True
        port.tick(2.0)
        with pytest.raises(TakenOver, match="armed already"):
            await robot.arm()
        assert {SET_MODE, ARM}.isdisjoint(port.autopilot.commands)

    asyncio.run(scene())


def test_an_arming_that_was_given_up_is_withdrawn() -> None:
    async def scene() -> None:
        robot, port = await on_ground()
        port.autopilot.deaf_to[ARM] = 99
        with pytest.raises(RobotError, match="did not answer"):
            await robot.arm()
        assert not port.autopilot.armed

    asyncio.run(scene())


def test_a_pilot_is_remembered_behind_a_lost_link() -> None:
    async def scene() -> None:
        robot, port = await in_the_air(link_timeout_s=LINK_S)
        port.autopilot.switch(LOITER)
        port.tick(2.0)
        assert robot.state().taken_over is not None
        await asyncio.sleep(LINK_S + 0.05)
        assert robot.state().link_lost
        with pytest.raises(TakenOver, match="a pilot or a failsafe flies it"):
            await robot.land(0.0, 2.0)

    asyncio.run(scene())


def test_a_command_is_not_repeated_once_a_pilot_flies() -> None:
    async def scene() -> None:
        robot, port = await in_the_air()
        await asyncio.sleep(0.05)  # it has lifted off, and follows set-points
        port.autopilot.offset = (3.0, 0.0, 0.0)  # away from them, so it is landed by its own mode
        port.tick(1.0)
        port.autopilot.refuse[SET_MODE] = (1, "")  # for the moment, so it is asked again
        before = port.autopilot.commands.count(SET_MODE)
        landing = asyncio.create_task(robot.land(0.0, 2.0))
        for _ in range(2000):
            if port.autopilot.commands.count(SET_MODE) > before:
                break
            await asyncio.sleep(0.001)
        assert port.autopilot.commands.count(SET_MODE) > before
        port.autopilot.refuse.clear()
        port.autopilot.switch(LOITER)
        port.tick(2.0)
        asked = port.autopilot.commands.count(SET_MODE)
        with pytest.raises(TakenOver, match="Loiter"):
            await landing
        assert port.autopilot.commands.count(SET_MODE) == asked
        assert port.autopilot.mode == LOITER
        assert await robot.stop_motors()  # an emergency stop still reaches it

    asyncio.run(scene())


def test_motors_stopped_by_others_in_the_air_are_no_landing() -> None:
    async def scene() -> None:
        robot, port = await in_the_air()
        port.autopilot.body.motors = False
        port.tick(2.0)
        found = robot.state().taken_over
        assert found is not None
        assert "stopped" in found

    asyncio.run(scene())


def test_vehicle_with_jumped_estimate_is_not_led_aside_to_land() -> None:
    async def scene() -> None:
        robot, port = await in_the_air()
        await asyncio.sleep(0.05)  # it has lifted off, and follows set-points
        north, east, down = port.autopilot.offset
        port.autopilot.offset = (north + 3.0, east, down)
        port.tick(1.0)
        await robot.land(0.0, 2.0)
        assert port.autopilot.mode == port.autopilot.flavour.land
        await robot.close()

    asyncio.run(scene())


def test_a_vehicle_near_its_set_points_is_landed_by_them() -> None:
    async def scene() -> None:
        robot, port = await in_the_air()
        await asyncio.sleep(0.05)
        await robot.land(0.0, 2.0)
        assert port.autopilot.mode == port.autopilot.flavour.guided
        await robot.close()

    asyncio.run(scene())


def test_vehicle_armed_since_its_last_heartbeat_is_left_alone() -> None:
    async def scene() -> None:
        robot, port = await on_ground()
        port.autopilot.body.motors = True  # and its next heartbeat is due in a second
        with pytest.raises(TakenOver, match="armed already"):
            await robot.arm()
        assert {SET_MODE, ARM}.isdisjoint(port.autopilot.commands)

    asyncio.run(scene())


def test_autopilot_without_heartbeat_on_request_is_waited_for() -> None:
    async def scene(armed: bool) -> None:
        robot, port = await on_ground()
        port.autopilot.refuse[REQUEST_MESSAGE] = (3, "")
        port.autopilot.body.motors = armed
        arming = asyncio.create_task(robot.arm())
        await asyncio.sleep(0.3)
        assert not arming.done() and ARM not in port.autopilot.commands
        port.tick(2.0)
        if armed:
            with pytest.raises(TakenOver, match="armed already"):
                await arming
        else:
            await arming
            assert robot.state().armed

    asyncio.run(scene(armed=True))
    asyncio.run(scene(armed=False))


@pytest.mark.usefixtures("skipped_waits")
def test_nothing_is_armed_without_a_heartbeat() -> None:
    async def scene() -> None:
        robot, port = await on_ground()
        port.autopilot.refuse[REQUEST_MESSAGE] = (3, "")
        with pytest.raises(RobotError, match=r"no heartbeat in 1\.2 s"):
            await robot.arm()
        assert {SET_MODE, ARM}.isdisjoint(port.autopilot.commands)

    asyncio.run(scene())
