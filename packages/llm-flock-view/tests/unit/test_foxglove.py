"""Runs for Foxglove: every message fits its schema, the file has an index, and Foxglove can take the layout."""

from __future__ import annotations

import pytest

pytest.importorskip("foxglove")


import json
import re
import types
import typing
from pathlib import Path
from typing import Any

import foxglove.layouts as panels
import numpy as np
import pytest
from command_line import flock
from mcap.reader import make_reader
from sample_records import FakeRun, make_record

from llm_flock.errors import InputError, RecordError
from llm_flock.record._reader import read_record
from llm_flock.record._schema import Entry, MissionInfo, RunInfo, State
from llm_flock.record._writer import RecordWriter
from llm_flock_view._foxglove import channels
from llm_flock_view._foxglove.channels import (
    ARENA,
    MAX_TRAIL_ROUNDS,
    TRAILS,
    ChannelMessage,
    ChannelWriter,
    channel_kinds,
    pose_topic,
)
from llm_flock_view._foxglove.file import write_file
from llm_flock_view._foxglove.layout import layout


class Drawn:
    """A sink that keeps what Foxglove gets."""

    def __init__(self) -> None:
        self._writer = ChannelWriter()
        self.messages: list[ChannelMessage] = []

    def write(self, entry: Entry) -> None:
        self.messages += self._writer.messages(entry)

    def of(self, topic: str) -> list[dict[str, Any]]:
        return [json.loads(message.data) for message in self.messages if message.topic == topic]


def drawn(run: FakeRun) -> Drawn:
    sink = Drawn()
    run.write(sink)
    return sink


def fits(value: Any, schema: dict[str, Any]) -> bool:
    """Whether a value has the types of a JSON schema; objects without properties are free."""
    if "oneOf" in schema:
        return value in [one["const"] for one in schema["oneOf"]]
    if "anyOf" in schema:
        return any(fits(value, one) for one in schema["anyOf"])
    match schema.get("type"):
        case "object":
            fields = schema.get("properties", {})
            return isinstance(value, dict) and all(fits(value[k], one) for k, one in fields.items() if k in value)
        case "array":
            return isinstance(value, list) and all(fits(one, schema.get("items", {})) for one in value)
        case "string":
            return isinstance(value, str)
        case "integer":
            return isinstance(value, int) and not isinstance(value, bool)
        case "number":
            return isinstance(value, int | float) and not isinstance(value, bool)
        case "boolean":
            return isinstance(value, bool)
        case "null":
            return value is None
        case _:
            return True


@pytest.mark.parametrize("dim", [2, 3])
def test_every_message_fits_the_schema_of_its_channel(dim: int) -> None:
    sink, kinds = drawn(FakeRun(n=6, rounds=4, dim=dim)), channel_kinds(6)
    assert {message.topic for message in sink.messages} >= {ARENA, TRAILS, "/scene", "/log", *map(pose_topic, range(6))}
    for message in sink.messages:
        assert fits(json.loads(message.data), kinds[message.topic].schema), message.topic
    assert not fits({"timestamp": {"sec": 0.5, "nsec": 0}}, kinds[ARENA].schema["properties"]["entities"]["items"])


def test_poses_are_the_positions_and_trails_end_at_them() -> None:
    run = FakeRun(n=5, rounds=MAX_TRAIL_ROUNDS + 4)
    sink = drawn(run)
    states = sink.of("/state")
    for robot in range(5):
        poses = sink.of(pose_topic(robot))
        assert [pose["timestamp"]["sec"] for pose in poses] == list(range(run.rounds + 1))
        for pose, state in zip(poses, states, strict=True):
            at = pose["pose"]["position"]
            assert (at["x"], at["y"]) == pytest.approx(tuple(state["positions"][robot]), abs=1e-3)
    lines = sink.of(TRAILS)[-1]["entities"][0]["lines"]
    assert [len(line["points"]) for line in lines] == [MAX_TRAIL_ROUNDS] * 5
    last = [[line["points"][-1]["x"], line["points"][-1]["y"]] for line in lines]
    assert np.allclose(last, states[-1]["positions"], atol=1e-3)


def test_trails_of_large_teams_are_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(channels, "MAX_TRAIL_POINTS", 60)
    lines = drawn(FakeRun(n=20, rounds=9)).of(TRAILS)[-1]["entities"][0]["lines"]
    assert [len(line["points"]) for line in lines] == [3] * 20


