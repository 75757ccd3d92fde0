"""Flights of stand-ins by positions from outside: the real cflib, the real port, and a motion capture's faults."""

from __future__ import annotations

import asyncio
import json
import math
import re
import socket
import sys
import textwrap
import time
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from flights import figures

from llm_flock.errors import InputError
from llm_flock.record._reader import read_record
from llm_flock.robots._base import Pose, PoseFrame
from llm_flock.testing._robots import wait_until
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import with_drones
from llm_flock_flight._positions.mocap import MocapPoses
from llm_flock_flight._positions.udp import UdpPoses, datagram_of
from llm_flock_flight._testing.crtp import StandIns
from llm_flock_flight._testing.poses import PoseStream

pytestmark = pytest.mark.clock(2)

STARTS = ((-0.6, -0.6), (0.6, -0.6), (0.0, 0.7))
NAMES = ("cf0", "cf1", "cf2")
FLIGHT: dict[str, Any] = {
    "robot": "crazyflie",
    "pose_source": "udp",
    "round_s": 1.0,
    "max_speed_m_s": 3.0,
    "take_off_s": 0.8,
    "land_s": 0.8,
    "take_off_group": 3,
    "connect_s": 5.0,
    "deadman": False,
    # A machine that is busy stalls for a while:
    "pose_late_s": 1.0,
    "pose_lost_s": 1.5,
    "stall_s": 2.0,
    "off_course_s": 4.0,
}

Act = Callable[[PoseStream], None]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def config_of(uris: list[str], port: int, **fields: Any) -> FlightConfig:
    mission = {"shape": "triangle", "n_robots": 3, "center": [15, 15], "arena": [[0, 0], [30, 30]], "comm_range": 40}
    drones = [{"name": n, "uri": uri, "start": at} for n, uri, at in zip(NAMES, uris, STARTS, strict=True)]
    if "crazyflies" in fields:  # a file to write, in which all initial positions are zero
        robots = {
            name: {"enabled": True, "uri": uri, "initial_position": [0.0, 0.0, 0.0], "type": "cf"}
            for name, uri in zip(NAMES, uris, strict=True)
        }
        Path(fields["crazyflies"]).write_text(json.dumps({"robots": robots, "robot_types": {"cf": {}}}))
        drones = []
    given = {**FLIGHT, "drones": drones, "pose_port": port, **fields}
    return with_drones(FlightConfig.build({"mission": mission}, **given))


async def fly(config: FlightConfig, stream: PoseStream, act: Act | None, after_s: float) -> Any:
    pytest.importorskip("cflib")
    from llm_flock_flight._flight.fleet import build_fleet
    from llm_flock_flight._flight.flight import Flight

    tasks: list[asyncio.Task[None]] = []

    async def later() -> None:
        await asyncio.sleep(after_s)
        assert act is not None
        act(stream)

    def on_stage(stage: str) -> None:
        if stage == "flying" and act is not None:
            tasks.append(asyncio.get_running_loop().create_task(later()))

    async def yes(_: object) -> bool:
        return True

    return await Flight(config, build_fleet(config), on_stage=on_stage).run(yes)


def flown(
    act: Act | None = None, *, noise_m: float = 0.003, after_s: float = 0.3, rivals: int = 0, **fields: Any
) -> Any:
    """The flight's result; the positions that each stand-in was told, beside where it was; and the stream."""
    port = free_port()
    with StandIns([(x, y, 0.0) for x, y in STARTS], outside=True, controller=2) as drones:
        places = {name: (lambda k=k: drones[k].position) for k, name in enumerate(NAMES)}
        streams = [PoseStream(("127.0.0.1", port), places, noise_m=noise_m) for _ in range(1 + rivals)]
        with ExitStack() as stack:
            stream, *_ = [stack.enter_context(one) for one in streams]
            result = asyncio.run(fly(config_of(drones.uris, port, **fields), stream, act, after_s))
        outsides = [drones[k].firmware.outside for k in range(len(drones))]
        return result, [found.taken for found in outsides if found is not None], stream


