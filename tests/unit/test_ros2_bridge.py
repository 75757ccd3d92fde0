"""What comes in from ROS 2, how a team is named there, and what a flight shows; without a network."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command_line import flock
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from ros2_messages import SAMPLES, points, same

from llm_flock.errors import InputError, MessageError
from llm_flock.mission import Mission
from llm_flock.record._schema import BodySample, FlightEvent, MissionInfo
from llm_flock.runtime._journal import mission_info
from llm_flock.runtime._ros2_config import Ros2Config
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_swarm._network.wire import Command
from llm_flock_swarm._ros2 import drawing
from llm_flock_swarm._ros2.bridge import Stamps
from llm_flock_swarm._ros2.flight import FlightShow
from llm_flock_swarm._ros2.nodes import Refused
from llm_flock_swarm._ros2.orders import ORDERED, MissionGiver, mission_fields, places_fields
from llm_flock_swarm._ros2.sensors import FRESH_S, LATE_S, LOST_S, SensedBodies
from llm_flock_swarm._ros2.types import DIAGNOSTICS, MARKERS, NS, PATH, POSE, from_cdr, to_cdr, type_store
from llm_flock_swarm._ros2.wire import Attachment

NAN = math.nan


def refusal(call: Any, *arguments: Any) -> str:
    with pytest.raises(MessageError) as found:
        call(*arguments)
    return found.value.reason


@pytest.mark.parametrize(
    "text", ['{"shape": "line"}', 'shape = "line"', '[mission]\nshape = "line"', ' {"mission": {"shape": "line"}}']
)
def test_missions_are_read_from_json_and_toml(text: str) -> None:
    assert mission_fields(text) == {"shape": "line"}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "line",
        "{}",
        "[]",
        "{",
        '{"mission": 3}',
        '{"safe_distance": 0.1}',
        '{"velocity": [1, 1]}',
        '{"shape": "line", "n_robots": 3}',
        "x = " + "[" * 5000,
        "{" * 3 + '"a":' * 3,
        '{"a":' * 60000 + "1" + "}" * 60000,
        " " * 70000,
        "n = " + "1" * 5000,
    ],
)
def test_other_texts_are_bad_missions(text: str) -> None:
    assert refusal(mission_fields, text) == "bad_mission"


@given(st.text(max_size=60))
def test_any_text_is_a_mission_or_refused(text: str) -> None:
    try:
        fields = mission_fields(text)
    except MessageError:
        return
    assert fields.keys() <= ORDERED


def test_places_become_points_in_units_around_their_mean() -> None:
    fields = places_fields(points((1.0, 2.0, 9.0), (3.0, 2.0, 9.0), frame="/world"), "world", 0.5, 2)
    assert fields == {"points": [[2.0, 4.0], [6.0, 4.0]], "center": [4.0, 4.0]}
    assert places_fields(points((1.0, 2.0, 3.0), frame=""), "world", 1.0, 3)["points"] == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("rows", "frame", "reason"),
    [
        ([(0.0, 0.0, 0.0)], "map", "wrong_frame"),
        ([(0.0, NAN, 0.0)], "world", "not_finite"),
        ([(0.0, 0.0, math.inf)], "world", "not_finite"),
        ([(0.0, 2e6, 0.0)], "world", "out_of_range"),
    ],
)
def test_places_that_cannot_be_are_refused(rows: list[Any], frame: str, reason: str) -> None:
    assert refusal(places_fields, points(*rows, frame=frame), "world", 1.0, 2) == reason


@pytest.mark.parametrize("count", [0, 2001])
def test_no_mission_has_any_number_of_places(count: int) -> None:
    giver = MissionGiver.__new__(MissionGiver)
    giver._observer = SimpleNamespace(mission=Mission(n_robots=5))  # type: ignore[assignment]
    rows = [(float(k), 0.0, 0.0) for k in range(count)]
    assert refusal(giver.give, places_fields(points(*rows, frame="world"), "world", 1.0, 2)) == "bad_mission"


class Sensors:
    """Bodies by a clock that the test sets: two robots that fly one unit in a control period."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.bodies = SensedBodies(2, speed=7.0, reach=1.0, lag_s=0.05, clock=lambda: self.now)
        self._sequence = 0

    def sense(self, robot: int, x: float, *, source: int = 0, age_s: float = 0.0, sequence: int | None = None) -> None:
        self._sequence += 1
        number = self._sequence if sequence is None else sequence
        stamp_ns = round((self.now - age_s) * 1e9)
        self.bodies.sense(robot, (x, 10.0 * robot), Attachment(number, stamp_ns, bytes([source] * 16)))

    def command(self, number: int, origin: float, target: float, *, age_s: float = 0.0) -> bool:
        order = Command(number=number, stamp=self.now - age_s, origin=(origin, 0.0), target=(target, 0.0))
        return self.bodies.command(0, order)