def test_the_arena_has_its_walls_and_obstacles() -> None:
    mission = FakeRun(n=3).mission.model_dump(mode="json")
    mission["obstacles"] = [
        {"center": [20, 30], "radius": 4, "polygon": None},
        {"polygon": [[1, 1], [9, 1], [5, 8]], "center": None, "radius": None},
    ]
    sink = Drawn()
    sink.write(MissionInfo(version=0, round=0, mission=mission, ideal=None))
    (arena,) = sink.of(ARENA)
    entity = arena["entities"][0]
    walls, *edges = entity["lines"]
    assert {(p["x"], p["y"]) for p in walls["points"]} == {(0, 0), (100, 0), (100, 100), (0, 100)}
    assert [len(edge["points"]) for edge in edges] == [3, 3]
    (cylinder,) = entity["cylinders"]
    assert cylinder["size"]["x"] == 8 and cylinder["pose"]["position"]["x"] == 20


def test_a_state_before_the_mission_is_refused() -> None:
    state = next(one for one in entries(FakeRun(n=3, rounds=0)) if isinstance(one, State))
    with pytest.raises(RecordError, match="before the mission"):
        Drawn().write(state)


def entries(run: FakeRun) -> list[Entry]:
    class Kept(list[Entry]):
        def write(self, entry: Entry) -> None:
            self.append(entry)

    kept = Kept()
    run.write(kept)
    return kept


