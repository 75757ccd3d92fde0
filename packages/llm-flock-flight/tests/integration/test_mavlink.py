"""The MAVLink driver: the real pymavlink on stand-ins for autopilots. No PX4 and no ArduPilot takes part."""

from __future__ import annotations

import asyncio
import random
import socket
import time

import pytest

pytest.importorskip("pymavlink")

from mavlink_flights import FLAVOURS, GUIDED, HOME, PILOT, in_air, on_ground, robot_of, until, up

from llm_flock.errors import InputError
from llm_flock.robots._base import MotionLimits, RobotError, TakenOver
from llm_flock.testing import check_emergency_stop, check_robot
from llm_flock_flight._mavlink import MavlinkRobot, orders
from llm_flock_flight._mavlink.codec import Codec, introduces
from llm_flock_flight._mavlink.modes import px4
from llm_flock_flight._mavlink.port import STRANGERS
from llm_flock_flight._testing.mavlink import AutopilotStandIns

pytestmark = pytest.mark.clock(2)


@pytest.fixture
def patient(monkeypatch):
    """Let orders be tried for longer: a tenth of all packets is lost here, and the machine may be busy."""
    monkeypatch.setattr(orders, "ORDER_S", 2.5)
    monkeypatch.setattr(orders, "STOP_S", 2.5)


def test_the_driver_keeps_the_contract(patient):
    """Both flavours at once, without loss and with a tenth of all packets lost in each direction."""

    async def check(flavour, loss):
        with AutopilotStandIns([HOME], flavour=flavour, loss=loss, seed=1) as vehicles:
            await check_robot(robot_of(vehicles), patience_s=6.0)
            assert not vehicles[0].armed

    async def check_all():
        await asyncio.gather(*(check(flavour, loss) for flavour in FLAVOURS for loss in (0.0, 0.1)))

    asyncio.run(check_all())


def test_an_emergency_stop_is_confirmed(patient):
    async def check(flavour):
        with AutopilotStandIns([HOME], flavour=flavour, loss=0.1, seed=2) as vehicles:
            await check_emergency_stop(robot_of(vehicles))
            assert not vehicles[0].armed

    async def check_all():
        await asyncio.gather(*map(check, FLAVOURS))

    asyncio.run(check_all())


def test_an_emergency_stop_that_is_refused_becomes_a_termination():
    async def act(robot, vehicle):
        vehicle.autopilot.refuse[400] = (2, "")
        assert await robot.stop_motors()
        assert not vehicle.armed and vehicle.autopilot.commands[-1] == 185

    in_air("ardupilot", act)


def test_unheard_emergency_stop_is_not_confirmed():
    async def act(robot, vehicle):
        vehicle.deaf = True
        assert await robot.stop_motors() is False
        vehicle.deaf = False
        assert await robot.stop_motors() is True

    in_air("px4", act)


# What comes from the autopilot in words.


@pytest.mark.parametrize(("flavour", "text"), [("px4", "ekf2 missing data"), ("ardupilot", "Need Position Estimate")])
def test_a_refusal_to_arm_names_the_autopilots_reason(flavour, text):
    async def act(robot, vehicle):
        vehicle.autopilot.healthy = False
        with pytest.raises(RobotError, match=f"refused to arm: .*{text}"):
            await asyncio.wait_for(robot.arm(), 3.0)
        assert not vehicle.armed

    on_ground(flavour, act)


@pytest.mark.parametrize(
    ("number", "what"), [(176, "mode (Offboard|Guided)"), (400, "to arm")], ids=["set mode", "arm"]
)
@pytest.mark.parametrize(("result", "word"), [(2, "denied"), (3, "unsupported"), (4, "failed")])
def test_refusals_on_the_ground(number, what, result, word):
    async def act(robot, vehicle):
        vehicle.autopilot.refuse[number] = (result, "the reason")
        with pytest.raises(RobotError, match=rf"refused {what}: {word} \(the reason\)"):
            await robot.arm()
        with pytest.raises(RobotError, match="not armed"):
            await robot.take_off(1.0, 1.0)

    on_ground(FLAVOURS, act)


