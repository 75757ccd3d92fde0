"""Poses on their way to the drones: the feed, the settings, the preflight, and where they come from."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
import time
from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest
from flights import flight_config
from pose_frames import LIMITS, NAMES, frame, reason

from llm_flock import plugins
from llm_flock.errors import InputError
from llm_flock.extras import ExtraMissing
from llm_flock.robots._base import Pose, PoseFrame, RobotError, RobotState
from llm_flock.robots._point_mass import PointMass
from llm_flock.runtime._ros2_config import Ros2Config
from llm_flock_flight._crazyflie.telemetry import LIGHTHOUSE_LOG, lighthouse_text
from llm_flock_flight._flight.positions import LOCALISATION, OUTSIDE, SENDER, checks_of, feeding, pose_source
from llm_flock_flight._positions import PoseFeed, PoseGate
from llm_flock_flight._positions.mocap import frame_of_bodies
from llm_flock_flight._testing.crtp.external import SILENT_S as STANDS_S
from llm_flock_flight._testing.crtp.firmware import LOCALIZATION, Firmware, packet
from llm_flock_swarm._ros2.flight import RosPoses
from llm_flock_swarm._ros2.wire import Attachment


class Source:
    """A source that a test speaks through."""

    def __init__(self) -> None:
        self.refused = Counter[str]({"malformed": 2})
        self.take: Any = None

    async def open(self, take: Any) -> None:
        self.take = take

    async def close(self) -> None:
        self.take = None


class Taker:
    """A robot that keeps the poses which it is sent."""

    def __init__(self) -> None:
        self.name, self.taken, self.lost = "a", list[Pose](), False

    async def take_pose(self, pose: Pose) -> None:
        if self.lost:
            raise RobotError("a", "the link is lost")
        self.taken.append(pose)


@pytest.mark.usefixtures("skipped_waits")
def test_each_drone_gets_its_newest_pose_at_a_bounded_rate() -> None:
    async def run() -> None:
        source, taker = Source(), Taker()
        async with PoseFeed(source, PoseGate(["a"], LIMITS, 1.0), {"a": taker}, 20.0) as feed:
            assert feed.age_s("a", time.monotonic()) is None
            began = time.monotonic()
            for k in range(100):
                source.take(frame(k / 100, a=(k / 1000, 0, 0)))
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.1)
            assert 15 <= len(taker.taken) <= 20 * (time.monotonic() - began) + 1
            assert taker.taken[-1] == Pose((0.099, 0, 0)), "the newest, not one from a queue"
            assert 0.05 < (feed.age_s("a", time.monotonic()) or 0.0) < 0.3
            source.take(frame(2.0, a=(9, 9, 9)))
            source.take(frame(2.1, x=(9, 9, 9)))
            assert feed.refused == {"a: jump": 1, "malformed": 2, "unknown_name": 1}
            taker.lost = True
            source.take(frame(2.2, a=(0.1, 0, 0)))
            await asyncio.sleep(0.1)
            assert (feed.age_s("a", time.monotonic()) or 0.0) > 0.2, "a pose that was not sent does not count"
            taker.lost = False
            source.take(frame(2.3, a=(0.1, 0, 0)))
            await asyncio.sleep(0.1)
            assert (feed.age_s("a", time.monotonic()) or 0.0) < 0.2, "and one failure ends nothing"
        assert source.take is None

    asyncio.run(run())


@pytest.mark.usefixtures("skipped_waits")
@pytest.mark.parametrize("attitude", [False, True])
def test_orientations_are_sent_only_if_they_are_asked_for(attitude: bool) -> None:
    async def run() -> Pose:
        source, taker = Source(), Taker()
        async with PoseFeed(source, PoseGate(["a"], LIMITS, 1.0), {"a": taker}, 20.0, attitude=attitude):
            source.take(PoseFrame(stamp_s=0.0, poses={"a": Pose((0, 0, 0), (0, 0, 0, 1))}))
            await asyncio.sleep(0.01)
        return taker.taken[0]

    assert (asyncio.run(run()).quaternion is not None) is attitude


class Deaf(Taker):
    """A robot whose link swallows a cancellation that comes just as a pose is sent, as Python 3.11 may."""

    async def take_pose(self, pose: Pose) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(0.5)


@pytest.mark.usefixtures("skipped_waits")
def test_the_feed_ends_although_a_cancellation_is_swallowed() -> None:
    async def run() -> None:
        source = Source()
        async with PoseFeed(source, PoseGate(["a"], LIMITS, 1.0), {"a": Deaf()}, 20.0):
            source.take(frame(0.0, a=(0, 0, 0)))
            await asyncio.sleep(0.1)

    asyncio.run(asyncio.wait_for(run(), 5.0))


# ------------------------------------------------------------------ flights


@pytest.mark.parametrize(
    ("fields", "field", "says"),
    [
        ({"pose_source": "radar"}, "pose_source", "unknown choice"),
        ({"pose_source": "udp"}, "pose_source", "robot = 'simulated'"),
        ({"pose_source": "udp", "robot": "physics"}, "pose_source", "robot = 'physics'"),
        ({"pose_source": "mocap", "robot": "crazyflie"}, "mocap_system", "is needed"),
        ({"pose_source": "mocap", "robot": "crazyflie", "mocap_system": "vicon"}, "mocap_host", "is needed"),
        ({"mocap_host": "vicon"}, "mocap_host", "only"),
        ({"pose_source": "ros2", "robot": "crazyflie"}, "router", "is needed"),
        ({"ros_pose_topic": "/mocap/r_{id}"}, "ros_pose_topic", "pose_source = 'ros2'"),
        ({"pose_lost_s": 0.05}, "pose_lost_s", "three poses at 30 a second"),
        ({"pose_port": 0}, "pose_port", "at least 1"),
        ({"pose_rate_hz": 1000}, "pose_rate_hz", "at most 200"),
    ],
)
def test_settings_that_cannot_work_are_refused(fields: dict[str, Any], field: str, says: str) -> None:
    with pytest.raises(InputError) as raised:
        flight_config(**fields)
    assert raised.value.field == field and says in str(raised.value)


def test_poses_from_ros_come_by_a_plug_in_whose_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    config = flight_config(pose_source="ros2", robot="crazyflie", router="tcp/127.0.0.1:7447")
    assert isinstance(pose_source(config), RosPoses)
    assert pose_source(flight_config()) is None
    monkeypatch.setattr(plugins, "entries", lambda _kind: {})
    with pytest.raises(ExtraMissing, match=r"pip install 'llm-flock\[ros2\]'"):
        pose_source(config)


def test_driver_without_poses_is_refused_before_anything_opens() -> None:
    source = Source()

    async def run() -> None:
        async with feeding(flight_config(), [SimpleNamespace(name="d0")], source):  # type: ignore[list-item]
            raise AssertionError

    with pytest.raises(InputError, match="d0 has none"):
        asyncio.run(run())
    assert source.take is None


@pytest.mark.usefixtures("skipped_waits")
def test_preflight_tells_age_and_agreement_of_each_pose() -> None:
    config = flight_config()

    async def run() -> None:
        source, taker = Source(), Taker()
        robots: Any = [taker]
        async with PoseFeed(source, PoseGate(["a"], LIMITS, 1.0), {"a": taker}, 20.0) as feed:
            look = checks_of(config, robots, feed)

            def check(position: Any) -> Any:
                found, _ = look([RobotState(position=position, stamp_s=0.0)], time.monotonic())
                assert (found.name, found.who) == (OUTSIDE, "a")
                return found

            assert not check((0.0, 0.0, 0.0)).passed
            assert check((0.0, 0.0, 0.0)).found == "none (dropped: malformed 2 times)"
            source.take(frame(0.0, a=(1.0, 0.0, 0.0)))
            await asyncio.sleep(0.01)
            assert check((1.0, 0.03, 0.0)).passed and "0.03 m from the estimate" in check((1.0, 0.03, 0.0)).found
            assert not check((1.0, 0.06, 0.0)).passed
            await asyncio.sleep(0.6)
            assert not check((1.0, 0.0, 0.0)).passed and check((1.0, 0.0, 0.0)).found.startswith("0.6")

    asyncio.run(run())


class Crowd(Source):
    """A source that several tell."""

    def __init__(self, *heard: str) -> None:
        super().__init__()
        self.heard = heard

    def senders(self, now: float) -> tuple[str, ...]:
        return self.heard


@pytest.mark.usefixtures("skipped_waits")
def test_a_preflight_listens_for_a_second_and_names_two_senders() -> None:
    config = flight_config()

    async def run(*heard: str) -> list[Any]:
        source, robots = Crowd(*heard), list[Any]()
        async with PoseFeed(source, PoseGate(["a"], LIMITS, 1.0), {}, 20.0) as feed:
            look, found = checks_of(config, robots, feed), list[Any]()
            for _ in range(2):
                found += look([], time.monotonic())
                await asyncio.sleep(1.1)
            return found

    early, late = asyncio.run(run("here:1"))
    assert {early.name, late.name} == {SENDER} and not early.passed and late.passed
    assert early.found == "listened for 0.0 s only" and late.found == "here:1"
    _, late = asyncio.run(run("here:1", "there:2"))
    assert not late.passed and late.found == "here:1 is followed, and there:2 sends as well"
    _, late = asyncio.run(run())
    assert late.passed


def test_two_publishers_of_ros_are_named_while_both_are_heard() -> None:
    source = RosPoses(Ros2Config(router="tcp/127.0.0.1:1"), "flock", NAMES)
    one, two = (Attachment(1, 5_000_000_000, bytes([k]) * 16) for k in range(2))
    source.frame("a", message(0.5), one)
    assert source.senders(time.monotonic()) == ()
    assert reason(source.frame, "a", message(0.5), two) == "second_source"
    now = time.monotonic()
    assert source.senders(now) == ("publisher 00000000 of a", "publisher 01010101 of a")
    assert source.senders(now + 1.5) == ()


def test_lighthouse_state_is_reported_and_never_refused() -> None:
    config = flight_config()
    robots: Any = [SimpleNamespace(name="a", localisation="Lighthouse: in use"), SimpleNamespace(name="b")]
    state = RobotState(position=(0.0, 0.0, 0.0), stamp_s=0.0)
    found = checks_of(config, robots, None)([state, state], 0.0)
    assert [(check.who, check.name, check.passed, check.found) for check in found] == [
        ("a", LOCALISATION, True, "Lighthouse: in use")
    ]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ((0, 0, 0), "Lighthouse: no base station is received; not checked: others may give positions"),
        ((1, 0b1000, 0), "Lighthouse: geometry or calibration is missing; receives 4, uses none"),
        ((2, 0b11, 0b10), "Lighthouse: in use; receives 1, 2, uses 2"),
        ((7, 1, 1), "Lighthouse: status 7; receives 1, uses 1"),
    ],
)
def test_lighthouse_variables_are_described(values: tuple[int, int, int], says: str) -> None:
    assert lighthouse_text(dict(zip(LIGHTHOUSE_LOG, values, strict=True))) == says


def test_rigid_bodies_of_a_motion_capture_become_a_frame() -> None:
    def body(*at: float) -> Any:
        return SimpleNamespace(position=at, rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0))

    bodies = {"a": body(1, 2, 3), "table": body(0, 0, 0), "b": body(math.nan, 0, 0)}
    found = frame_of_bodies(bodies, frozenset(NAMES), 7.0)
    assert found == PoseFrame(stamp_s=7.0, poses={"a": Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))})
    assert frame_of_bodies({"table": body(0, 0, 0)}, frozenset(NAMES), 7.0) is None


def message(x: float, turn: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0), frame_id: str = "world") -> Any:
    """A PoseStamped."""
    pose = SimpleNamespace(
        position=SimpleNamespace(x=x, y=0.0, z=1.0),
        orientation=SimpleNamespace(**dict(zip("xyzw", turn, strict=True))),
    )
    return SimpleNamespace(header=SimpleNamespace(frame_id=frame_id), pose=pose)


def test_messages_of_ros_become_frames() -> None:
    source = RosPoses(Ros2Config(router="tcp/127.0.0.1:1"), "flock", NAMES)
    one, two = (Attachment(1, 5_000_000_000, bytes([k]) * 16) for k in range(2))
    assert source.frame("a", message(0.5), one) == PoseFrame(
        stamp_s=5.0, poses={"a": Pose((0.5, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0))}
    )
    assert source.frame("a", message(0.5, (0.0,) * 4), one).poses["a"].quaternion is None
    assert reason(source.frame, "a", message(0.5), two) == "second_source"
    assert reason(source.frame, "b", message(math.nan), one) == "not_finite"
    assert reason(source.frame, "b", message(1e9), one) == "out_of_range"
    assert reason(source.frame, "b", message(0.0, frame_id="map"), one) == "wrong_frame"


# ------------------------------------------------------------------ the stand-in


def test_stand_in_uses_sent_poses_and_stays_without() -> None:
    firmware = Firmware(PointMass(home=(1.0, 2.0, 0.0)), outside=True)
    assert firmware.body.estimate(0.0) == (0.0, 0.0, 0.0)
    firmware.tick(1.0)
    assert firmware.body.variance(2.0) > 0.01, "an estimator without positions does not converge"
    told = packet(LOCALIZATION, 0, struct.pack("<fff", 1.0, 2.0, 0.02))
    for k in range(20):
        assert firmware.handle(told, 3.0 + k / 50) == []
    assert firmware.body.estimate(3.4) == pytest.approx((1.0, 2.0, 0.02), abs=1e-3)
    assert firmware.body.variance(3.4) < 1e-4
    before = firmware.body.variance(3.4)
    firmware.tick(3.4 + 2 * STANDS_S)
    assert firmware.body.variance(4.4) > before
    pose = packet(LOCALIZATION, 1, struct.pack("<Bfffffff", 8, 1.0, 2.0, 0.02, 0, 0, 0, 1))
    firmware.handle(pose, 5.0)
    assert firmware.body.variance(5.0) < 1e-4 and firmware.outside is not None and len(firmware.outside.taken) == 21
