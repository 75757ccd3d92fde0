"""Records that break off say so when they are exported; files that are no record are named for what they are."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import flock
from mcap.writer import Writer
from sample_records import make_record

from llm_flock.errors import RecordError
from llm_flock.record._reader import read_record
from llm_flock_swarm._ros2.bag import write_bag


def test_the_export_of_a_broken_record_says_where_it_ends(tmp_path: Path) -> None:
    whole = make_record(tmp_path / "whole" / "run.mcap", n=3, rounds=4)
    formats = ("--html", "--foxglove", "--ros2bag")
    assert flock("export", "whole", *formats, cwd=tmp_path).stderr == ""
    half = tmp_path / "half" / "run.mcap"
    half.parent.mkdir()
    data = whole.read_bytes()
    half.write_bytes(data[: len(data) * 2 // 3])
    rounds = read_record(half).rounds
    assert 0 < rounds < 4
    done = flock("export", "half", *formats, cwd=tmp_path)
    assert done.stderr == f"warning: half/run.mcap ends early (the run was stopped): exported up to round {rounds}\n"


def test_a_bag_of_ros_is_called_one(tmp_path: Path) -> None:
    write_bag(make_record(tmp_path / "run.mcap", n=3, rounds=1), tmp_path / "bag")
    (file,) = (tmp_path / "bag").glob("*.mcap")
    for path in (tmp_path / "bag", file):
        for command in (("inspect", str(path)), ("export", str(path), "--html")):
            refused = flock(*command, cwd=tmp_path, check=False)
            assert refused.returncode == 1 and refused.stderr.startswith(f"error: {path}: a bag of ROS 2, not a record")
            assert refused.stderr.count("\n") == 1


@pytest.mark.parametrize("content", ["no", "no record, but text of some length"])
def test_a_file_of_text_is_no_run_that_ended(content: str, tmp_path: Path) -> None:
    (tmp_path / "text").write_text(content)
    with pytest.raises(RecordError, match="text: not a readable MCAP file"):
        read_record(tmp_path / "text")


def test_labels_and_rounds_are_for_the_figures_that_have_them(tmp_path: Path) -> None:
    make_record(tmp_path / "run.mcap", n=3, rounds=2)
    for kind, flag, value in (("snapshots", "--label", "a"), ("error", "--rounds", "0,1")):
        done = flock("figure", ".", "--kind", kind, flag, value, cwd=tmp_path, check=False)
        assert (done.returncode, done.stderr) == (2, f"error: {flag} {value}: has no effect on {kind}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_a_file_of_another_program_is_no_run_that_ended(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/camera", "json", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with pytest.raises(RecordError, match="not a record of a run: /camera comes before /run"):
        read_record(path)
