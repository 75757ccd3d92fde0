"""Teams in ROS 2 through a real zenoh router, beside an independent client of rmw_zenoh; no ROS runs here."""

from __future__ import annotations

import asyncio
import importlib
import itertools
import json
import math
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from command_line import ENV
from ros2_messages import SAMPLES, definition, points, same
from zenoh_router import listener, router

from llm_flock.errors import MessageError
from llm_flock.robots._base import PoseFrame
from llm_flock.runtime._ros2_config import Ros2Config
from llm_flock_swarm._network.swarm import free_port
from llm_flock_swarm._ros2 import drawing
from llm_flock_swarm._ros2.flight import RosPoses
from llm_flock_swarm._ros2.graph import Graph
from llm_flock_swarm._ros2.types import (
    CLOCK,
    DIAGNOSTICS,
    POINTS,
    POSE,
    TEXT,
    from_cdr,
    message_class,
    to_cdr,
    type_hash,
)
from llm_flock_swarm._ros2.wire import Attachment, topic_key
from llm_flock_swarm._trust.keys import make_keys

SDK: Any = importlib.import_module("zenoh_ros2_sdk")
DISCOVERY: Any = importlib.import_module("zenoh_ros2_sdk.discovery")
PATIENCE_S = 90.0


async def until(condition: Callable[[], object], what: str, longest_s: float = PATIENCE_S) -> None:
    end = time.monotonic() + longest_s
    while not condition():
        assert time.monotonic() < end, f"waited too long for {what}"
        await asyncio.sleep(0.05)


class Ros:
    """An independent client, a peer of the router as the nodes of ROS 2 are."""

    def __init__(self, endpoint: str) -> None:
        self._port = int(endpoint.rpartition(":")[2])
        self._made: list[Any] = []
        self.heard: dict[str, list[Any]] = {}

    def _options(self, topic: str, kind: str) -> dict[str, Any]:
        definitions = {"msg_definition": definition(kind), "type_hash": type_hash(kind)}
        return {"topic": topic, "msg_type": kind, "domain_id": 0, "router_port": self._port, **definitions}

    def publish(self, topic: str, kind: str) -> Any:
        self._made.append(SDK.ROS2Publisher(**self._options(topic, kind)))
        return self._made[-1]

    def subscribe(self, topic: str, kind: str) -> list[Any]:
        heard = self.heard[topic] = []
        self._made.append(SDK.ROS2Subscriber(callback=heard.append, **self._options(topic, kind)))
        return heard

    def close(self) -> None:
        for made in self._made:
            made.close()
        SDK.ZenohSession.get_instance().close()


@contextmanager
def network() -> Generator[tuple[str, Ros]]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with router(endpoint), closing(Ros(endpoint)) as ros:
        yield endpoint, ros


