"""What is read back: everything of complete rounds, nothing of a broken one, clear errors for the rest."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import IndexType, Writer
from pydantic import ValidationError
from sample_records import FakeRun, llm_entry, make_record, run_info

from llm_flock.errors import RecordError
from llm_flock.mission import Mission
from llm_flock.record._reader import iter_messages, read_record
from llm_flock.record._schema import FlightEvent, MetricsRow, MissionInfo, PlanInfo, RunInfo, SummaryMessage
from llm_flock.record._writer import RecordWriter


def test_everything_comes_back(tmp_path: Path) -> None:
    fake = FakeRun(n=6, rounds=5, seed=2)
    path = tmp_path / "run.mcap"
    with RecordWriter(path) as writer:
        fake.write(writer)
    record = read_record(path)
    assert record.complete and record.rounds == 5
    assert record.run == run_info(2)
    assert record.mission.mission == fake.mission.model_dump(mode="json")
    assert record.positions.shape == (6, 6, 2)
    np.testing.assert_array_equal(record.positions[0], fake.start)
    assert [plan.plan_id for plan in record.plans] == [plan.digest for plan in fake.plans]
    assert len(record.llm) == len(record.events) == 30
    assert record.llm[7] == llm_entry(2, 1)
    assert record.models == ("simulated:ideal",)
    assert [row.round for row in record.metrics] == [state.round for state in record.states] == list(range(6))
    assert record.errors.tolist() == [row.procrustes_mean for row in record.metrics]
    assert record.result == {"formed": True, "rounds": 5, "missions": [{"formed": 5}], "wall_s": 1.5, "cost_usd": None}


def test_an_unknown_error_is_not_a_number(tmp_path: Path) -> None:
    path = make_record(tmp_path / "run.mcap", n=2, rounds=1)
    record = read_record(path)
    rows = tuple(row.model_copy(update={"procrustes_mean": None}) for row in record.metrics)
    assert np.isnan(replace(record, metrics=rows).errors).all()


def test_a_file_cut_anywhere_gives_its_complete_rounds(tmp_path: Path) -> None:
    """No error and no half round, at every length around the ends of two rounds and at many others."""
    whole = make_record(tmp_path / "run.mcap", n=2, rounds=6, llm=False).read_bytes()
    ends = [i for i in range(len(whole)) if whole.startswith(b'{"round":', i) and whole[i + 10 : i + 11] == b"}"]
    assert len(ends) == 7
    cut = tmp_path / "cut.mcap"
    around = {end + k for end in ends[:2] for k in range(-30, 60)}
    for length in sorted(around | set(range(ends[0], len(whole), 101))):
        cut.write_bytes(whole[:length])
        complete = sum(end + 11 <= length for end in ends)
        if complete == 0:
            with pytest.raises(RecordError, match="nothing to show"):
                read_record(cut)
            continue
        record = read_record(cut)
        assert len(record.states) == len(record.metrics) == complete
        assert record.positions.shape == (complete, 2, 2)
        if not record.complete:
            assert all(event.round < complete for event in record.events)
            assert all(plan.round < complete for plan in record.plans)


def test_calls_of_an_interrupted_round_are_kept_on_a_clean_end(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordWriter(path) as writer:
        FakeRun(n=2, rounds=1).write(writer, finish=False)
        writer.write(llm_entry(2, 0))
        writer.write(SummaryMessage(result={"stopped": "interrupted"}))
    record = read_record(path)
    assert record.rounds == 1 and record.llm[-1].round == 2


def test_channels_of_others_are_passed_over(tmp_path: Path) -> None:
    path, more = make_record(tmp_path / "run.mcap", n=2, rounds=1), tmp_path / "more.mcap"
    with more.open("wb") as file:
        writer = Writer(file, use_chunking=True)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {}
        for message in iter_messages(path):
            if message.topic not in channels:
                channels[message.topic] = writer.register_channel(message.topic, "json", schema)
            writer.add_message(channels[message.topic], message.round * 10**9, message.data, 0)
        writer.add_message(writer.register_channel("/theirs", "json", schema), 0, b"{}", 0)
        writer.finish()
    assert read_record(more).states == read_record(path).states


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty file"),
        (b"not a record at all, just words", "not a readable MCAP file"),
        (b"\x89MCAP0\r\n", "nothing to show"),
    ],
)
def test_file_that_is_no_record_is_rejected(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordError, match=rf"run\.mcap: .*{message}"):
        read_record(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"gone\.mcap: cannot be read \(No such file"):
        read_record(tmp_path / "gone.mcap")
    with pytest.raises(RecordError, match=r"run\.mcap: cannot be read \(No such file"):
        read_record(tmp_path)
    for wrong, cause in (
        (None, "by the path of its file"),
        (3, "by the path of its file"),
        ("nul\0", "null (byte|character)"),
    ):
        with pytest.raises(RecordError, match=cause):
            read_record(wrong)  # pyright: ignore[reportArgumentType]


def plain_file(path: Path, *messages: tuple[str, bytes]) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, index_types=IndexType.NONE)
        writer.start()
        for topic, data in messages:
            channel = writer.register_channel(topic, "json", 0)
            writer.add_message(channel, 0, data, 0)
        writer.finish()
    return path


def test_newer_format_is_refused_even_with_unknown_fields(tmp_path: Path) -> None:
    newer = json.loads(run_info().encoded()) | {"format_version": 2, "new_field": 1}
    path = plain_file(tmp_path / "run.mcap", ("/run", json.dumps(newer).encode()))
    with pytest.raises(RecordError, match="format version 2; this release reads version 1"):
        read_record(path)


def test_a_damaged_message_is_named(tmp_path: Path) -> None:
    path = plain_file(tmp_path / "run.mcap", ("/run", run_info().encoded()), ("/round", b'{"round": "soon"}'))
    with pytest.raises(RecordError, match=r"/round of round 0 is not valid \(round: "):
        read_record(path)


def test_an_mcap_file_of_something_else_is_no_record(tmp_path: Path) -> None:
    path = plain_file(tmp_path / "run.mcap", ("/round", b'{"round":0}'))
    with pytest.raises(RecordError, match="not a record of a run"):
        read_record(path)


def test_message_on_an_unannounced_channel_is_damage(tmp_path: Path) -> None:
    data = plain_file(tmp_path / "run.mcap", ("/run", run_info().encoded())).read_bytes()
    # The channel record says id 1; the message after it then belongs to no channel.
    damaged = data.replace(b"\x01\x00\x00\x00\x04\x00\x00\x00/run", b"\x09\x00\x00\x00\x04\x00\x00\x00/run", 1)
    assert damaged != data
    (tmp_path / "run.mcap").write_bytes(damaged)
    with pytest.raises(RecordError, match="not a readable MCAP file"):
        read_record(tmp_path / "run.mcap")


def test_written_format_version_is_the_one_that_is_read() -> None:
    assert RunInfo.model_fields["format_version"].default == run_info().format_version


@pytest.mark.parametrize(
    "obstacle",
    [
        {"polygon": []},
        {"polygon": [[0, 0], [1, 1]]},
        {"center": [0, 0], "radius": 1e300},
        {"center": [0, 0], "radius": -1},
        {"center": [0, 0, 0], "radius": 1},
        {"polygon": [[0, 0, 0], [1, 1], [2, 2, 1]]},
        {"polygon": [[k, k * k % 7] for k in range(2000)]},
    ],
    ids=lambda obstacle: str(obstacle)[:40],
)
def test_obstacles_that_cannot_be_drawn_are_refused(obstacle: dict[str, object], tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="obstacles"):
        MissionInfo(version=0, round=0, mission=Mission().model_dump() | {"obstacles": [obstacle]})


def test_positions_too_far_for_arithmetic_are_refused() -> None:
    with pytest.raises(ValidationError, match="points"):
        PlanInfo(round=0, plan_id="x", proposer=0, points=[[1e300, 0.0]])


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"spacing": 0.0}, "spacing"),
        ({"safe_distance": -3.0}, "safe_distance"),
        ({"safe_distance": 5e-324}, "safe_distance"),
        ({"arena": [[0, 0], [0, 0]]}, "arena"),
        ({"arena": [[1e12, 1e12], [-1e12, -1e12]]}, "arena"),
        ({"n_robots": 100_000}, "n_robots"),
        ({"obstacles": [{"center": [0, 0], "radius": 1}] * 501}, "obstacles"),
        ({"obstacles": [{"polygon": [[k, k * k % 7] for k in range(600)]}] * 2}, "corners"),
    ],
)
def test_missions_that_cannot_be_drawn_are_refused(fields: dict[str, Any], says: str) -> None:
    """Each ended `figure`, `animate` or `export` in a traceback, or took gigabytes."""
    with pytest.raises(ValidationError, match=says):
        MissionInfo(version=0, round=0, mission=Mission().model_dump() | fields)


def test_lists_and_figures_that_cannot_be_drawn_are_refused() -> None:
    far = 1.7e308
    with pytest.raises(ValidationError, match="at most 2000"):
        MissionInfo(version=0, round=0, mission=Mission().model_dump(), ideal=[[0.0, 0.0]] * 2001)
    with pytest.raises(ValidationError, match="at most 2000"):
        PlanInfo(round=0, plan_id="x", proposer=0, points=[[0.0, 0.0]] * 2001)
    with pytest.raises(ValidationError, match="detail"):
        FlightEvent(round=0, time_s=0.0, kind="landed", robot=0, detail={"a": {"b": [1e308]}})
    row = dict.fromkeys(("round", "plans_in_use", "distinct_goals", "robots_at_goal", "model_calls", "tokens"), 0)
    rest = {"messages_sent": 0, "bytes_sent": 0, "messages_rejected": {}, "connected": True}
    with pytest.raises(ValidationError, match="procrustes_mean"):
        MetricsRow.model_validate({**row, **rest, "procrustes_mean": far})


def test_an_ideal_shape_of_another_space_is_refused(tmp_path: Path) -> None:
    whole = [(one.topic, one.data) for one in iter_messages(make_record(tmp_path / "whole.mcap", n=3, rounds=1))]
    mission = json.loads(dict(whole)["/mission"])
    mission["ideal"] = [[*mission["ideal"][0], 0.0], *mission["ideal"][1:]]
    odd = [(topic, json.dumps(mission).encode() if topic == "/mission" else data) for topic, data in whole]
    with pytest.raises(RecordError, match="different numbers of coordinates"):
        read_record(plain_file(tmp_path / "run.mcap", *odd))


def test_a_mission_that_begins_after_the_first_state_is_refused(tmp_path: Path) -> None:
    whole = make_record(tmp_path / "whole.mcap", n=3, rounds=1)
    late = [
        (one.topic, one.data.replace(b'"round":0', b'"round":1') if one.topic == "/mission" else one.data)
        for one in iter_messages(whole)
    ]
    assert any(data not in {one.data for one in iter_messages(whole)} for _, data in late)
    with pytest.raises(RecordError, match="a state before the first mission"):
        read_record(plain_file(tmp_path / "run.mcap", *late))


@pytest.mark.parametrize("topic", ["/mission", "/plan", "/protocol", "/llm", "/metrics"])
def test_no_entry_is_from_a_round_far_ahead(topic: str, tmp_path: Path) -> None:
    """A search back from the round of a plan took minutes."""
    whole = [
        (one.topic, json.loads(one.data)) for one in iter_messages(make_record(tmp_path / "a.mcap", n=3, rounds=1))
    ]
    ahead = [(name, json.dumps({**data, "round": 10**9} if name == topic else data).encode()) for name, data in whole]
    with pytest.raises(RecordError, match=r"round 1000000000 where round \d was due"):
        read_record(plain_file(tmp_path / "run.mcap", *ahead))
