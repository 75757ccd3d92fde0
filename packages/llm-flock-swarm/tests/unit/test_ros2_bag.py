"""Bags made of records, as an independent reader sees them."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap_ros2")
from command_line import flock
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from sample_records import make_record, run_info

from llm_flock.errors import InputError, RecordError
from llm_flock.record._reader import read_record
from llm_flock.runtime._ros2_config import Ros2Config
from llm_flock_swarm._ros2.bag import write_bag
from llm_flock_swarm._ros2.types import USED


def read_bag(folder: Path) -> list[tuple[str, str, int, Any]]:
    """Topic, type, time and content of each message, by mcap-ros2-support."""
    with next(folder.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        return [
            (channel.topic, schema.name, message.log_time, content)
            for schema, channel, message, content in reader.iter_decoded_messages()
            if schema is not None
        ]


def test_a_record_becomes_a_bag_that_another_reader_reads(tmp_path: Path) -> None:
    record = make_record(tmp_path / "run.mcap", n=4, rounds=5)
    done = flock("export", "--ros2bag", str(tmp_path), "--unit-m", "0.5", cwd=tmp_path)
    assert done.stdout.strip() == str(tmp_path / "bag")
    found, run = read_bag(tmp_path / "bag"), read_record(record)
    rounds = len(run.states)
    counts = Counter(topic for topic, *_ in found)
    assert counts["/flock/robot_3/pose"] == counts["/flock/robot_0/path"] == counts["/tf"] == rounds
    assert counts["/flock/markers"] == counts["/flock/state"] == counts["/diagnostics"] == rounds
    assert counts["/flock/events"] == len(run.events)
    assert {kind for _, kind, _, _ in found} <= set(USED)
    poses = [(stamp, content) for topic, _, stamp, content in found if topic == "/flock/robot_2/pose"]
    for state, (stamp, content) in zip(run.states, poses, strict=True):
        at = content.pose.position
        assert [at.x, at.y, at.z] == pytest.approx([0.5 * x for x in state.positions[2]] + [0.0])
        assert stamp == content.header.stamp.sec * 10**9 + content.header.stamp.nanosec
        assert content.header.frame_id == "world" and content.pose.orientation.w == 1.0
    assert poses[1][0] - poses[0][0] == 10**9 and poses[0][0] == 1893456000 * 10**9
    last = json.loads([content.data for topic, _, _, content in found if topic == "/flock/state"][-1])
    assert [robot["plan"] for robot in last["robots"]] == run.states[-1].plan_ids
    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == len(found) and {c.topic for c in bag.connections} == set(counts)


def test_bag_markers_show_plan_goals_links_and_safe_distances(tmp_path: Path) -> None:
    make_record(tmp_path / "run.mcap", n=4, rounds=5)
    write_bag(tmp_path / "run.mcap", tmp_path / "bag")
    markers = [content.markers for topic, *_, content in read_bag(tmp_path / "bag") if topic == "/flock/markers"][-1]
    by_name = {marker.ns: marker for marker in markers}
    assert set(by_name) == {"robots", "safe_distance", "goals", "places", "links", "ids"}
    run = read_record(tmp_path / "run.mcap")
    assert by_name["safe_distance"].scale.x == run.mission.mission["safe_distance"]
    assert len(by_name["robots"].points) == len(by_name["robots"].colors) == 4
    assert [marker.text for marker in markers if marker.ns == "ids"] == ["0", "1", "2", "3"]
    assert all(marker.action in (0, 2) and (marker.points or marker.text or marker.action == 2) for marker in markers)


def test_no_bag_is_overwritten_and_nothing_is_left_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = make_record(tmp_path / "run.mcap", n=3, rounds=2)
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="nothing is ever overwritten"):
        write_bag(record, tmp_path / "bag")

    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("llm_flock_swarm._ros2.bag.to_cdr", fails)
    with pytest.raises(RecordError, match="No space left"):
        write_bag(record, tmp_path / "other")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "run.mcap"]


@pytest.mark.parametrize(
    ("changes", "topic"),
    [
        ({"config": {"network": "text"}}, "/flock/state"),
        ({"config": {"network": {"swarm": "7 up", "step_s": "x"}}}, "/_7_up/state"),
        ({"config": {"network": {"swarm": "", "step_s": 1e200}}}, "/flock/state"),
        ({"created_at": "yesterday"}, "/flock/state"),
    ],
)
def test_records_with_odd_values_become_a_bag(
    changes: dict[str, Any], topic: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sample_records.run_info", lambda seed: run_info(seed, **changes))
    write_bag(make_record(tmp_path / "run.mcap", n=1, rounds=1, dim=3), tmp_path / "bag")
    assert topic in {topic for topic, *_ in read_bag(tmp_path / "bag")}


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"created_at": "9999-12-31T00:00:00"}, "a time of 0 s has no place in a bag"),
        ({"config": {"world": 3}}, "expected a table"),
        ({"config": {"world": {"scale_m": -1.0}}}, "scale_m = -1.0: expected more than 0"),
    ],
)
def test_record_with_impossible_values_becomes_no_bag(
    changes: dict[str, Any], cause: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sample_records.run_info", lambda seed: run_info(seed, **changes))
    record = make_record(tmp_path / "run.mcap", n=1, rounds=1, dim=3)
    with pytest.raises(RecordError, match=cause):
        write_bag(record, tmp_path / "bag")
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_wrong_input_is_refused_in_one_line(tmp_path: Path) -> None:
    record = make_record(tmp_path / "run.mcap", n=3, rounds=1)
    assert (
        "--unit-m 0: expected more than 0"
        in flock("export", "--ros2bag", "run.mcap", "--unit-m", "0", cwd=tmp_path, check=False).stderr
    )
    assert "--unit-m" in flock("export", "run.mcap", "--unit-m", "2", cwd=tmp_path, check=False).stderr
    (tmp_path / "text").write_text("no record")
    with pytest.raises(RecordError, match="not a readable MCAP file"):
        write_bag(tmp_path / "text", tmp_path / "bag")
    assert not (tmp_path / "bag").exists()
    write_bag(record, tmp_path / "named", Ros2Config(ros_namespace="a/b", ros_frame="map"))
    assert "/a/b/robot_0/pose" in {topic for topic, *_ in read_bag(tmp_path / "named")}
