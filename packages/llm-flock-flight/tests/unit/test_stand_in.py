"""What a stand-in answers, packet by packet, without sockets or a clock."""

from __future__ import annotations

import random
import struct

import pytest

from llm_flock.robots._point_mass import BUSY, REFUSED, PointMass
from llm_flock_flight._testing.crtp.firmware import LOGGED, VERSION, Firmware, packet

HIGH_LEVEL, SUPERVISOR, PARAM, LOGGING = 8, 9, 2, 5
ARMED, FLYING, LOCKED = 0x02, 0x10, 0x40


def drone(controller=2, **options):
    """With Mellinger's controller it is where its set-point is."""
    return Firmware(PointMass(home=(1.0, 2.0, 0.0), **options), controller=controller)


def one(answers):
    """Port, channel and data of the only answer."""
    (raw,) = answers
    return raw[0] >> 4, raw[0] & 3, raw[1:]


def take_off(firmware, now, height=1.0, duration=1.0):
    data = struct.pack("<BBff?f", 7, 0, height, 0.0, True, duration)
    return one(firmware.handle(packet(HIGH_LEVEL, 0, data), now))[2][3]


def info(firmware, now):
    return struct.unpack("<H", one(firmware.handle(packet(SUPERVISOR, 0, [0x0C]), now))[2][1:3])[0]


def aloft(now=1.0, **options):
    firmware = drone(auto_arm=True, **options)
    assert take_off(firmware, now) == 0
    return firmware


def test_a_scan_is_answered_and_so_are_link_and_version():
    firmware = drone()
    assert firmware.handle(b"\xff", 0.0) == [b"\xff"]
    assert one(firmware.handle(packet(15, 1, [0]), 0.0))[2].startswith(b"Bitcraze Crazyflie")
    assert one(firmware.handle(packet(15, 0, b"ping"), 0.0)) == (15, 0, b"ping")
    assert one(firmware.handle(packet(13, 1, [0]), 0.0))[2] == bytes([0, VERSION])


def test_the_table_of_log_variables_is_complete():
    firmware = drone()
    _, _, data = one(firmware.handle(packet(LOGGING, 0, [3]), 0.0))
    count, _ = struct.unpack("<HI", data[1:7])
    names = []
    for number in range(count):
        _, _, data = one(firmware.handle(packet(LOGGING, 0, struct.pack("<BH", 2, number)), 0.0))
        names.append(".".join(data[4:-1].decode().split("\0")))
    assert names == list(LOGGED)


def test_parameters_are_read_and_written():
    firmware = drone()
    assert one(firmware.handle(packet(PARAM, 1, struct.pack("<H", 0)), 0.0))[2] == b"\0\0\0\2"
    answer = one(firmware.handle(packet(PARAM, 2, struct.pack("<HB", 1, 5)), 0.0))
    assert answer[2] == b"\1\0\5" and firmware.parameters["stabilizer.controller"].value == 5
    assert one(firmware.handle(packet(PARAM, 1, struct.pack("<H", 99)), 0.0))[2][2] != 0


def test_a_log_block_comes_at_its_period_until_it_is_stopped():
    firmware = drone()
    rows = struct.pack("<BHBH", 0x77, 0, 0x22, 8)  # stateEstimate.x as a float, supervisor.info
    assert one(firmware.handle(packet(LOGGING, 1, bytes([6, 1]) + rows), 0.0))[2] == bytes([6, 1, 0])
    assert one(firmware.handle(packet(LOGGING, 1, bytes([6, 1]) + rows), 0.0))[2] == bytes([6, 1, 17])
    assert firmware.tick(0.0) == []
    firmware.handle(packet(LOGGING, 1, [3, 1, 5]), 1.0)
    came = [t for t in range(1000, 1200) if firmware.tick(t / 1000.0)]
    assert len(came) == 4 and came[1] - came[0] == 50
    _, channel, data = one(firmware.tick(1.21))
    assert channel == 2 and data[0] == 1
    x, bits = struct.unpack("<fH", data[4:])
    assert x == pytest.approx(1.0, abs=1e-3) and not bits & ARMED
    firmware.handle(packet(LOGGING, 1, [4, 1]), 1.3)
    assert firmware.tick(2.0) == []
    assert one(firmware.handle(packet(LOGGING, 1, [3, 9, 5]), 2.0))[2][2] != 0


