"""`llm-flock exam` before it asks anything: what cannot be done is said in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import flock

from llm_flock import extras


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("exam", "MODEL: expected at least one model"),
        ("exam simulated:ideal --sections stepp", "unknown section"),
        ("exam simulated:ideal --split private", "seed of the private split"),
        ("exam simulated:ideal --temperature hot", "--temperature hot: expected a number from 0 to 2"),
        ("exam --page none", "--page none: expected a folder that is there"),
        ("exam --page notes.txt", "--page notes.txt: expected a folder that is there"),
    ],
)
def test_exam_rejects_bad_options_before_it_asks_a_model(line: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    done = flock(*line.split(), cwd=tmp_path, check=False)
    assert done.returncode == 2 and text in done.stderr, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    assert (tmp_path / "notes.txt").read_text(encoding="utf-8") == "mine"


def test_without_inspect_the_command_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    monkeypatch.delitem(__import__("sys").modules, "llm_flock_lab._exam.inspect_model", raising=False)
    done = flock("exam", "geometry", cwd=tmp_path, check=False)
    assert done.returncode == 2 and "pip install 'llm-flock[exam]'" in done.stderr, done.stderr
