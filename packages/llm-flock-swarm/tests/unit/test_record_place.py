"""A swarm whose record cannot be written to its place does not start."""

from __future__ import annotations

from pathlib import Path

from command_line import flock
from sample_records import make_record


def test_swarm_that_cannot_be_recorded_starts_nothing(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    make_record(tmp_path / "have" / "run.mcap", n=2, rounds=1)
    for out, says in (("notes.txt", "a place that can be written to"), ("have", "a place where nothing is")):
        done = flock("swarm", "--robots", "3", "--shape", "triangle", "--out", out, cwd=tmp_path, check=False)
        assert done.returncode == 2, done.stderr
        assert done.stderr == f"error: --out {out}/run.mcap: expected {says}" + done.stderr.partition(says)[2]
        assert done.stdout == "" and done.stderr.count("\n") == 1