def test_commands_are_refused_while_they_make_no_sense():
    firmware = drone()
    assert take_off(firmware, 0.0) == BUSY
    assert one(firmware.handle(packet(SUPERVISOR, 1, [1, 1]), 0.0))[2] == bytes([0x81, 1, 1])
    assert take_off(firmware, 0.0) == 0 and take_off(firmware, 0.5) == REFUSED
    assert [command for _, command in firmware.commands] == [7, 7, 7]


def test_landed_drone_says_it_flies_two_seconds_then_disarms():
    firmware = drone()
    firmware.handle(packet(SUPERVISOR, 1, [1, 1]), 0.0)
    assert take_off(firmware, 0.0) == 0
    data = struct.pack("<BBff?f", 8, 0, 0.0, 0.0, True, 1.0)
    assert one(firmware.handle(packet(HIGH_LEVEL, 0, data), 2.0))[2][3] == 0
    assert info(firmware, 2.9) & FLYING
    assert not firmware.body.flying or firmware.body.position(3.1)[2] == 0.0
    assert info(firmware, 4.0) & FLYING and info(firmware, 4.0) & ARMED
    assert not info(firmware, 5.2) & (FLYING | ARMED)


def test_without_the_link_a_drone_hovers_on():
    firmware = aloft()
    assert firmware.body.position(3600.0) == pytest.approx((1.0, 2.0, 1.0))
    assert info(firmware, 3600.0) & FLYING


def relax(firmware, now):
    firmware.handle(packet(7, 1, struct.pack("<BI", 0, 0)), now)


def test_set_point_left_by_another_client_outranks_every_plan():
    """Take-offs are confirmed, and no motor turns, until the drone is told that no more set-points come."""
    firmware = drone(auto_arm=True)
    firmware.handle(packet(3, 0, struct.pack("<fffH", 0, 0, 0, 0)), 1.0)
    assert take_off(firmware, 2.0) == 0
    assert not firmware.body.flying and firmware.body.position(5.0)[2] == 0.0
    relax(firmware, 6.0)
    assert take_off(firmware, 7.0) == 0
    assert firmware.body.position(8.5)[2] == pytest.approx(1.0)


def test_the_stock_controller_lags_by_half_a_second():
    firmware = drone(controller=1, auto_arm=True)
    assert take_off(firmware, 0.0, duration=2.5) == 0
    behind = max(firmware.body.set_point(t / 50)[0][2] - firmware.body.position(t / 50)[2] for t in range(150))
    assert 0.27 < behind < 0.42, "what firmware in the loop was seen to do"
    assert firmware.body.position(10.0)[2] == pytest.approx(1.0, abs=0.03)
    mellinger = struct.pack("<HB", 1, 2)
    firmware.handle(packet(PARAM, 2, mellinger), 11.0)
    data = struct.pack("<BB??fffff", 12, 0, False, False, 1.5, 2.0, 1.0, 0.0, 2.0)
    firmware.handle(packet(HIGH_LEVEL, 0, data), 15.0)
    assert firmware.body.position(16.0) == pytest.approx(firmware.body.set_point(16.0)[0], abs=1e-3)