def test_noise_drop_out_and_a_strange_flood_are_flown_through(tmp_path: Path) -> None:
    lies = PoseFrame(stamp_s=0.0, poses={name: Pose((5.0, 5.0, 5.0)) for name in NAMES})

    def act(stream: PoseStream) -> None:
        stream.silent = True
        loop = asyncio.get_running_loop()
        loop.call_later(0.3, setattr, stream, "silent", False)
        loop.call_later(0.8, flood, stream)

    def flood(stream: PoseStream) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for data in (b"\xff" * 800, b'{"time": 1', datagram_of(lies)):
                for _ in range(300):
                    stranger.sendto(data, stream._address)

    result, taken, _ = flown(act, out=str(tmp_path))
    flight = figures(result)
    assert result.result.formed and flight.ended == "mission" and flight.safe
    checks = [check for check in result.report.checks if check.name == "position from outside"]
    assert len(checks) == 3 and all("m from the estimate" in check.found for check in checks)
    for told in taken:
        rate = (len(told) - 1) / (told[-1][0] - told[0][0])
        assert rate <= 31, "30 poses a second, although 100 come"
        assert all(position[2] < 2.0 for _, position in told), "no lie was sent"
    assert max(b[0] - a[0] for told in taken for a, b in pairwise(told)) > 0.25, (
        "0.3 s, less the time of a pose that was already on its way"
    )
    assert (flight.poses_refused or {})["second_sender"] > 100
    kinds = [event.kind for event in read_record(tmp_path / "run.mcap").flight]
    assert kinds.count("poses") == 1


def test_drones_begin_where_they_are_measured(tmp_path: Path) -> None:
    result, _, _ = flown(crazyflies=str(tmp_path / "crazyflies.yaml"), at_end="return", out=str(tmp_path))
    flight = figures(result)
    assert result.result.formed and flight.ended == "mission" and flight.safe
    starts = [check.found for check in result.report.checks if check.name == "start position"]
    assert starts == ["not checked: no start is given"] * 3
    landed = read_record(tmp_path / "run.mcap").bodies[-1].measured
    assert all(math.dist(at[:2], start) < 0.15 for at, start in zip(landed, STARTS, strict=True))


def test_two_motion_captures_are_named_and_prevent_take_off() -> None:
    result, _, _ = flown(rivals=1)
    (failed,) = [check for check in result.report.checks if not check.passed]
    assert result.result is None and (failed.name, failed.who) == ("one sender of positions", "team")
    ports = re.fullmatch(r"127.0.0.1:(\d+) is followed, and 127.0.0.1:(\d+) sends as well", failed.found)
    assert ports is not None and ports[1] != ports[2]


def test_pose_frozen_while_its_drone_moves_is_not_sent_long() -> None:
    def freeze(stream: PoseStream) -> None:
        stream.frozen = frozenset({"cf1"})

    result, taken, _ = flown(freeze, pose_lost_s=0.5)
    flight = figures(result)
    assert flight.ended in ("pose_lost", "off_course") and "cf1" in (flight.reason or ""), flight.reason
    refused = flight.poses_refused or {}
    assert refused["cf1: frozen"] > 5 and "cf0: frozen" not in refused, refused
    last = taken[1][-1]
    repeated = [when for when, at in taken[1] if at == last[1]]
    assert len(repeated) > 3 and repeated[-1] - repeated[0] < 1.2, "it was not sent for much longer than 0.5 s"


def test_all_drones_land_without_poses() -> None:
    def drop(stream: PoseStream) -> None:
        stream.silent = True

    flight = figures(flown(drop, pose_lost_s=0.5)[0])
    assert flight.ended == "pose_lost" and "no position from outside for 0.5 s" in (flight.reason or "")
    assert set(flight.ends.values()) <= {"landed", "told to land, not confirmed"}


