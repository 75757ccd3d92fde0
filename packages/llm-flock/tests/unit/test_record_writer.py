"""What is written: channels, schemas, order, and the same bytes for the same run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from sample_records import FakeRun, make_record, run_info

from llm_flock.errors import InputError, RecordError
from llm_flock.record._reader import iter_messages, read_record
from llm_flock.record._scene import PALETTE, SceneDrawer, scene_schema
from llm_flock.record._schema import (
    CHANNELS,
    TOPICS,
    BodySample,
    FlightEvent,
    MetricsRow,
    MissionInfo,
    NullWriter,
    PlanInfo,
    SummaryMessage,
    channel_schema,
)
from llm_flock.record._writer import RecordWriter, check_new


def check(value: Any, schema: dict[str, Any], where: str = "$") -> None:
    """A small validator for the part of JSON Schema that is used here."""
    if "anyOf" in schema:
        kinds = {branch["type"] for branch in schema["anyOf"]}
        assert "null" in kinds and len(schema["anyOf"]) == 2, where
        if value is not None:
            check(value, next(b for b in schema["anyOf"] if b["type"] != "null"), where)
        return
    if "oneOf" in schema:
        assert value in [branch["const"] for branch in schema["oneOf"]], where
        return
    kind = schema["type"]
    types = {"string": str, "integer": int, "number": (int, float), "boolean": bool, "array": list, "object": dict}
    assert isinstance(value, types[kind]), f"{where}: {value!r} is no {kind}"
    assert kind == "boolean" or not isinstance(value, bool), where
    if kind == "array":
        for i, item in enumerate(value):
            check(item, schema["items"], f"{where}[{i}]")
    if kind == "object":
        properties = schema["properties"]
        missing = set(schema.get("required", ())) - set(value)
        assert not missing, f"{where}: {missing} missing"
        if schema.get("additionalProperties") is False or "additionalProperties" not in schema:
            assert set(value) <= set(properties), f"{where}: {set(value) - set(properties)} unknown"
        for name, item in value.items():
            if name in properties:
                check(item, properties[name], f"{where}.{name}")
            elif isinstance(schema.get("additionalProperties"), dict):
                check(item, schema["additionalProperties"], f"{where}.{name}")


def read_with_mcap(path: Path) -> Iterator[tuple[Any, Any, Any]]:
    with path.open("rb") as file:
        yield from make_reader(file).iter_messages(log_time_order=False)


def test_every_message_is_valid_against_the_schema_beside_it(tmp_path: Path) -> None:
    seen = set()
    row = [[0.0, 0.5, 1.0]]
    with RecordWriter(tmp_path / "run.mcap") as writer:
        FakeRun(n=5, rounds=3).write(writer, finish=False)
        writer.write(
            BodySample(round=3, time_s=1.0, measured=row, commanded=row, flying=[True], battery_v=[None], link=[1.0])
        )
        writer.write(FlightEvent(round=3, time_s=1.0, kind="landing", robot=0, detail={"spot": [0.0, 0.5]}))
        writer.write(FlightEvent(round=3, time_s=1.0, kind="abort", robot=None, detail={}))
        writer.write(SummaryMessage(result={"formed": True}))
    for schema, channel, message in read_with_mcap(tmp_path / "run.mcap"):
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        check(json.loads(message.data), json.loads(schema.data))
        seen.add(channel.topic)
    assert seen == {*CHANNELS, "/scene"}


def test_schemas_of_the_channels_are_those_of_the_models(tmp_path: Path) -> None:
    written = {c.topic: (s.name, json.loads(s.data)) for s, c, _ in read_with_mcap(make_record(tmp_path / "r.mcap"))}
    assert written.pop("/scene") == ("foxglove.SceneUpdate", scene_schema())
    for topic, (name, schema) in written.items():
        assert name == f"llm_flock.{schema['title']}"
        assert list(schema["properties"]) == list(CHANNELS[topic].model_fields)


def foxglove_takes(schema: dict[str, Any]) -> bool:
    """The rules of Foxglove's and Lichtblick's parser of JSON schemas."""
    if schema.get("type") != "object" or "properties" not in schema:
        return False
    for field in schema["properties"].values():
        if "oneOf" in field:
            if not all(isinstance(branch.get("const"), int) for branch in field["oneOf"]):
                return False
        elif field.get("type") == "array":
            items = field["items"]
            if items.get("type") == "object":
                if not foxglove_takes(items):
                    return False
            elif items.get("type") not in ("boolean", "string", "number", "integer"):
                return False
        elif field.get("type") == "object":
            if not foxglove_takes(field):
                return False
        elif field.get("type") not in ("boolean", "string", "number", "integer"):
            return False
    return True


def test_viewers_understand_schemas_without_lists_of_points() -> None:
    refused = {topic for topic, model in CHANNELS.items() if not foxglove_takes(channel_schema(model))}
    assert refused == {"/mission", "/plan", "/state", "/body"}
    assert foxglove_takes(scene_schema())


def test_none_is_omitted_from_fields_but_kept_in_free_values(tmp_path: Path) -> None:
    messages = [(m.topic, m.decoded()) for m in iter_messages(make_record(tmp_path / "run.mcap", n=2, rounds=1))]
    run = next(data for topic, data in messages if topic == "/run")
    assert "git_revision" not in run
    assert run["config"]["model"]["base_url"] is None
    start = next(data for topic, data in messages if topic == "/state")
    assert start["goals"] == [None, None]
    assert messages[-1] == (
        "/summary",
        {"result": {"formed": True, "rounds": 1, "missions": [{"formed": 1}], "wall_s": 1.5, "cost_usd": None}},
    )


def test_time_is_one_second_a_round(tmp_path: Path) -> None:
    for _, channel, message in read_with_mcap(make_record(tmp_path / "run.mcap", n=3, rounds=4)):
        data = json.loads(message.data)
        if channel.topic == "/scene":
            assert {e["timestamp"]["sec"] * 10**9 for e in data["entities"]} == {message.log_time}
        elif "round" in data:
            assert message.log_time == message.publish_time == data["round"] * 10**9


def test_the_end_of_a_round_is_its_last_message(tmp_path: Path) -> None:
    last = -1
    for message in iter_messages(make_record(tmp_path / "run.mcap", n=3, rounds=4)):
        if message.topic == "/summary":
            continue
        assert message.round == max(0, last + 1)
        if message.topic == "/round":
            last = message.round
    assert last == 4


def test_same_run_same_bytes(tmp_path: Path) -> None:
    one, two = make_record(tmp_path / "a.mcap", seed=3), make_record(tmp_path / "b.mcap", seed=3)
    assert one.read_bytes() == two.read_bytes()
    assert one.read_bytes() != make_record(tmp_path / "c.mcap", seed=4).read_bytes()


def test_fields_that_differ_between_equal_runs_are_declared() -> None:
    volatile = {
        topic: {name for name, field in channel_schema(model)["properties"].items() if "volatile" in field}
        for topic, model in CHANNELS.items()
    }
    assert volatile["/run"] == {"created_at", "environment"}
    assert volatile["/llm"] == {"latency_s"}
    assert volatile["/flight"] == {"time_s", "detail"}
    assert {topic for topic, names in volatile.items() if names} == {"/run", "/llm", "/body", "/flight"}


def test_an_existing_file_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("precious")
    with pytest.raises(InputError, match=r"out = .*run\.mcap.* a place where nothing is"):
        RecordWriter(path)
    assert path.read_text() == "precious"


def test_folders_are_made_and_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    assert make_record(tmp_path / "new" / "er" / "run.mcap", n=1, rounds=0).exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="can be written to"):
        RecordWriter(tmp_path / "file" / "run.mcap")


def test_a_full_disk_is_reported_with_its_reason(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    writer = RecordWriter(tmp_path / "run.mcap")
    writer._file.close()
    writer._file = open("/dev/full", "wb", buffering=1 << 20)  # noqa: SIM115, PTH123
    writer._mcap._Writer__stream = writer._file  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(RecordError, match="cannot be written"):
        writer.write(run_info())
    with pytest.raises(RecordError, match="cannot be written"):
        writer.close()
    writer.close()


def test_a_run_that_fails_still_leaves_a_file_that_ends_well(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    def fail() -> None:
        with RecordWriter(path) as writer:
            FakeRun(n=3, rounds=2).write(writer, finish=False)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_bytes().endswith(b"\x89MCAP0\r\n")
    assert not read_record(path).complete


def test_a_state_needs_a_mission_before_it(tmp_path: Path) -> None:
    source = read_record(make_record(tmp_path / "a.mcap", n=2, rounds=0))
    with RecordWriter(tmp_path / "b.mcap") as writer, pytest.raises(RecordError, match="before the mission"):
        writer.write(source.states[0])


def test_null_writer_takes_everything_and_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    FakeRun(n=3, rounds=2).write(NullWriter())
    assert not list(tmp_path.iterdir())


def test_entries_refuse_unknown_fields_and_numbers_not_in_json() -> None:
    with pytest.raises(ValueError, match="extra"):
        run_info(surprise=1)
    row: dict[str, Any] = dict.fromkeys(MetricsRow.model_fields, 0) | {"connected": True, "messages_rejected": {}}
    with pytest.raises(ValueError, match="finite"):
        MetricsRow.model_validate(row | {"min_separation": float("inf")})


def test_every_model_has_one_topic() -> None:
    assert {TOPICS[model] for model in CHANNELS.values()} == set(CHANNELS)


def test_scene_shows_robots_goals_and_links(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=10, rounds=10))
    drawer = SceneDrawer(record.mission)
    drawer.know(plan.plan_id for plan in record.plans)
    start, end = (json.loads(drawer.draw(record.states[k])) for k in (0, -1))
    robots, goals, links = end["entities"]
    assert [e["id"] for e in end["entities"]] == ["robots", "goals", "links"]
    assert {e["frame_id"] for e in end["entities"]} == {"world"}
    assert [t["text"] for t in robots["texts"]] == [str(i) for i in range(10)]
    for sphere, position in zip(robots["spheres"], record.positions[-1], strict=True):
        where = sphere["pose"]["position"]
        assert (where["x"], where["y"], where["z"]) == pytest.approx((*position, 0.0), abs=1e-3)
        assert sphere["size"]["x"] == 3.0
    assert len(goals["spheres"]) == 10 and not start["entities"][1]["spheres"]
    # A circle whose chords are 10 with a radio range of 15: everybody hears both neighbours.
    assert len(links["lines"][0]["indices"]) == 2 * 10
    first = tuple(int(PALETTE[0][i : i + 2], 16) / 255 for i in (1, 3, 5))
    colours = {tuple(sphere["color"][c] for c in "rgb") for sphere in robots["spheres"]}
    assert len(colours) == 1 and colours.pop() == pytest.approx(first, abs=1e-3)
    assert {tuple(s["color"][c] for c in "rgb") for s in start["entities"][0]["spheres"]} == {(1.0, 1.0, 1.0)}


def test_scene_keeps_the_third_dimension(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=4, rounds=2, dim=3))
    scene = json.loads(SceneDrawer(record.mission).draw(record.states[-1]))
    heights = [s["pose"]["position"]["z"] for s in scene["entities"][0]["spheres"]]
    assert heights == pytest.approx(record.positions[-1][:, 2].tolist(), abs=1e-3)


def test_scene_shows_dead_robots_black_and_no_links_of_silent(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=5, rounds=6))
    state = record.states[-1].model_copy(update={"phases": ["dead", "idle", "asleep", "idle", "idle"]})
    entities = json.loads(SceneDrawer(record.mission).draw(state))["entities"]
    spheres = [sphere["color"] for sphere in entities[0]["spheres"]]
    assert spheres[0] == {"r": 0, "g": 0, "b": 0, "a": 1} != spheres[1]
    links = [robot for line in entities[2]["lines"] for robot in line["indices"]]
    assert links and not {0, 2} & set(links)


def test_plans_keep_their_colours_when_the_mission_changes(tmp_path: Path) -> None:
    run = FakeRun(n=4, rounds=6)
    with RecordWriter(tmp_path / "run.mcap") as writer:
        mission = MissionInfo(version=0, round=0, mission=run.mission.model_dump(mode="json"), ideal=None)
        writer.write(run_info())
        writer.write(mission)
        writer.write(PlanInfo(round=0, plan_id="f" * 16, proposer=3, points=[]))
        for number in range(4):
            run.write_round(writer, number)
        writer.write(mission.model_copy(update={"version": 1, "round": 4}))
        for number in range(4, 7):
            run.write_round(writer, number)
    scenes = [m.decoded() for m in iter_messages(tmp_path / "run.mcap") if m.topic == "/scene"]
    colours = [[sphere["color"] for sphere in scene["entities"][0]["spheres"]] for scene in scenes]
    assert colours[3] == colours[4]


def test_checking_a_new_record_creates_its_folder_only(tmp_path: Path) -> None:
    check_new(tmp_path / "new" / "run.mcap")
    assert (tmp_path / "new").is_dir() and not (tmp_path / "new" / "run.mcap").exists()


def test_a_record_that_was_removed_meanwhile_is_missed(tmp_path: Path) -> None:
    writer = RecordWriter(tmp_path / "run.mcap")
    (tmp_path / "run.mcap").unlink()
    with pytest.raises(RecordError, match="removed while it was written"):
        writer.close()