def test_tumbled_drone_falls_and_does_not_arm_before_recovery():
    firmware = aloft()
    firmware.tumble(3.0)
    assert info(firmware, 3.0) & 0x20 and info(firmware, 3.0) & 0x80 and not info(firmware, 3.0) & FLYING
    assert firmware.body.position(4.0)[2] == 0.0
    arm = packet(SUPERVISOR, 1, [1, 1])
    assert one(firmware.handle(arm, 5.0))[2] == bytes([0x81, 0, 0])
    firmware.tumbled = False
    firmware.handle(packet(SUPERVISOR, 1, [2]), 6.0)
    assert not info(firmware, 6.0) & 0xA0 and one(firmware.handle(arm, 6.1))[2] == bytes([0x81, 1, 1])


def test_firmware_may_lack_log_variables():
    firmware = Firmware(PointMass(home=(0.0, 0.0, 0.0)), missing=("pm.vbat",))
    _, _, data = one(firmware.handle(packet(LOGGING, 0, [3]), 0.0))
    assert struct.unpack("<H", data[1:3])[0] == len(LOGGED) - 1


def test_low_level_set_point_drops_the_drone_then_locks_it():
    firmware = aloft()
    firmware.handle(packet(3, 0, struct.pack("<fffH", 0, 0, 0, 0)), 3.0)
    assert not firmware.body.flying and firmware.body.position(4.0)[2] == 0.0
    assert not info(firmware, 4.9) & LOCKED
    assert info(firmware, 5.1) & LOCKED
    on_the_ground = drone(auto_arm=True)  # there it is not locked, but does not take off either
    on_the_ground.handle(packet(3, 0, struct.pack("<fffH", 0, 0, 0, 0)), 3.0)
    assert not info(on_the_ground, 10.0) & LOCKED


@pytest.mark.parametrize(("port", "channel"), [(9, 1), (6, 1)])
def test_an_emergency_stop_locks(port, channel):
    firmware = aloft()
    firmware.handle(packet(port, channel, [3]), 3.0)
    assert info(firmware, 3.0) & LOCKED and not info(firmware, 3.0) & (ARMED | FLYING)
    assert take_off(firmware, 5.0) == BUSY


def test_emergency_watchdog_wants_to_be_fed_every_second():
    firmware = aloft()
    for now in (3.0, 3.9, 4.8):
        firmware.handle(packet(SUPERVISOR, 1, [4]), now)
        assert not info(firmware, now + 0.05) & LOCKED
    assert info(firmware, 5.9) & LOCKED


def test_relative_and_absolute_way_points():
    firmware = aloft()
    data = struct.pack("<BB??fffff", 12, 0, True, False, 0.5, 0.0, 0.0, 0.0, 1.0)
    assert one(firmware.handle(packet(HIGH_LEVEL, 0, data), 3.0))[2][3] == 0
    assert firmware.body.position(4.5) == pytest.approx((1.5, 2.0, 1.0))
    data = struct.pack("<BB??fffff", 12, 0, False, False, 0.0, 0.0, 0.5, 0.0, 1.0)
    firmware.handle(packet(HIGH_LEVEL, 0, data), 5.0)
    assert firmware.body.position(6.5) == pytest.approx((0.0, 0.0, 0.5))
    firmware.handle(packet(HIGH_LEVEL, 0, [3, 0]), 7.0)
    assert not firmware.body.flying


def test_stand_in_ignores_unknown_packets():
    firmware = drone()
    for raw in (
        packet(9, 0, [0x20]),
        packet(13, 0, [1]),
        packet(2, 3, [7, 0, 0]),
        packet(7, 0, [0]),
        packet(5, 0, [9]),
    ):
        assert firmware.handle(raw, 0.0) == []


def test_no_packet_ends_a_stand_in():
    """One byte to one of them stopped the thread that serves them all."""
    rng = random.Random(0)
    packets = [bytes([first]) for first in range(256)]
    packets += [bytes([rng.choice(packets)[0], *rng.randbytes(rng.randrange(40))]) for _ in range(20_000)]
    firmware = drone(auto_arm=True)
    for number, data in enumerate(packets):
        firmware.handle(data, 0.01 * number)
    assert one(firmware.handle(packet(15, 0, b"ping"), 1000.0)) == (15, 0, b"ping")
