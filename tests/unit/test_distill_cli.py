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
    said = call("data", str(tmp_path / "a.jsonl"), "--count", "5", "--plans", "1")
    lines = (tmp_path / "a.jsonl").read_text().splitlines()
    assert said == f"{len(lines)} examples in {tmp_path / 'a.jsonl'}\n"
    assert [json.loads(line)["kind"] for line in lines].count("plan") == len(lines) - 5
    call("data", str(tmp_path / "b.jsonl"), "--count", "5", "--plans", "0", "--held-out")
    held = map(json.loads, (tmp_path / "b.jsonl").read_text().splitlines())
    assert {example["team"].partition(" ")[0] for example in held} <= {"star", "wedge"}


def test_figures_are_printed_as_a_table_or_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    options = ("simulated:ideal", "--count", "5", "--paths", "2", "--plans", "1", "--frame", "own")
    table = call("eval", *options)
    assert "as flown" in table and "plan of circle 10" in table
    plain = json.loads(call("eval", *options, "--json"))
    assert plain["step"]["asked"] == 5 and plain["path"]["parsed"] == 1.0 and len(plain["plans"]) == 5
    with pytest.raises(InputError, match="frame"):
        call("eval", "simulated:ideal", "--frame", "mine")


def test_what_is_missing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="adapter"):
        call("export", str(tmp_path), str(tmp_path / "a.gguf"))
    call("data", str(tmp_path / "a.jsonl"), "--count", "1", "--plans", "0")
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match=r"llm-flock\[distill\]"):
        call("train", str(tmp_path / "a.jsonl"), str(tmp_path / "run"))