def test_file_has_chunks_and_an_index_and_reads_like_a_record(tmp_path: Path) -> None:
    record = make_record(tmp_path / "run.mcap", n=4, rounds=6)
    target = tmp_path / "new" / "foxglove.mcap"
    count = write_file(record, target)
    with target.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.chunk_indexes and summary.statistics.message_count == count
        topics = {channel.topic for channel in summary.channels.values()}
        assert topics >= {ARENA, TRAILS, *map(pose_topic, range(4))}
        late = list(reader.iter_messages(topics=[pose_topic(2)], starting_at=5 * 10**9))
        assert [message.log_time // 10**9 for _, _, message in late] == [5, 6]
    assert np.array_equal(read_record(target).positions, read_record(record).positions)
    assert list(target.parent.iterdir()) == [target]


def test_the_record_of_a_killed_run_is_exported_up_to_its_end(tmp_path: Path) -> None:
    whole = make_record(tmp_path / "whole.mcap", n=4, rounds=6).read_bytes()
    record = tmp_path / "run.mcap"
    record.write_bytes(whole[: len(whole) * 2 // 3])
    write_file(record, tmp_path / "foxglove.mcap")
    assert read_record(tmp_path / "foxglove.mcap").rounds == read_record(record).rounds > 0


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (b"", "ended before its start was recorded"),
        (b"no record at all", "not a readable MCAP file"),
        (b"\x89MCAP0\r\n", "ended before its start was recorded"),
    ],
)
def test_failed_export_leaves_the_older_file(tmp_path: Path, content: bytes, cause: str) -> None:
    (tmp_path / "run.mcap").write_bytes(content)
    before = (tmp_path / "foxglove.mcap").write_bytes(b"an older export")
    with pytest.raises(RecordError, match=cause):
        write_file(tmp_path / "run.mcap", tmp_path / "foxglove.mcap")
    assert before and (tmp_path / "foxglove.mcap").read_bytes() == b"an older export"
    assert {path.name for path in tmp_path.iterdir()} == {"run.mcap", "foxglove.mcap"}


def test_a_mission_of_more_robots_than_there_can_be_is_refused(tmp_path: Path) -> None:
    with RecordWriter(tmp_path / "run.mcap") as writer:
        for entry in entries(FakeRun(n=3, rounds=1)):
            if isinstance(entry, MissionInfo):
                entry = entry.model_copy(update={"mission": {**entry.mission, "n_robots": 70_000}})
            writer.write(entry)
    with pytest.raises(RecordError, match=r"n_robots.*2000"):
        write_file(tmp_path / "run.mcap", tmp_path / "foxglove.mcap")


def test_a_record_is_not_replaced_by_its_export(tmp_path: Path) -> None:
    record = make_record(tmp_path / "run.mcap", n=3, rounds=1)
    before = record.read_bytes()
    with pytest.raises(InputError, match="another place"):
        write_file(record, record)
    assert record.read_bytes() == before


KINDS: dict[str, Any] = {
    "3D": panels.ThreeDeeConfig,
    "Plot": panels.PlotConfig,
    "RosOut": panels.LogConfig,
    "RawMessages": panels.RawMessagesConfig,
}
"""The SDK's schema of each panel's settings."""


def leaves(tree: Any) -> list[str]:
    """The panels of an arrangement."""
    if isinstance(tree, str):
        return [tree]
    assert set(tree) <= {"direction", "first", "second", "splitPercentage"} and tree["direction"] in ("row", "column")
    assert 0 < tree.get("splitPercentage", 50) < 100
    return leaves(tree["first"]) + leaves(tree["second"])


def snake(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def objection(value: Any, kind: Any, where: str) -> str | None:
    """Why a value is not one of the SDK's schema; None if it is."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        found = [objection(value, one, where) for one in inner]
        return None if None in found else next(text for text in found if text)
    if origin is typing.Literal:
        return None if value in inner else f"{where}: {value!r} is none of {inner}"
    if origin is list:
        checked = (objection(one, inner[0], f"{where}[]") for one in value) if isinstance(value, list) else [where]
        return next(filter(None, checked), None)
    if origin is tuple:
        good = isinstance(value, list) and len(value) == len(inner)
        checked = [objection(one, each, where) for one, each in zip(value, inner, strict=True)] if good else [where]
        return next(filter(None, checked), None)
    if origin is dict:
        checked = (objection(one, inner[1], f"{where}.{k}") for k, one in value.items())
        return next(filter(None, checked), None)
    if hasattr(kind, "__dataclass_fields__"):
        fields = typing.get_type_hints(kind, dict(vars(panels)))
        if not isinstance(value, dict):
            return f"{where}: no object"
        for name, one in value.items():
            if snake(name) not in fields:
                return f"{where}: no field {name}"
            if (wrong := objection(one, fields[snake(name)], f"{where}.{name}")) is not None:
                return wrong
        return None
    if kind is float:
        return None if isinstance(value, int | float) and not isinstance(value, bool) else f"{where}: no number"
    return None if kind is Any or isinstance(value, kind) else f"{where}: {value!r}"


def test_the_layout_is_one_arrangement_of_panels_with_settings() -> None:
    found = layout()
    assert set(found) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    placed = leaves(found["layout"])
    assert sorted(placed) == sorted(found["configById"])
    assert all(re.fullmatch(rf"({'|'.join(KINDS)})!\w+", name) for name in placed)


def test_the_settings_of_each_panel_are_of_the_sdks_schema() -> None:
    for name, config in layout(((0.0, 0.0, 0.0), (60.0, 40.0, 20.0)))["configById"].items():
        kind = KINDS[name.partition("!")[0]]
        settings = {key: value for key, value in config.items() if key != "title"}
        assert objection(settings, kind, name) is None
    assert objection({"topicPath": 3}, panels.RawMessagesConfig, "") is not None
    assert objection({"nonsense": 3}, panels.RawMessagesConfig, "") is not None


def test_the_layout_names_channels_and_figures_that_exist() -> None:
    kinds, configs = channel_kinds(0), layout()["configById"]
    paths = [path["value"] for config in configs.values() for path in config.get("paths", ())]
    assert paths
    for path in paths:
        topic, _, field = path.partition(".")
        assert field in kinds[topic].schema["properties"]
    assert {topic for config in configs.values() for topic in config.get("topics", ())} <= set(kinds)


def test_the_command_writes_what_it_is_asked_for(tmp_path: Path) -> None:
    make_record(tmp_path / "demo" / "run.mcap", n=3, rounds=2)
    done = flock("export", "demo", "--foxglove", "--html", cwd=tmp_path)
    assert done.stdout.split() == ["demo/foxglove.mcap", "demo/foxglove-layout.json", "demo/replay.html"]
    assert flock("export", "--foxglove", "--out", "alone", cwd=tmp_path).stdout.split() == [
        "alone/foxglove-layout.json"
    ]
    for arguments, says in ((["demo"], "--html"), ([], "path"), (["nowhere", "--html"], "nowhere: cannot be read")):
        refused = flock("export", *arguments, cwd=tmp_path, check=False)
        assert refused.returncode and says in refused.stderr and refused.stderr.count("\n") == 1


def test_run_info_goes_to_its_own_channel() -> None:
    info = next(one for one in entries(FakeRun(n=3, rounds=0)) if isinstance(one, RunInfo))
    sink = Drawn()
    sink.write(info)
    assert [message.topic for message in sink.messages] == ["/run"]
