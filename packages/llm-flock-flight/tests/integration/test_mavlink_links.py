"""Links to MAVLink vehicles: found, shared, lost and opened again; and what is checked on connecting."""

from __future__ import annotations

import asyncio
import os
import select
import socket
import threading
import time

import pytest

pytest.importorskip("pymavlink")

from mavlink_flights import FLAVOURS, HOME, in_air, on_ground, robot_of, until

from llm_flock.robots._base import MotionLimits, RobotError
from llm_flock_flight._mavlink import Geodetic, LocalFrame, MavlinkRobot, Ports
from llm_flock_flight._mavlink.codec import Codec
from llm_flock_flight._testing.mavlink import AutopilotStandIns
from llm_flock_flight._testing.mavlink.autopilot import Autopilot

pytestmark = pytest.mark.clock(2)


def test_lost_link_is_noticed_and_reopened():
    async def act(robot, vehicle):
        vehicle.autopilot.parameters["FS_GCS_TIMEOUT"] = 60.0  # it hovers on
        vehicle.silent = True
        lost = time.monotonic()
        await until(lambda: robot.state().link_lost, 4.0)
        assert time.monotonic() - lost < 3.0
        with pytest.raises(RobotError, match="link is lost"):
            await robot.go_to((1.0, 2.0, 1.0), 1.0)
        assert await robot.stop_motors() is False
        vehicle.silent = False
        await asyncio.sleep(0.1)
        assert robot.state().link_lost, "only connect opens a lost link"
        await robot.connect(3.0)
        assert not robot.state().link_lost and robot.state().flying

    in_air("ardupilot", act)


def test_missing_heartbeats_lose_the_link_despite_positions():
    async def act(robot, vehicle):
        with vehicle.lock:
            vehicle.autopilot._periods[0] = 0.0
        await until(lambda: robot.state().link_lost, 2.0)

    on_ground("px4", act, heartbeat_timeout_s=0.8)


def test_share_of_packets_is_reported():
    async def act(robot, vehicle):
        await until(lambda: robot.state().link == 1.0, 1.0)
        vehicle.loss = 0.4
        await until(lambda: 0.5 < (robot.state().link or 0.0) < 0.7, 6.0)

    on_ground("px4", act)


def test_a_wrong_system_id_is_named_with_those_that_answer():
    with AutopilotStandIns([HOME]) as vehicles:
        robot = MavlinkRobot("v", vehicles.uris[0], system_id=7)
        with pytest.raises(RobotError, match=r"no heartbeat of system 7 \(only of 1\) within 1.5 s at udp://"):
            asyncio.run(robot.connect(1.5))


def test_two_vehicles_with_one_system_id_are_refused():
    vehicles = AutopilotStandIns([HOME, HOME], shared=True)
    vehicles[1].autopilot = Autopilot("px4", 1)
    with vehicles:
        robot = robot_of(vehicles)

        async def arm() -> None:
            await robot.connect(3.0)
            await asyncio.sleep(1.5)  # if it was quicker than the other one's heartbeat
            await robot.arm()

        with pytest.raises(RobotError, match="two vehicles with system id 1"):
            asyncio.run(arm())
        assert not any(vehicle.armed for vehicle in vehicles)


def test_several_vehicles_share_a_port():
    async def flight() -> None:
        homes = [(2.0 * k, 0.0, 0.0) for k in range(3)]
        with AutopilotStandIns(homes, shared=True) as vehicles:
            ports = Ports()
            robots = [robot_of(vehicles, k, ports=ports, frame=LocalFrame(origin=homes[k])) for k in range(3)]
            await asyncio.gather(*(robot.connect(5.0) for robot in robots))
            vehicles[1].autopilot.battery_v = 14.0
            await until(lambda: robots[1].state().battery_v == 14.0)
            assert robots[0].state().battery_v == 15.6
            await robots[0].close()
            await robots[0].close()
            await robots[2].arm()
            assert [vehicle.armed for vehicle in vehicles] == [False, False, True]
            await asyncio.gather(*(robot.close() for robot in robots))

    asyncio.run(flight())


def test_a_vehicle_that_waits_to_be_called():
    async def flight() -> None:
        with AutopilotStandIns([HOME], listening=True) as vehicles:
            assert vehicles.uris[0].startswith("udpout://")
            robot = robot_of(vehicles)
            await robot.connect(5.0)
            await robot.arm()
            await robot.close()

    asyncio.run(flight())


def test_an_address_that_cannot_be_opened():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        robot = MavlinkRobot("v", f"udp://127.0.0.1:{taken.getsockname()[1]}")
        with pytest.raises(RobotError, match=r"v: udp://.* cannot be opened: another program listens there"):
            asyncio.run(robot.connect(1.0))
    with pytest.raises(RobotError, match="v: serial:///dev/no-such-line cannot be opened"):
        asyncio.run(MavlinkRobot("v", "serial:///dev/no-such-line").connect(1.0))


