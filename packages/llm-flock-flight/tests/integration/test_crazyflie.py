"""The driver for Crazyflies: the real cflib on stand-ins."""

from __future__ import annotations

import asyncio
import tempfile
import threading
import time
from pathlib import Path

import pytest
from slowness import slowness

pytest.importorskip("cflib")

from llm_flock.errors import InputError
from llm_flock.robots._base import MotionLimits, RobotError
from llm_flock.testing import check_emergency_stop, check_robot
from llm_flock.testing._robots import distance, wait_until
from llm_flock_flight._crazyflie import CrazyflieRobot
from llm_flock_flight._crazyflie.robot import ANSWER_S, GO_TO
from llm_flock_flight._testing.crtp import StandIns
from llm_flock_flight._testing.crtp.firmware import Parameter

pytestmark = pytest.mark.clock(2)

HOME = (0.0, 0.0, 0.0)


TABLES = Path(tempfile.gettempdir()) / "llm-flock-test-tables"


def robot_of(drones, k=0, **options):
    return CrazyflieRobot(f"cf{k}", drones.uris[k], **{"cache": TABLES, **options})


class Stubborn(Parameter):
    """Stays 0, also if it is set."""

    def pack(self):
        return b"\0\0\0\0"


async def up(robot, height=0.5):
    await robot.connect(5.0)
    await robot.arm()
    await robot.take_off(height, 0.8)
    await asyncio.sleep(0.9)


def test_driver_keeps_its_contract_at_ten_percent_packet_loss():
    with StandIns([HOME], loss=0.1, seed=1) as drones:
        asyncio.run(check_robot(robot_of(drones), patience_s=2.5))
        assert not drones[0].flying and not drones[0].locked


def test_an_emergency_stop_is_confirmed():
    with StandIns([HOME], loss=0.1) as drones:
        asyncio.run(check_emergency_stop(robot_of(drones)))
        assert drones[0].locked


def test_drone_that_does_not_answer_is_reported():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            drones[0].lose_link()
            robot = robot_of(drones)
            began = time.monotonic()
            with pytest.raises(RobotError, match="not connected to udp"):
                await robot.connect(1.5)
            assert time.monotonic() - began < 5.0
            drones[0].lose_link(False)
            await robot.connect(3.0)
            await robot.close()

    asyncio.run(flight())


def test_closed_port_is_reported():
    with StandIns([HOME]) as drones:
        uri = drones.uris[0]
    with pytest.raises(RobotError, match="not connected"):
        asyncio.run(CrazyflieRobot("cf", uri).connect(1.0))


def test_lost_link_is_noticed_and_reopened_in_flight():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones, link_timeout_s=0.5)
            await up(robot)
            assert not robot.state().link_lost
            drones[0].lose_link()
            lost = time.monotonic()
            await wait_until(lambda: robot.state().link_lost, 1.0, "the loss is seen")
            assert time.monotonic() - lost < 0.7
            with pytest.raises(RobotError, match="link is lost"):
                await robot.go_to((0.2, 0.0, 0.5), 1.0)
            assert drones[0].flying, "the high-level commander hovers on"
            assert await robot.stop_motors() is False
            drones[0].lose_link(False)
            assert robot.state().link_lost, "only connect opens a lost link"
            await robot.connect(5.0)
            assert not robot.state().link_lost and robot.state().flying
            assert drones[0].flying, "closing a link drops nothing"
            await robot.hold()
            await robot.land(0.0, 0.5)
            await wait_until(lambda: not drones[0].flying, 1.0, "it lands")
            await robot.close()

    asyncio.run(flight())


def test_closing_the_link_in_flight_leaves_the_drone_hovering():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones)
            await up(robot)
            await robot.close()
            await asyncio.sleep(0.3)
            assert drones[0].flying and not drones[0].locked
            assert drones[0].position[2] == pytest.approx(0.5, abs=0.1)

    asyncio.run(flight())


def test_locked_drone_refuses_with_the_words_of_its_supervisor():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones)
            await robot.connect(5.0)
            with pytest.raises(RobotError, match=r"refused take-off.*can be armed"):
                await robot.take_off(0.5, 0.5)
            await robot.land(0.0, 1.0)
            assert [command for _, command in drones[0].firmware.commands] == [7], "what never flew is not landed"
            assert await robot.stop_motors()
            with pytest.raises(RobotError, match=r"does not arm.*locked"):
                await robot.arm()
            await robot.close()

    asyncio.run(flight())


