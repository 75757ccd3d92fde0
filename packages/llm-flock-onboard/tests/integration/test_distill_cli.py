"""The commands of `llm-flock distill`, as far as they go without what training needs."""

import json
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import InputError


def call(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["distill", *arguments], catch_exceptions=True)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output


def test_examples_are_written(tmp_path: Path) -> None:
    said = call("data", str(tmp_path / "a.jsonl"), "--count", "5")
    examples = [json.loads(line) for line in (tmp_path / "a.jsonl").read_text().splitlines()]
    assert said == f"5 examples in {tmp_path / 'a.jsonl'}, with 5 different prompts\n"
    assert all(example["messages"][0][0] == "system" and example["answer"] for example in examples)
    call("data", str(tmp_path / "b.jsonl"), "--count", "5", "--held-out")
    held = map(json.loads, (tmp_path / "b.jsonl").read_text().splitlines())
    assert {example["topic"].partition(" ")[0] for example in held} <= {"star", "wedge"}


def test_distill_names_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="adapter"):
        call("export", str(tmp_path), str(tmp_path / "a.gguf"))
    call("data", str(tmp_path / "a.jsonl"), "--count", "1")
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match=r"llm-flock\[distill\]"):
        call("train", str(tmp_path / "a.jsonl"), str(tmp_path / "run"))


def test_no_file_is_written_over(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("mine", encoding="utf-8")
    for line in (("data", str(notes), "--count", "1"), ("export", str(tmp_path), str(notes))):
        with pytest.raises(InputError, match=r"notes\.txt.* a place where nothing is: nothing is ever overwritten"):
            call(*line)
    assert notes.read_text(encoding="utf-8") == "mine"
    with pytest.raises(InputError, match="a place that can be written to"):
        call("data", str(notes / "a.jsonl"), "--count", "1")
    assert "Invalid value" in call("data", str(tmp_path / "a.jsonl"), "--count", str(10**30))
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