TIOCGEXCL = 0x80045440
"""Linux: asks whether no other process may open a terminal."""


def test_a_serial_line():
    """A pair of pseudo-terminals stands for the cable; bytes come in any pieces."""
    fcntl = pytest.importorskip("fcntl")
    pty, tty = pytest.importorskip("pty"), pytest.importorskip("tty")
    ours, theirs = pty.openpty()
    path = os.ttyname(theirs)
    tty.setraw(theirs)
    autopilot, codec, stop = Autopilot("ardupilot", 1), Codec(), threading.Event()

    def serve() -> None:
        while not stop.is_set():
            out = autopilot.tick(time.monotonic())
            if select.select([ours], [], [], 0.005)[0]:
                for message in codec.stream(os.read(ours, 7)):
                    out += autopilot.handle(message, time.monotonic())
            for packet in out:
                os.write(ours, packet[:5])
                os.write(ours, packet[5:])

    async def fly() -> None:
        robot = MavlinkRobot("v", f"serial://{path}:57600")
        await robot.connect(5.0)
        await robot.arm()
        assert robot.state().armed and autopilot.armed
        second = MavlinkRobot("w", f"serial://{path}:57600")
        with pytest.raises(RobotError, match="cannot be opened: another program has this line"):
            await second.connect(5.0)
        await robot.connect(5.0)  # its own line is free as soon as it was closed
        exclusive = fcntl.ioctl(theirs, TIOCGEXCL, bytes(4))
        assert exclusive != bytes(4), "programs without a lock are kept away as well"
        await robot.close()
        await asyncio.sleep(0.2)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        asyncio.run(fly())
    finally:
        stop.set()
        thread.join()
        os.close(ours)
        os.close(theirs)


# Which vehicles.


@pytest.mark.parametrize(
    ("field", "value", "says"), [("autopilot", 8, "neither PX4 nor ArduPilot"), ("kind", 1, "no copter")]
)
def test_other_vehicles_are_refused(field, value, says):
    vehicles = AutopilotStandIns([HOME])
    setattr(vehicles[0].autopilot, field, value)
    with vehicles, pytest.raises(RobotError, match=says):
        asyncio.run(robot_of(vehicles).connect(3.0))


def test_without_a_position_nothing_connects():
    async def act(robot, vehicle):
        vehicle.autopilot.healthy = False
        with pytest.raises(RobotError, match="no position"):
            await robot.connect(1.5)
        vehicle.autopilot.healthy = True
        await robot.connect(3.0)
        await until(lambda: robot.state().settled, 2.0)
        vehicle.autopilot.healthy = False
        await until(lambda: not robot.state().settled, 2.0)

    on_ground(FLAVOURS, act, connected=False)


def test_positions_by_a_common_origin_on_the_earth():
    origin = Geodetic(latitude_deg=47.397, longitude_deg=8.545, altitude_m=488.0)

    async def act(robot, vehicle):
        with pytest.raises(RobotError, match="no GPS origin"):
            await robot.connect(1.5)
        north_m = 10.0
        vehicle.autopilot.origin = Geodetic(
            latitude_deg=47.397 + north_m / 111_180.0, longitude_deg=8.545, altitude_m=490.0
        )
        await robot.connect(3.0)
        x, y, z = robot.state().position
        assert (x, y, z) == pytest.approx((0.0, north_m, 2.0), abs=0.05)
        vehicle.autopilot.origin = Geodetic(latitude_deg=48.0, longitude_deg=8.545, altitude_m=490.0)
        await robot.close()
        with pytest.raises(RobotError, match="within 10000 m"):
            await robot.connect(3.0)

    on_ground(FLAVOURS, act, connected=False, origin=origin)


# Before a flight: what the autopilot does without this computer.


def checks_with(flavour, limits=None, **parameters):
    found = []

    async def act(robot, vehicle):
        vehicle.autopilot.parameters.update(parameters)
        await robot.connect(3.0)
        found.extend(robot.checks())

    on_ground(flavour, act, connected=False, limits=limits)
    return {check.name: check for check in found}


@pytest.mark.parametrize(
    ("action", "passed", "found"),
    [
        (4, True, "Land after 1 s"),
        (0, True, "Position mode after 1 s, which needs a pilot"),
        (3, False, "Return after"),
        (7, False, "Disarm after"),
    ],
)
def test_px4s_reaction_to_a_lost_stream_is_checked(action, passed, found):
    check = checks_with("px4", COM_OBL_RC_ACT=action)["without set-points"]
    assert check.passed is passed and check.found.startswith(found)


def test_px4_must_not_wait_too_long():
    assert not checks_with("px4", COM_OF_LOSS_T=30.0)["without set-points"].passed