def test_with_a_downwash_the_safe_distance_is_drawn_tall() -> None:
    scales = {one.ns: one.scale for one in SAMPLES[drawing.MARKERS].markers}
    assert (scales["safe_distance"].x, scales["safe_distance"].z) == (3.0, 6.0)
    assert scales["robots"].x == scales["robots"].z == 1.5


def test_reading_is_as_old_as_its_oldest_pose_and_needs_all() -> None:
    sensors = Sensors()
    sensors.sense(0, 1.0, age_s=0.1)
    assert sensors.bodies.reading() is None and sensors.bodies.missing == [1]
    sensors.sense(1, 2.0)
    reading = sensors.bodies.reading()
    assert reading is not None and reading.stamp == pytest.approx(sensors.now - 0.1)
    assert [body.position for body in reading.bodies] == [(1.0, 0.0), (2.0, 10.0)]
    sensors.now += FRESH_S - 0.05
    assert sensors.bodies.missing == [0] and sensors.bodies.reading() is None


def test_late_old_strange_or_doubly_sourced_poses_are_refused() -> None:
    sensors = Sensors()
    sensors.sense(0, 1.0, sequence=5)
    assert refusal(sensors.sense, 2, 0.0) == refusal(sensors.sense, -1, 0.0) == "unknown_robot"
    with pytest.raises(MessageError, match="late"):
        sensors.sense(0, 1.0, age_s=LATE_S + 0.1)
    for old in (4, 5):
        with pytest.raises(MessageError, match="out_of_order"):
            sensors.sense(0, 1.0, sequence=old)
    with pytest.raises(MessageError, match="second_source"):
        sensors.sense(0, 7.0, source=1)
    sensors.now += LOST_S
    sensors.sense(0, 7.0, source=1, sequence=1)
    with pytest.raises(MessageError, match="second_source"):
        sensors.sense(0, 1.0, sequence=6)
    sensors.sense(0, 7.0, source=1, sequence=2**62)  # a number that others chose keeps a source away for so long only
    with pytest.raises(MessageError, match="out_of_order"):
        sensors.sense(0, 7.0, source=1, sequence=2)
    sensors.now += LOST_S
    sensors.sense(0, 7.0, source=1, sequence=3)


def test_a_jump_is_refused_unless_it_lasts() -> None:
    sensors = Sensors()
    sensors.sense(0, 0.0)
    sensors.now += 0.1
    with pytest.raises(MessageError, match="jump"):
        sensors.sense(0, 50.0)
    sensors.sense(0, 0.5)  # the glitch is over
    for _ in range(round(LOST_S / 0.1) - 1):
        sensors.now += 0.1
        with pytest.raises(MessageError, match="jump"):
            sensors.sense(0, 50.0)
    assert 0 in sensors.bodies.missing and sensors.bodies.set_point(0) == (0.0, 0.0)
    for _ in range(3):
        sensors.now += 0.1
        sensors.sense(0, 50.0)
    assert sensors.bodies.set_point(0) == (50.0, 0.0) and 0 not in sensors.bodies.missing