def test_refused_take_off_leaves_the_robot_on_the_ground():
    async def act(robot, vehicle):
        vehicle.autopilot.refuse[22] = (4, "")
        await robot.arm()
        with pytest.raises(RobotError, match="refused take-off: failed"):
            await robot.take_off(1.0, 1.0)
        with pytest.raises(RobotError, match="not in the air"):
            await robot.go_to((1.0, 2.0, 1.0), 1.0)

    on_ground("ardupilot", act)


@pytest.mark.parametrize("number", [176, 400, 22])
def test_lost_answers_do_no_harm(number):
    """The autopilot has done it already, and refuses a second take-off: the driver sees that it was done."""

    async def act(robot, vehicle):
        vehicle.autopilot.deaf_to[number] = 1
        await robot.arm()
        await robot.take_off(1.0, 1.0)
        assert vehicle.armed

    on_ground("ardupilot", act)


def test_an_autopilot_that_never_answers_is_named_in_time():
    async def act(robot, vehicle):
        vehicle.autopilot.refuse[176] = (5, "")  # in progress, without end
        began = time.monotonic()
        with pytest.raises(RobotError, match="did not answer to mode"):
            await robot.arm()
        assert time.monotonic() - began < 3.0

    on_ground("ardupilot", act)


def test_offboard_is_asked_for_after_a_stream_of_set_points():
    async def act(robot, vehicle):
        await robot.arm()
        assert vehicle.mode == "Offboard"
        points = list(vehicle.autopilot.set_points)
        assert len(points) > 10 and all(down > 0.0 for _, _, down in points), "below the ground until take-off"
        await asyncio.sleep(0.5)
        assert vehicle.autopilot.on_ground

    on_ground("px4", act)


# Who flies it.


def test_a_pilots_switch_is_not_fought():
    async def act(robot, vehicle):
        await robot.go_to((2.0, 2.0, 1.0), 3.0)
        vehicle.switch(PILOT[vehicle.flavour])
        await until(lambda: robot.state().taken_over is not None, 2.0)
        assert f"its mode is {PILOT[vehicle.flavour]}, not {GUIDED[vehicle.flavour]}" in str(robot.state().taken_over)
        await asyncio.sleep(0.5)
        sent, commands = len(vehicle.autopilot.set_points), len(vehicle.autopilot.commands)
        for command in (robot.go_to((1.0, 2.0, 1.0), 1.0), robot.hold(), robot.land(0.0, 1.0)):
            with pytest.raises(TakenOver, match="a pilot or a failsafe flies it"):
                await command
        await asyncio.sleep(0.3)
        assert len(vehicle.autopilot.set_points) == sent and len(vehicle.autopilot.commands) == commands
        await robot.connect(3.0)
        with pytest.raises(TakenOver, match="a pilot or a failsafe flies it"):
            await robot.land(0.0, 1.0)
        assert vehicle.mode == PILOT[vehicle.flavour]

    in_air(FLAVOURS, act)


def test_a_pilots_switch_back_gives_nothing_back():
    async def act(robot, vehicle):
        vehicle.switch("Position")
        await until(lambda: robot.state().taken_over is not None, 2.0)
        vehicle.switch("Offboard")
        with pytest.raises(TakenOver, match="a pilot or a failsafe flies it"):
            await robot.go_to((1.0, 2.0, 1.0), 1.0)

    in_air("px4", act)


def test_a_switch_while_it_lands_ends_the_landing():
    async def act(robot, vehicle):
        await robot.land(0.0, 2.0)
        await asyncio.sleep(0.3)
        vehicle.switch(PILOT[vehicle.flavour])
        await until(lambda: robot.state().taken_over is not None, 2.0)
        await asyncio.sleep(2.2)
        assert vehicle.mode == PILOT[vehicle.flavour] and vehicle.armed

    in_air(FLAVOURS, act)


def test_a_stream_that_stops_is_left_to_px4():
    """What happens when this process dies: the stand-in lands as COM_OBL_RC_ACT says."""

    async def act(robot, vehicle):
        await robot.close()
        await until(lambda: vehicle.mode == "Land", 2.0)
        await until(lambda: not vehicle.armed, 8.0)

    in_air("px4", act)