@pytest.mark.parametrize(("action", "passed"), [(5.0, True), (7.0, True), (1.0, False), (0.0, False)])
def test_ardupilots_reaction_to_missing_heartbeats_is_checked(action, passed):
    check = checks_with("ardupilot", FS_GCS_ENABLE=action)["without heartbeats"]
    assert check.passed is passed and "system 255" in check.found


def test_ardupilot_must_wait_for_our_heartbeats():
    assert not checks_with("ardupilot", SYSID_MYGCS=252.0)["without heartbeats"].passed


def test_the_newer_name_of_a_parameter_is_known_too():
    async def act(robot, vehicle):
        del vehicle.autopilot.parameters["SYSID_MYGCS"]
        vehicle.autopilot.parameters["MAV_GCS_SYSID"] = 1.0
        await robot.connect(3.0)
        assert "without system 1" in robot.checks()[0].found and not robot.checks()[0].passed

    on_ground("ardupilot", act, connected=False)


def test_unreported_parameters_are_not_judged():
    async def act(robot, vehicle):
        vehicle.autopilot.parameters.clear()
        await robot.connect(3.0)
        assert {(check.passed, check.found) for check in robot.checks()} == {(True, "not told")}

    on_ground(("px4", "ardupilot"), act, connected=False)


def test_fence_of_the_autopilot_is_reported():
    assert checks_with("px4")["its own fence"].found == "on: 50 m around"
    assert checks_with("ardupilot")["its own fence"].found == "off"
    assert (
        checks_with("ardupilot", FENCE_ENABLE=1.0, FENCE_ALT_MAX=20.0)["its own fence"].found
        == "on: 300 m around, 20 m up"
    )


@pytest.mark.parametrize(
    ("parameters", "passed"),
    [
        ({"FENCE_RADIUS": 25.0, "FENCE_ALT_MAX": 9.0}, True),
        ({"FENCE_RADIUS": 12.0, "FENCE_ALT_MAX": 9.0}, False),
        ({"FENCE_RADIUS": 12.0, "FENCE_ALT_MAX": 9.0, "FENCE_TYPE": 1.0}, True),
        ({"FENCE_RADIUS": 25.0, "FENCE_ALT_MAX": 7.0}, False),
        ({"FENCE_RADIUS": 25.0, "FENCE_ALT_MAX": 7.0, "FENCE_MARGIN": 0.5}, True),
        ({"FENCE_TYPE": 8.0, "FENCE_ALT_MIN": -10.0}, True),
        ({"FENCE_TYPE": 8.0, "FENCE_ALT_MIN": 0.0}, False),
    ],
)
def test_fence_of_the_autopilot_has_to_hold_ours(parameters, passed):
    """Ours reaches 16.4 m from its home, and 6 m up; the margin is 2 m unless it tells another one."""
    limits = MotionLimits(low=(-8.0, -8.0, -1.0), high=(14.0, 11.0, 6.0))
    check = checks_with("ardupilot", limits, FENCE_ENABLE=1.0, **parameters)["its own fence"]
    assert check.passed is passed and bool(check.asked) is not passed


@pytest.mark.parametrize(
    ("flavour", "name", "value", "said"),
    [
        ("ardupilot", "FS_THR_ENABLE", 1.0, "radio control lost: RTL"),
        ("ardupilot", "BATT_FS_LOW_ACT", 2.0, "battery low: RTL"),
        ("ardupilot", "FS_EKF_ACTION", 2.0, "estimator lost: AltHold"),
        ("px4", "NAV_RCL_ACT", 2, "radio control lost: Return"),
        ("px4", "COM_LOW_BAT_ACT", 3, "battery critical: Return, then Land"),
    ],
)
def test_vehicle_that_would_go_home_by_itself_is_refused(flavour, name, value, said):
    good = checks_with(flavour)["its failsafes"]
    assert good.passed and "radio control lost: Land" in good.found
    check = checks_with(flavour, **{name: value})["its failsafes"]
    assert not check.passed and said in check.found and check.asked.startswith(f"{name} ")


def test_no_message_is_asked_for_that_a_vehicle_does_not_know():
    async def act(robot, vehicle):
        assert "No ap_message" not in robot._log.says(time.monotonic())

    on_ground(("px4", "ardupilot"), act)


# Limits, and what strangers send.


def test_a_vehicle_that_calls_its_driver_is_not_called_away():
    """Ports are used again: what others send to a vehicle's own port, late or by mistake, must not turn it to them."""

    async def connect() -> None:
        with AutopilotStandIns([HOME]) as vehicles, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            await until(lambda: vehicles[0].socket.getsockname()[1] != 0)
            place = ("127.0.0.1", vehicles[0].socket.getsockname()[1])
            for packet in (
                b"x",
                Codec(1, 1).encode("heartbeat", 2, 12, 1, 0, 4),
                Codec().encode("heartbeat", 6, 8, 0, 0, 4),
            ):
                other.sendto(packet, place)
            robot = robot_of(vehicles)
            await robot.connect(5.0)
            await robot.close()

    asyncio.run(connect())