def test_a_pose_from_the_future_is_of_now() -> None:
    sensors = Sensors()
    for robot in range(2):
        sensors.sense(robot, 1.0, age_s=-100.0)
    reading = sensors.bodies.reading()
    assert reading is not None and reading.stamp == sensors.now


def test_command_counts_once_in_time_within_reach_of_the_stop() -> None:
    sensors = Sensors()
    assert not sensors.command(1, 0.0, 1.0)  # no pose yet
    sensors.sense(0, 0.0)
    assert sensors.command(1, 0.0, 1.0) and sensors.bodies.set_point(0) == (1.0, 0.0)
    assert not sensors.command(1, 1.0, 2.0)
    assert not sensors.command(2, 0.0, 1.0)
    assert not sensors.command(3, 1.0, 2.0, age_s=0.06) and sensors.bodies.late == 1
    assert not sensors.command(4, 1.0, NAN)
    assert not sensors.command(5, 1.0, 2.5)
    assert sensors.command(6, 1.0, 2.0)
    assert not sensors.command(7, 2.0, 3.0)  # the body is two periods behind
    sensors.now += 0.04
    sensors.sense(0, 1.5)
    assert sensors.command(8, 2.0, 3.0)


def test_a_body_that_does_not_follow_stays_where_it_is() -> None:
    sensors = Sensors()
    sensors.sense(0, 0.0)
    for number, x in enumerate((0.0, 1.0, 2.0), start=1):
        sensors.command(number, x, x + 1.0)
    ends: set[Any] = set()
    for _ in range(30):
        sensors.now += 0.1
        sensors.sense(0, 0.0)
        ends.add(sensors.bodies.set_point(0))
    assert sensors.bodies.set_point(0) == (0.0, 0.0) and len(ends) == 2


def test_any_name_of_a_swarm_becomes_a_legal_ros_name() -> None:
    assert [Ros2Config().namespace(name) for name in ("flock", "lab-2", "7")] == ["/flock", "/lab_2", "/_7"]
    assert Ros2Config(ros_namespace="a/b").pose_topic("x") == "/a/b/robot_{id}/sensed_pose"
    assert Ros2Config(ros_pose_topic="mocap/r{id}/pose").pose_topic("x") == "/mocap/r{id}/pose"
    for wrong in ("a//b", "/a", "a/", "9", "a-b", "ä", "*"):
        with pytest.raises(ValidationError, match="ros_namespace"):
            Ros2Config(ros_namespace=wrong)
    for wrong in ("/pose", "/{id}/{id}", "/r{id}/*", "/r{id}//x", "/{id}"):
        with pytest.raises(InputError, match=r"expected a ROS topic with \{id\} once"):
            Ros2Config(ros_pose_topic=wrong)


def test_stamps_are_of_wall_clock_simulation_or_clock_topic() -> None:
    assert Stamps(sim=False, follow=False).of(2.5) == 2_500_000_000
    simulated, following = Stamps(sim=True, follow=False), Stamps(sim=True, follow=True)
    assert [simulated.of(at) for at in (100.0, 100.5, 99.0)] == [0, 500_000_000, 0]
    assert following.of(100.0) == 0
    following.follow(-1)
    following.follow(7)
    assert following.of(100.0) == 7
    following.follow((2**31 - 1) * NS + 2**32 - 1)  # a clock whose nanoseconds are more than a second ended the bridge
    assert len(drawing.PoseEncoder("map").encode((0.0, 0.0, 0.0), following.of(100.0))) > 0


def test_refused_input_is_a_warning_once_and_counted_for_good() -> None:
    refused = Refused()
    refused.take("/flock/mission", MessageError("bad_mission", "evil \x1b[2J\ntext"))
    assert refused.finding("x")[1] == drawing.WARN
    name, level, _, values = refused.finding("x")
    assert (name, level) == ("x", drawing.OK) and values["refused bad_mission"] == 1
    assert "\x1b" not in str(values["last bad_mission"]) and "\n" not in str(values["last bad_mission"])