@contextmanager
def command(*arguments: str, cwd: Path) -> Generator[subprocess.Popen[str]]:
    """A command of llm-flock that runs meanwhile."""
    process = subprocess.Popen(
        [sys.executable, "-m", "llm_flock", *arguments],
        cwd=cwd,
        env=ENV,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


@pytest.mark.parametrize("kind", sorted(SAMPLES))
def test_messages_pass_both_ways_with_the_bytes_of_the_oracle(kind: str) -> None:
    async def whole(endpoint: str, ros: Ros, session: Any) -> None:
        samples: list[Any] = []
        keep = session.declare_subscriber("0/**", samples.append)
        came: list[tuple[str, Any, Attachment]] = []
        refused: list[MessageError] = []
        with closing(Graph(endpoint, 0)) as graph:
            node = graph.node("/flock", "team")
            ours = node.publisher("/flock/out", kind)
            graph.subscribe("/flock/in", kind, lambda *got: came.append(got), lambda _, e: refused.append(e), rate=99)
            node.listens("/flock/in", kind)
            heard, theirs = ros.subscribe("/flock/out", kind), ros.publish("/flock/in", kind)
            fields = [f for f in SAMPLES[kind].__dataclass_fields__ if f.islower() and f[0] != "_"]
            while not (heard and came):
                ours.publish(SAMPLES[kind])
                theirs.publish(**{field: getattr(SAMPLES[kind], field) for field in fields})
                await asyncio.sleep(0.1)
            assert same(SAMPLES[kind], heard[0]) and same(SAMPLES[kind], came[0][1])
            assert came[0][0] == "/flock/in" and refused == []
            of_ours, of_theirs = (
                [sample for sample in samples if f"/flock/{way}/" in str(sample.key_expr)] for way in ("out", "in")
            )
            assert str(of_ours[0].key_expr).replace("out", "in", 1) == str(of_theirs[0].key_expr)
            assert of_ours[0].payload.to_bytes() == of_theirs[0].payload.to_bytes()
            mine, other = (Attachment.decode(some[0].attachment.to_bytes()) for some in (of_ours, of_theirs))
            assert abs(mine.stamp_ns - other.stamp_ns) < 5e9 and mine.sequence == 1
            listed = dict(DISCOVERY.get_topic_names_and_types(0, "127.0.0.1", int(endpoint.rpartition(":")[2])))
            assert listed["/flock/out"] == listed["/flock/in"] == [kind]
            info = DISCOVERY.get_topic_info("/flock/out", 0, verbose=True)
            assert [(p.node_namespace, p.node_name) for p in info.publishers] == [("/flock", "team")]
        keep.undeclare()

    with network() as (endpoint, ros), listener(endpoint) as session:
        asyncio.run(asyncio.wait_for(whole(endpoint, ros, session), PATIENCE_S))


def test_poses_of_drones_come_through_the_router() -> None:
    async def whole(endpoint: str, ros: Ros) -> None:
        frames: list[PoseFrame] = []
        source = RosPoses(Ros2Config(router=endpoint, ros_pose_topic="/mocap/cf_{id}/pose"), "flock", ["cf1", "cf2"])
        await source.open(frames.append)
        theirs = ros.publish("/mocap/cf_1/pose", POSE)
        sample = drawing.pose((0.5, -1.0, 0.9), time.time_ns(), "world")
        while not frames:
            theirs.publish(header=sample.header, pose=sample.pose)
            await asyncio.sleep(0.1)
        assert set(frames[0].poses) == {"cf2"} and frames[0].poses["cf2"].position == (0.5, -1.0, 0.9)
        assert abs(frames[0].stamp_s - time.time()) < 5.0 and not source.refused
        await source.close()
        await source.close()

    with network() as (endpoint, ros):
        asyncio.run(asyncio.wait_for(whole(endpoint, ros), PATIENCE_S))


def diagnosed(heard: list[Any]) -> dict[str, str]:
    """What the last diagnostics say of what came in."""
    found = [s for message in heard[-1:] for s in message.status if s.name.endswith(": from ROS")]
    return {pair.key: pair.value for status in found for pair in status.values}


def test_ros_gets_a_swarm_that_survives_its_router(tmp_path: Path) -> None:
    endpoint, own = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    with ExitStack() as stack:
        first = stack.enter_context(router(endpoint))
        world = ["--robots", "3", "--start", "connected", "--model", "simulated:brisk", "--connect", own]
        stack.enter_context(command("world", *world, cwd=tmp_path))
        time.sleep(2.0)
        for robot in range(3):
            stack.enter_context(command("robot", "--id", str(robot), *world, cwd=tmp_path))
        shown = ["ros2", *world, "--ros2", endpoint, "--ros-missions", "--use-sim-time", "-q"]
        stack.enter_context(command(*shown, cwd=tmp_path))
        ros = Ros(endpoint)

        def state() -> dict[str, Any]:
            heard = ros.heard["/flock/state"]
            return json.loads(heard[-1].data) if heard else {}

        async def whole() -> None:
            poses, clock = (
                ros.subscribe("/flock/robot_1/pose", POSE),
                ros.subscribe("/clock", CLOCK),
            )
            said, _ = ros.subscribe("/diagnostics", DIAGNOSTICS), ros.subscribe("/flock/state", TEXT)
            await until(lambda: state().get("formed") and clock, "a formation")
            assert poses[-1].header.frame_id == "world" and poses[-1].header.stamp.sec < 1000
            mission, places = ros.publish("/flock/mission", TEXT), ros.publish("/flock/places", POINTS)
            await asyncio.sleep(1.0)
            mission.publish(data='[mission]\nshape = "line"')
            await until(lambda: state()["mission"]["shape"] == "line", "the mission")
            for wrong in ("shape = 1", '{"safe_distance": 0.1}', "{", '{"center": [NaN, 1]}'):
                await asyncio.sleep(1.5)
                mission.publish(data=wrong)
            wrong_places = points((1.0, math.nan, 0.0)), points((1.0, 1.0, 0.0), frame="map")
            for message in (*wrong_places, points((45.0, 45.0, 0.0), (55.0, 45.0, 0.0), (50.0, 55.0, 0.0))):
                await asyncio.sleep(1.5)
                places.publish(header=message.header, poses=message.poses)
            await until(lambda: state()["mission"]["shape"] == "points", "the places")
            assert state()["mission"]["center"] == pytest.approx([50.0, 145 / 3])
            wanted = {"refused bad_mission": "4", "refused not_finite": "1", "refused wrong_frame": "1"}
            await until(lambda: wanted.items() <= diagnosed(said).items(), f"diagnostics {wanted}")
            first.kill()
            first.wait()
            await asyncio.sleep(1.0)
            stack.enter_context(router(endpoint))
            count = len(poses)
            await until(lambda: len(poses) > count + 5, "poses after the router came back")
            listed = dict(DISCOVERY.get_topic_names_and_types(0))
            assert listed["/flock/robot_2/path"] == ["nav_msgs/msg/Path"]

        try:
            asyncio.run(whole())
        finally:
            ros.close()


def test_swarm_flies_by_ros_poses_and_stands_still_without(tmp_path: Path) -> None:
    own = f"tcp/127.0.0.1:{free_port()}"
    team = ["--robots", "2", "--shape", "line", "--model", "simulated:ideal", "--connect", own]
    with network() as (endpoint, _), ExitStack() as stack:
        stack.enter_context(command("ros2", *team, "--ros2", endpoint, "--ros-poses", "--unit-m", "0.1", cwd=tmp_path))
        for robot in range(2):
            stack.enter_context(command("robot", "--id", str(robot), *team, cwd=tmp_path))

        async def whole() -> None:
            """A simulator: bodies that follow their set-points at once, and tell where they are."""
            bodies = [(4.0, 4.0, 0.3), (5.0, 4.0, 0.3)]
            last: dict[str, Any] = {}
            seen = Counter[str]()

            def take(topic: str, message: Any, _attached: Attachment) -> None:
                last[topic] = message
                seen[topic] += 1

            def refuse(topic: str, error: MessageError) -> None:
                raise AssertionError(f"{topic}: {error}")

            def set_points(_topic: str, message: Any, _attached: Attachment) -> None:
                robot = int(_topic.split("/")[2].removeprefix("robot_"))
                at = message.pose.position
                bodies[robot] = (at.x, at.y, 0.3)

            with closing(Graph(endpoint, 0)) as graph:
                node = graph.node("/", "simulator")
                out = [node.publisher(f"/flock/robot_{j}/sensed_pose", POSE) for j in range(3)]
                graph.subscribe("/flock/robot_$*/set_point", POSE, set_points, refuse, rate=1000)
                for name, kind in (("/flock/state", TEXT), ("/diagnostics", DIAGNOSTICS)):
                    graph.subscribe(name, kind, take, refuse, rate=1000)

                async def simulate(blind: int | None = None) -> None:
                    while True:
                        for robot, body in enumerate(bodies):
                            if robot != blind:
                                out[robot].publish(drawing.pose(body, 0, "world"))
                        await asyncio.sleep(0.01)

                start, blind = list(bodies), asyncio.create_task(simulate())
                await until(lambda: bodies[0] != start[0] or bodies[1] != start[1], "a set-point")
                blind.cancel()
                blind = asyncio.create_task(simulate(blind=1))
                await asyncio.sleep(0.8)
                stood = list(bodies)
                await asyncio.sleep(1.5)
                assert bodies == stood, "robots fly on although one of them is not seen"
                blind.cancel()
                task = asyncio.create_task(simulate())
                await until(lambda: seen["/flock/state"] and json.loads(last["/flock/state"].data)["formed"], "a line")
                assert math.dist(bodies[0], bodies[1]) == pytest.approx(1.0, abs=0.06)
                out[2].publish(drawing.pose((0.0, 0.0, 0.0), 0, "world"))
                out[0].publish(drawing.pose((0.0, 0.0, 0.0), 0, "map"))
                await until(lambda: "refused unknown_robot" in diagnosed([last["/diagnostics"]]), "an unknown robot")
                assert diagnosed([last["/diagnostics"]])["refused wrong_frame"] == "1"
                task.cancel()
                blind = asyncio.create_task(simulate(blind=1))
                await until(
                    lambda: any("no fresh pose of 1" in s.message for s in last["/diagnostics"].status), "a lost pose"
                )
                blind.cancel()

        asyncio.run(whole())


def test_missions_to_a_swarm_with_keys_are_signed_by_operators(tmp_path: Path) -> None:
    make_keys(tmp_path / "team", 2)
    team = [
        "--robots",
        "2",
        "--keys",
        "team",
        "--model",
        "simulated:ideal",
        "--connect",
        f"tcp/127.0.0.1:{free_port()}",
    ]
    with network() as (endpoint, ros), ExitStack() as stack:
        stack.enter_context(command("world", *team, cwd=tmp_path))
        for robot in range(2):
            stack.enter_context(command("robot", "--id", str(robot), *team, cwd=tmp_path))
        shown = ["ros2", *team, "--ros2", endpoint, "--ros-missions", "-q"]
        stack.enter_context(command(*shown, cwd=tmp_path))

        async def whole() -> None:
            heard, mission = ros.subscribe("/flock/state", TEXT), ros.publish("/flock/mission", TEXT)
            ordered: list[int] = []

            def taken() -> bool:
                if len(heard) > 8 * len(ordered) + 4:  # the first may come before the robots
                    mission.publish(data='{"center": [40, 60]}')
                    ordered.append(1)
                return bool(heard) and json.loads(heard[-1].data)["mission"]["center"] == [40.0, 60.0]

            await until(taken, "a signed mission")

        asyncio.run(whole())
        without = tmp_path / "elsewhere"
        without.mkdir()
        (tmp_path / "team" / "operator").rename(without / "operator")
        done = subprocess.run(
            [sys.executable, "-m", "llm_flock", *shown, "--ros-namespace", "another"],
            cwd=tmp_path,
            env=ENV,
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert done.returncode == 2 and "operator" in done.stderr


@pytest.mark.parametrize("flags", [["ros2", "--ros-poses"], ["watch"]])
def test_a_second_bridge_of_one_name_is_refused(flags: list[str], tmp_path: Path) -> None:
    async def whole(endpoint: str) -> None:
        words = [*flags, "--robots", "2", "--connect", f"tcp/127.0.0.1:{free_port()}", "--ros2", endpoint, "-q"]
        with closing(Graph(endpoint, 0)) as graph:
            graph.node("/flock", "team")
            done = await asyncio.to_thread(
                subprocess.run,
                [sys.executable, "-m", "llm_flock", *words],
                cwd=tmp_path,
                env=ENV,
                capture_output=True,
                text=True,
                timeout=60,
            )
            assert done.returncode == 2, done.stderr
            assert "--ros-namespace flock: another bridge shows a team by this name there" in done.stderr
            with closing(Graph(endpoint, 0)) as other:
                other.check_free("/flock_2", "team")
        with closing(Graph(endpoint, 0)) as after:
            after.check_free("/flock", "team")

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with router(endpoint):
        asyncio.run(whole(endpoint))


@pytest.mark.parametrize("flags", [["ros2", "--ros-poses"], ["watch"]])
def test_a_bridge_that_has_seen_nothing_ends_cleanly(flags: list[str], tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with router(endpoint), listener(endpoint) as session:
        here: list[str] = []
        keep = session.liveliness().declare_subscriber("@ros2_lv/**", lambda sample: here.append(str(sample.key_expr)))
        words = [*flags, "--robots", "2", "--connect", f"tcp/127.0.0.1:{free_port()}", "--ros2", endpoint, "-q"]
        process = subprocess.Popen(
            [sys.executable, "-m", "llm_flock", *words], cwd=tmp_path, env=ENV, stderr=subprocess.PIPE, text=True
        )
        asyncio.run(until(lambda: sum("/MP/" in token for token in here) >= 8, "the publishers"))
        time.sleep(1.0)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=20)
        keep.undeclare()
    assert (process.returncode, errors) == (0, "")


def hostile_bytes(kind: str) -> list[bytes]:
    """Messages of a type that are cut, changed, endless, far too large, or of another type."""
    good, rng = to_cdr(SAMPLES[kind], kind), random.Random(7)
    changed = [bytes(byte if rng.random() > 0.1 else rng.randrange(256) for byte in good) for _ in range(60)]
    others = [to_cdr(sample, name) for name, sample in SAMPLES.items() if name != kind]
    return [b"", good[:6], good[:-3], good[:4] + b"\xff" * 64, bytes(2 << 20), rng.randbytes(999), *changed, *others]


ORDERS = (
    "shape = " * 9000,
    '{"points": [[NaN, 1], [2, Infinity]], "center": [1e308, 1e308]}',
    '{"n_robots": 9}',
    '{"shape": "points:/etc/passwd"}',
    '{"shape": "text:' + "\u3164" * 8000 + '"}',
    '{"arena": [[0, 0], [0, 0]]}',
    "[" * 50_000,
    '{"center": [1, 2, 3, 4, 5]}',
    '{"spacing": 1e-300, "obstacles": [{"center": [50, 50], "radius": 1e9}]}',
)


@pytest.mark.parametrize("takes", [True, False])
def test_hostile_orders_from_ros_change_and_end_nothing(takes: bool, tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    team = ["--robots", "2", "--shape", "line", "--start", "connected", "--model", "simulated:ideal", "--max-s", "20"]
    flags = [*team, "--connect", "", "--ros2", endpoint, *["--ros-missions"] * takes, "--no-record", "--json"]
    with router(endpoint), listener(endpoint) as session:
        process = subprocess.Popen(
            [sys.executable, "-m", "llm_flock", "swarm", *flags],
            cwd=tmp_path,
            env=ENV,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        said: list[Any] = []
        key = topic_key(0, "/diagnostics", DIAGNOSTICS, type_hash(DIAGNOSTICS))
        keep = session.declare_subscriber(key, lambda one: said.append(from_cdr(one.payload.to_bytes(), DIAGNOSTICS)))
        turns = itertools.cycle([to_cdr(message_class(TEXT)(data=order), TEXT) for order in ORDERS])
        sent = 0
        while process.poll() is None:
            for topic, kind in (("/flock/mission", TEXT), ("/flock/places", POINTS)):
                where = topic_key(0, topic, kind, type_hash(kind))
                for data in (*hostile_bytes(kind), *([next(turns)] if kind == TEXT else [])):
                    sent += 1
                    attached = Attachment(sent, time.time_ns(), bytes(16)).encode() if sent % 5 else b"\xff"
                    session.put(where, data, attachment=attached)
            time.sleep(0.1)
        output, errors = process.communicate()
        keep.undeclare()
    result = json.loads(output)
    assert (process.returncode, result["stopped"]) == (0, "time" if takes else "formed"), errors
    assert result["formed"] and result["n_robots"] == 2 and result["ended"] == {} and "Traceback" not in errors
    refused = diagnosed(said)
    assert ({"refused too_many", "refused bad_cdr"} <= refused.keys()) == takes, refused