@pytest.mark.parametrize(("flavour", "held"), [("px4", "Hold"), ("ardupilot", "Guided"), ("ardupilot", "Brake")])
def test_hovering_vehicle_can_be_landed_after_a_reconnection(flavour, held):
    async def act(robot, vehicle):
        await robot.close()
        vehicle.switch(held)
        await robot.connect(3.0)
        state = robot.state()
        assert state.flying and state.taken_over is None
        if held != GUIDED[flavour]:
            with pytest.raises(RobotError, match="can only be landed"):
                await robot.go_to((1.0, 2.0, 1.0), 1.0)
        await robot.land(0.0, 1.0)
        await until(lambda: not vehicle.armed, 6.0)
        await until(lambda: not robot.state().flying, 2.0)

    in_air(flavour, act)


# Links.


def test_no_set_point_is_outside_the_box():
    async def act(robot, vehicle):
        await robot.go_to((1.6, 2.0, 1.0), 0.8)
        await asyncio.sleep(0.4)
        sent = await robot.go_to((9.0, 2.0, 1.0), 1.0)
        assert sent.target[0] <= 1.8 and sent.duration_s == 1.0
        await asyncio.sleep(1.2)
        assert max(east for _, east, _ in vehicle.autopilot.set_points) <= 0.8 + 1e-6

    in_air("px4", act, limits=MotionLimits(low=(0.0, 0.0, -1.0), high=(1.8, 4.0, 2.0)))


def test_velocities_are_fed_forward():
    async def act(robot, vehicle):
        await robot.go_to((2.0, 2.0, 1.0), 2.0)
        await asyncio.sleep(1.0)
        with vehicle.lock:
            _, east, _ = vehicle.autopilot.body.feed_forward
        assert east == pytest.approx(1.09, abs=0.1)

    in_air("px4", act)


def hostile_packets(rng: random.Random, good: list[bytes]):
    """Noise, torn and altered packets, and well-formed ones with absurd values."""
    while True:
        packet = bytearray(rng.choice(good))
        kind = rng.randrange(4)
        if kind == 0:
            yield rng.randbytes(rng.randrange(300))
        elif kind == 1:
            yield bytes(packet[: rng.randrange(len(packet))])
        elif kind == 2:
            packet[rng.randrange(len(packet))] ^= 1 << rng.randrange(8)
            yield bytes(packet) * rng.randrange(1, 4)
        else:
            yield bytes(packet)


def absurd_messages() -> list[bytes]:
    """Valid packets of a vehicle whose values cannot be."""
    codec, nan, huge = Codec(1, 1), float("nan"), 3e38
    return [
        codec.encode("local_position_ned", 0, nan, 0.0, 0.0, 0.0, 0.0, 0.0),
        codec.encode("local_position_ned", 0, huge, -huge, float("inf"), 0.0, 0.0, 0.0),
        codec.encode("attitude", 0, nan, nan, nan, nan, nan, nan),
        codec.encode("statustext", 2, b"\xff\xfe\x1b[2J" + b"\xe2" * 40),
        codec.encode("param_value", b"\xff\xff", nan, 255, 65535, 65535),
        codec.encode("param_value", b"COM_OF_LOSS_T", huge, 6, 1, 0),
        codec.encode("gps_global_origin", 2**31 - 1, -(2**31), 2**31 - 1),
        codec.encode("command_ack", 65535, 255),
        codec.encode("heartbeat", 255, 255, 255, 2**32 - 1, 255),
        codec.encode("estimator_status", 0, 65535, *(nan,) * 8),
        codec.encode("sys_status", 0, 0, 0, 0, 65535, -1, -1, 0, 0, 0, 0, 0, 0),
        codec.encode("extended_sys_state", 255, 255),
    ]