def test_swapped_markers_are_never_sent_and_named(tmp_path: Path) -> None:
    def swap(stream: PoseStream) -> None:
        stream.swapped = ("cf0", "cf2")

    result, taken, _ = flown(swap, noise_m=1e-6, out=str(tmp_path))
    flight = figures(result)
    assert flight.ended == "pose_lost" and flight.safe
    refused = flight.poses_refused or {}
    assert refused["cf0: swap"] > 5 and refused["cf2: swap"] > 5 and "cf1: swap" not in refused
    for told in taken:  # a swapped pose would be a jump by more than half a metre
        steps = [abs(b[1][0] - a[1][0]) + abs(b[1][1] - a[1][1]) for a, b in pairwise(told[1:])]
        assert max(steps) < 0.35
    events = [event for event in read_record(tmp_path / "run.mcap").flight if event.kind == "pose_refused"]
    assert {event.robot for event in events if event.detail["reason"] == "swap"} == {0, 2}


def test_port_in_use_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    async def unknown(*_: Any, **__: Any) -> Any:
        raise socket.gaierror(-2, "Name or service not known")

    async def run() -> None:
        first = UdpPoses("127.0.0.1", 0, ["a"])
        await first.open(lambda frame: None)
        second = UdpPoses("127.0.0.1", first.port, ["a"])
        with pytest.raises(InputError, match="pose_port"):
            await second.open(lambda frame: None)
        monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", unknown)
        with pytest.raises(InputError, match="pose_host"):
            await UdpPoses("203.0.113.9", 1, ["a"]).open(lambda frame: None)
        monkeypatch.undo()
        await first.close()
        await first.close()
        await second.open(lambda frame: None)
        await second.close()

    asyncio.run(run())


FAKE = """
import time, types
class Mocap:
    def waitForNextFrame(self): time.sleep(0.01)
    @property
    def rigidBodies(self):
        turn = types.SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        return {"cf0": types.SimpleNamespace(position=[1.0, 2.0, 3.0], rotation=turn)}
def connect(system, settings):
    if system == "vicon":
        time.sleep(3600)
    if settings != {"hostname": "there"}:
        raise RuntimeError("no server there")
    return Mocap()
"""


@pytest.fixture
def fake_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the package, here and in the process that imports it."""
    (tmp_path / "motioncapture.py").write_text(textwrap.dedent(FAKE))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


@pytest.mark.usefixtures("fake_library")
def test_poses_of_a_motion_capture_come_through_its_process() -> None:
    async def run() -> list[PoseFrame]:
        frames: list[PoseFrame] = []
        source = MocapPoses("optitrack", "there", NAMES)
        await source.open(frames.append)
        await wait_until(lambda: len(frames) > 3, 20.0, "frames come")
        process = source._process
        await source.close()
        assert process is not None and process.poll() is not None and not source.refused
        return frames

    frames = asyncio.run(run())
    assert frames[0].poses == {"cf0": Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))}
    assert frames[1].stamp_s > frames[0].stamp_s


@pytest.mark.usefixtures("fake_library")
def test_missing_motion_capture_is_reported(capfd: pytest.CaptureFixture[str]) -> None:
    async def run() -> None:
        source = MocapPoses("optitrack", "nowhere", NAMES)
        await source.open(lambda frame: None)
        await wait_until(lambda: source.refused == {"mocap_ended": 1}, 20.0, "the process ends")
        await source.close()

    asyncio.run(run())
    assert capfd.readouterr().err == "motion capture: no server there\n"


@pytest.mark.usefixtures("fake_library")
def test_a_motion_capture_that_never_answers_holds_nothing_up() -> None:
    async def run() -> None:
        source = MocapPoses("vicon", "there", NAMES)
        await source.open(lambda frame: None)
        began = time.monotonic()
        await source.close()
        assert time.monotonic() - began < 8.0

    asyncio.run(run())


def test_without_the_package_a_line_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "motioncapture", None)
    with pytest.raises(InputError, match=r"llm-flock\[mocap\]"):
        asyncio.run(MocapPoses("vicon", "there", NAMES).open(lambda frame: None))