class FakeGraph:
    """Keeps what is published, by topic; it is its own nodes and publishers' maker."""

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {}
        self.broken = False

    def node(self, _namespace: str, _name: str) -> FakeGraph:
        return self

    def publisher(self, topic: str, _type: str, *, express: bool = False) -> Any:
        graph, sent = self, self.sent.setdefault(topic, [])

        class Publisher:
            def publish(self, message: object) -> None:
                if graph.broken:
                    raise OSError("the network is gone")
                sent.append(message)

            def send(self, data: bytes) -> None:
                self.publish(from_cdr(data, POSE))

        return Publisher()


def flight_config(**ros: Any) -> FlightConfig:
    mission = {"shape": "line", "n_robots": 2, "arena": ((0, 0), (20, 20)), "center": (10, 10)}
    return FlightConfig.model_validate({"mission": mission, "ros2": ros})


def sample(time_s: float = 1.0) -> BodySample:
    rows = [[0.5, 0.0, 1.0], [-0.5, 0.0, 1.0]]
    known: dict[str, Any] = {"measured": rows, "commanded": rows, "flying": [True] * 2}
    return BodySample(round=0, time_s=time_s, **known, battery_v=[4.0, 3.0], link=[1.0, 0.0])


def mission_of(config: FlightConfig) -> MissionInfo:
    return mission_info(config.mission, 0, 0)


def test_flight_shows_its_drones_and_no_fault_there_returns() -> None:
    config, graph = flight_config(router="tcp/127.0.0.1:1"), FakeGraph()
    show = FlightShow(graph, config.ros2, ["cf1", "cf2"], config.frame, 3.2)  # type: ignore[arg-type]
    show.write(mission_of(config))
    show.write(FlightEvent(round=0, time_s=0.0, kind="take_off", robot=None, detail={}))
    show.write(sample())
    (pose,) = graph.sent["/flock/robot_1/pose"]
    assert (pose.pose.position.x, pose.pose.position.z) == (-0.5, 1.0)
    graph.broken = True
    show.write(sample(2.0))
    assert show.faults.counts["fault"] <= 1
    with pytest.raises(InputError, match="ros_missions"):
        flight_config(ros_missions=True)


@given(st.tuples(*[st.floats(-1e9, 1e9)] * 3), st.integers(-1, 2**31 * 10**9 - 1), st.text("abc_", max_size=9))
def test_poses_are_encoded_as_any_message_is(at: tuple[float, float, float], stamp_ns: int, frame: str) -> None:
    assert drawing.PoseEncoder(frame).encode(at, stamp_ns) == to_cdr(drawing.pose(at, stamp_ns, frame), POSE)


def test_drawings_of_all_types_have_content() -> None:
    assert all(marker.points or marker.text for marker in SAMPLES[MARKERS].markers)
    assert [at.pose.position.x for at in SAMPLES[PATH].poses] == [1.5, 2.0, 3.0]
    assert SAMPLES[DIAGNOSTICS].status[0].values[0].value == "1"
    assert not same(SAMPLES[POSE], drawing.pose((0.0, 0.0, 0.0), 0, "world"))


def test_without_the_extra_a_line_names_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    type_store.cache_clear()
    try:
        done = flock("ros2", "--connect", "tcp/127.0.0.1:1", cwd=tmp_path, check=False)
    finally:
        type_store.cache_clear()
    assert done.returncode == 2 and "pip install 'llm-flock[ros2]'" in done.stderr


def test_the_swarm_s_own_endpoint_is_not_the_router_s(tmp_path: Path) -> None:
    elsewhere = "tcp/127.0.0.1:7448"
    for flags in ([], ["--ros2", "tcp/localhost:7447"], ["--connect", elsewhere, "--ros2", elsewhere]):
        done = flock("ros2", *flags, cwd=tmp_path, check=False)
        assert done.returncode == 2 and done.stderr.startswith("error: --connect ")