def test_faults_show_in_the_state():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones)
            await up(robot)
            await wait_until(lambda: robot.state().settled, 2.0, "settled")
            drones[0].set_battery(3.1)
            await wait_until(lambda: abs((robot.state().battery_v or 0) - 3.1) < 0.01, 1.0, "battery")
            drones[0].stall()
            await wait_until(lambda: not robot.state().settled, 2.0, "unsettled")
            drones[0].stall(False)
            drones[0].jump((0.4, 0.0, 0.0))
            await wait_until(lambda: robot.state().position[0] > 0.2, 1.0, "a jump")
            drones[0].mute_log()
            await asyncio.sleep(0.1)
            stamp = robot.state().stamp_s
            await asyncio.sleep(0.3)
            assert robot.state().stamp_s == stamp and not robot.state().link_lost
            drones[0].die()
            await wait_until(lambda: robot.state().link_lost, 2.0, "dead")
            await robot.close()

    asyncio.run(flight())


def test_parameters_are_set_on_connect_and_unknown_ones_refused():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones, parameters={"stabilizer.controller": 2, "locSrv.extPosStdDev": 1e-3})
            await robot.connect(5.0)
            values = drones[0].firmware.parameters
            await wait_until(lambda: values["stabilizer.controller"].value == 2, 1.0, "set")
            await wait_until(lambda: abs(values["locSrv.extPosStdDev"].value - 1e-3) < 1e-6, 1.0, "set")
            await robot.close()
            with pytest.raises(InputError, match=r"no\.such"):
                await robot_of(drones, parameters={"no.such": 1}).connect(5.0)

    asyncio.run(flight())


def test_firmware_equipment_is_read_and_settings_are_read_back():
    async def flight() -> None:
        with StandIns([HOME], missing=("pm.vbat", "kalman.varPX", "kalman.varPY", "kalman.varPZ")) as drones:
            robot = robot_of(drones)
            await robot.connect(5.0)
            state = robot.state()
            found = state.equipment
            assert (found.controller, found.estimator, found.lag_s, found.max_speed_m_s) == ("PID", "Kalman", 0.5, 1.0)
            assert found.unwatched == ("its battery", "its estimator's variance") and not found.complaints
            assert state.battery_v is None and state.settled and state.fault is None
            await robot.close()
            drones[0].firmware.parameters["locSrv.extPosStdDev"] = Stubborn(0x06, 0.0)
            robot = robot_of(drones, parameters={"stabilizer.controller": 2, "locSrv.extPosStdDev": 0.5})
            await robot.connect(5.0)
            found = robot.state().equipment
            assert (found.controller, found.lag_s) == ("Mellinger", 0.0)
            assert found.complaints == ("locSrv.extPosStdDev is 0, though it was set to 0.5",)
            await robot.close()

    asyncio.run(flight())


def test_firmware_without_what_a_flight_needs_is_refused_at_once():
    began = time.monotonic()
    with StandIns([HOME], missing=("supervisor.info",)) as drones, pytest.raises(RobotError, match="update it"):
        asyncio.run(robot_of(drones).connect(20.0))
    assert time.monotonic() - began < 10.0


def test_a_drone_that_another_client_left_takes_off():
    """Its last set-point outranks the high-level commander until it is told that no more come."""

    async def flight() -> None:
        with StandIns([HOME], loss=0.1, seed=3) as drones:
            drones[0].serve_another_client()
            robot = robot_of(drones)
            await robot.connect(5.0)
            drones[0].serve_another_client()  # and comes by again before the take-off
            await robot.arm()
            await robot.take_off(0.5, 0.8)
            await wait_until(lambda: drones[0].position[2] > 0.3, 2.0, "it flies")
            await robot.land(0.0, 0.8)
            await wait_until(lambda: not drones[0].flying, 2.0, "it lands")
            await robot.close()

    asyncio.run(flight())


def test_a_pause_of_the_radio_does_not_stop_a_motion():
    """The drone flies its segment by itself: set-points come from its own memory."""

    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones)
            await up(robot)
            await robot.go_to((0.4, 0.0, 0.5), 2.0)
            drones[0].lose_link()
            await asyncio.sleep(2.0)
            drones[0].lose_link(False)
            assert len(drones[0].firmware.commands) == 2, "a take-off and a way-point; nothing came afterwards"
            await wait_until(lambda: distance(drones[0].position, (0.4, 0.0, 0.5)) < 0.1, 2.0, "it arrives")
            await robot.connect(5.0)
            assert robot.state().flying
            await robot.land(0.0, 0.5)
            await robot.close()

    asyncio.run(flight())


@pytest.mark.parametrize("lost", ["order", "answer"])
def test_lost_order_costs_one_wait_and_the_motion_ends_in_time(lost: str) -> None:
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones)
            await up(robot)
            drone, plain = drones[0], drones[0].firmware.handle
            swallowed: list[bytes] = []

            def handle(raw: bytes, now: float) -> list[bytes]:
                if raw[1:2] != bytes([GO_TO]) or swallowed:
                    return plain(raw, now)
                swallowed.append(raw)
                if lost == "answer":
                    plain(raw, now)
                return []

            drone.firmware.handle = handle
            began = time.monotonic()
            await robot.go_to((0.4, 0.0, 0.5), 1.5)
            took_s = time.monotonic() - began
            assert ANSWER_S <= took_s < ANSWER_S + 0.15 * slowness()
            ordered, *_ = drone.firmware.body.set_point(began + 1.5 + 0.1 * slowness())
            assert distance(ordered, (0.4, 0.0, 0.5)) < 0.005, "the second order has the time that is left"
            await robot.land(0.0, 0.5)
            await robot.close()

    asyncio.run(flight())