def test_hostile_bytes_never_leave_the_driver():
    rng = random.Random(5)

    async def act(robot, vehicle):
        errors = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: errors.append(context))
        before = robot.state().position
        packets = hostile_packets(rng, absurd_messages())
        peer = vehicle.socket.getsockname()  # as if the vehicle itself had sent them
        for k in range(3000):
            for message in robot._port._codec.datagram(next(packets)):
                robot._port._on_messages([message], ("127.0.0.1", peer[1]))
            if k % 100 == 0:
                vehicle.socket.sendto(rng.randbytes(500), ("127.0.0.1", robot._port._address.port))
                await asyncio.sleep(0)
        await asyncio.sleep(0.3)
        state = robot.state()
        assert not errors and not state.link_lost and state.taken_over is None
        assert state.position == pytest.approx(before, abs=0.01)
        await robot.arm()

    on_ground("px4", act)


def test_a_stranger_cannot_speak_for_a_vehicle():
    async def act(robot, vehicle):
        forged = Codec(1, 1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for _ in range(5):
                place = ("127.0.0.1", robot._port._address.port)
                stranger.sendto(forged.encode("local_position_ned", 0, 50.0, 0.0, 0.0, 0.0, 0.0, 0.0), place)
                stranger.sendto(forged.encode("heartbeat", 2, 12, 0x81, px4(3), 4), place)
                await asyncio.sleep(0.02)
        assert robot.state().position == pytest.approx(HOME, abs=0.01) and not robot.state().armed

    on_ground("px4", act)


def test_a_stranger_s_flood_is_not_parsed():
    """Nothing of a known vehicle is lost in it, and no more of the stranger's is read than could be introductions."""

    async def act(robot, vehicle):
        codec, forged, parsed = robot._port._codec, Codec(1, 1), []
        plain = codec.datagram
        codec.datagram = lambda data: parsed.append(data) or plain(data)
        lies = [
            forged.encode("local_position_ned", 0, 50.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            b"\xfd" * 400,
            forged.encode("heartbeat", 2, 12, 0x81, px4(3), 4),
        ]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            # It introduces itself, as a vehicle that nobody here flies.
            stranger.sendto(Codec(77, 1).encode("heartbeat", 2, 12, 0, 0, 4), ("127.0.0.1", robot._port._address.port))
            await until(lambda: 77 in robot._port.heard_ids)
            for k in range(3000):
                stranger.sendto(lies[k % 3], ("127.0.0.1", robot._port._address.port))
                if k % 30 == 29:
                    await asyncio.sleep(0)
        await asyncio.sleep(0.2)
        heartbeats = sum(data in lies for data in parsed)
        assert 0 < heartbeats <= 2 * STRANGERS and not {lies[0], lies[1]} & set(parsed)
        state = robot.state()
        assert state.position == pytest.approx(HOME, abs=0.01) and not state.armed and not state.link_lost
        assert len(parsed) > heartbeats, "the vehicle is still heard"

    on_ground("px4", act)


def test_a_heartbeat_among_other_packets_introduces_a_vehicle():
    codec = Codec(1, 1)
    beat, place = codec.encode("heartbeat", 2, 12, 1, 0, 4), codec.encode("attitude", 0, *(0.0,) * 6)
    assert introduces(beat) and introduces(place + place + beat)
    assert not introduces(place) and not introduces(b"") and not introduces(b"\xfd") and not introduces(b"x" + beat)
    old = bytes((0xFE, 9, 0, 1, 1, 0)) + bytes(11)
    assert introduces(old) and not introduces(old[:5] + b"\x1e" + old[6:])


@pytest.mark.parametrize("uri", ["", "udp://", "udp://host", "tcp://host:1", "radio://0/80/2M", "udp://host:99999"])
def test_addresses_that_are_none(uri):
    with pytest.raises(InputError, match=r"udp://0\.0\.0\.0:14540"):
        MavlinkRobot("v", uri)


def test_a_system_id_that_is_none():
    with pytest.raises(InputError, match="system_id"):
        MavlinkRobot("v", "udp://0.0.0.0:14540", system_id=255)


def test_a_second_flight_after_a_landing():
    async def act(robot, vehicle):
        for _ in range(2):
            await robot.land(0.0, 1.0)
            await until(lambda: not robot.state().flying, 6.0)
            assert not vehicle.armed
            await up(robot)
        assert vehicle.armed

    in_air(FLAVOURS, act)