def test_parameters_are_left_alone_in_flight():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones)
            await up(robot)
            await robot.close()
            other = robot_of(drones, parameters={"stabilizer.controller": 2})
            await other.connect(5.0)
            assert drones[0].firmware.parameters["stabilizer.controller"].value == 1
            assert any("was flying" in text for text in other.state().equipment.complaints)
            await other.land(0.0, 0.5)
            await wait_until(lambda: not drones[0].flying, 2.0, "it lands")
            await other.close()

    asyncio.run(flight())


def test_state_of_the_supervisor_is_reported():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones)
            await robot.connect(5.0)
            drones[0].tumble()
            await wait_until(lambda: robot.state().fault == "tumbled", 1.0, "tumbled")
            drones[0].firmware.tumbled = False
            drones[0].firmware.crashed = True
            await wait_until(lambda: robot.state().fault == "crashed: recover it", 1.0, "crashed")
            await robot.close()

    asyncio.run(flight())


def test_stop_watchdog_cuts_the_motors_where_no_radio_reaches():
    async def flight() -> None:
        with StandIns([HOME]) as drones:
            robot = robot_of(drones, stop_watchdog=True)
            await up(robot)
            await asyncio.sleep(1.5)
            assert drones[0].flying, "it is fed"
            drones[0].lose_link()
            lost = time.monotonic()
            await wait_until(lambda: drones[0].locked, 2.0, "it falls")
            assert time.monotonic() - lost < 1.5
            await robot.close()

    asyncio.run(flight())


def test_connection_attempts_leave_no_thread_and_no_exception(monkeypatch):
    """Half of all packets is lost: attempts are given up in all stages."""
    died = []
    monkeypatch.setattr(threading, "excepthook", lambda found: died.append(found.exc_value))
    before = set(threading.enumerate())

    async def flight() -> None:
        with StandIns([HOME, (1.0, 0.0, 0.0)], loss=0.5, seed=5) as drones:
            robots = [robot_of(drones, k) for k in range(2)]
            await asyncio.gather(*(robot.connect(3.0) for robot in robots), return_exceptions=True)
            drones[0].lose_link()
            await asyncio.gather(*(robot.connect(2.0) for robot in robots), return_exceptions=True)
            await asyncio.gather(*(robot.close() for robot in robots))

    asyncio.run(flight())
    until, left = time.monotonic() + 5.0, [*before]
    while time.monotonic() < until and (left := [t for t in threading.enumerate() if t not in before]):
        time.sleep(0.05)
    assert not died and not left


def test_ten_connect_settle_and_fly_together(capsys):
    async def flight() -> None:
        homes = [(0.5 * k, 0.0, 0.0) for k in range(10)]
        with StandIns(homes, controller=2) as drones:
            robots = [robot_of(drones, k, limits=MotionLimits(max_speed_m_s=1.0)) for k in range(10)]
            began = time.monotonic()
            await asyncio.gather(*(r.connect(5.0) for r in robots))
            await wait_until(lambda: all(r.state().settled for r in robots), 5.0, "all settled")
            ready = time.monotonic() - began
            await asyncio.gather(*(r.arm() for r in robots))
            await asyncio.gather(*(r.take_off(0.5, 1.0) for r in robots))
            await asyncio.sleep(1.1)
            began = time.monotonic()
            await asyncio.gather(*(r.go_to((h[0], 0.3, 0.5), 1.0) for r, h in zip(robots, homes, strict=True)))
            fan_out = time.monotonic() - began
            await asyncio.sleep(1.2)
            for r, h, k in zip(robots, homes, range(10), strict=True):
                assert distance(drones[k].position, (h[0], 0.3, 0.5)) < 1e-3
                assert distance(r.state().position, (h[0], 0.3, 0.5)) < 1e-2
            await asyncio.gather(*(r.land(0.0, 0.5) for r in robots))
            await asyncio.sleep(0.7)
            assert not any(drones[k].flying for k in range(10))
            await asyncio.gather(*(r.close() for r in robots))
            print(f"ready {ready:.2f} s, fan-out {1000 * fan_out:.1f} ms")
            assert ready < 5.0

    asyncio.run(flight())


def test_a_uri_that_is_none():
    with pytest.raises(InputError, match="radio://"):
        CrazyflieRobot("cf", "cf1")
