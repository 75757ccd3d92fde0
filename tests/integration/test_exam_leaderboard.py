"""The leaderboard: its page is what the rows say, and its rows come back."""

from __future__ import annotations

import asyncio
import json
import re
import shlex
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from command_line import flock

from llm_flock.exam.examinee import Setup
from llm_flock.exam.leaderboard import PAGE, page_text, read_rows
from llm_flock.exam.session import Paper, hold_exam

FOLDER = Path(__file__).parents[2] / "docs" / "leaderboard"
RECORDED = [row for row in read_rows(FOLDER) if row["recording"]]


def told(row: dict[str, Any]) -> dict[str, Any]:
    """What comes back: everything about the questions and the answers, but not the time that they took."""
    figures = dict(row["figures"])
    return {**figures, "use": {**figures["use"], "seconds": 0.0}}


def test_the_page_is_what_the_command_writes() -> None:
    assert (FOLDER / PAGE).read_text(encoding="utf-8") == page_text(read_rows(FOLDER)), (
        "llm-flock exam --page docs/leaderboard"
    )


def test_stand_ins_are_apart_and_labelled() -> None:
    text = (FOLDER / PAGE).read_text(encoding="utf-8")
    models, stand_ins = text.split("## Stand-ins")
    assert "simulated:" not in models and "`geometry`" not in models
    rows = [line for line in stand_ins.split("### How")[0].splitlines() if line.startswith("| `simulated:")]
    assert len(rows) >= 8 and all("*simulated*" in line for line in rows)
    named = {row["model"] for row in read_rows(FOLDER) if "total" in row["figures"] and not row["simulated"]}
    assert {"geometry", "local:smollm2", "local:smollm2+none"} <= named


@pytest.mark.parametrize("model", ["simulated:ideal", "simulated:careful", "simulated:random"])
def test_a_stand_ins_row_comes_back_from_its_command(model: str, tmp_path: Path) -> None:
    (row,) = (row for row in read_rows(FOLDER) if row["model"] == model)
    questions, _, _ = row["command"].partition(" --missions ")  # those take long, and have tests of their own
    program, *arguments = shlex.split(questions)
    assert program == "llm-flock"
    flock(*arguments, "--out", "results", "--page", "page", "--quiet", cwd=tmp_path)
    (again,) = read_rows(tmp_path / "page")
    assert told(again) == told(row)
    assert again["exam"] == row["exam"], "questions and prompts are those of the row"


@pytest.mark.parametrize("row", RECORDED, ids=[row["model"] for row in RECORDED])
def test_a_models_row_comes_back_from_its_recording(row: dict[str, Any], tmp_path: Path) -> None:
    exam = row["exam"]
    fields = {**exam["setup"], "model": f"replay:{FOLDER / row['recording']}"}
    if row["model"].startswith("local:smollm2"):
        fields |= {"prompts": "brief", "frame": "own"}
        assert "--prompts brief --frame own" in row["command"]
    words = shlex.split(row["command"])
    limit = int(words[words.index("--limit") + 1]) if "--limit" in words else None
    paper = Paper(split=exam["split"], seed=exam["seed"], limit=limit, repeats=exam["repeats"])
    again = asyncio.run(hold_exam(Setup(**fields), paper, tmp_path, today=date(2026, 1, 1)))
    assert again.row is not None
    assert told(again.row) == told(row)
    assert again.row["answered_by"] == row["answered_by"]
    assert [again.row["exam"][name] == exam[name] for name in ("questions", "prompts", "count")] == [True] * 3


def test_a_row_is_added_by_one_command(tmp_path: Path) -> None:
    line = ("exam", "simulated:overshoot", "geometry", "--limit", "2", "--out", "results", "--page", "page")
    done = flock(*line, cwd=tmp_path)
    assert "simulated:overshoot (simulated)" in done.stdout and "at first ask" in done.stdout
    assert {path.name for path in (tmp_path / "page").iterdir()} == {
        "geometry.json",
        "index.md",
        "simulated-overshoot.json",
    }
    assert "--limit 2" in (tmp_path / "page" / PAGE).read_text(encoding="utf-8")


def test_the_command_resumes_and_says_so(tmp_path: Path) -> None:
    line = ("exam", "simulated:ideal", "--sections", "step", "--limit", "4")
    cut = flock(*line, "--max-calls", "2", cwd=tmp_path, check=False)
    assert cut.returncode == 1 and "not all questions have an answer" in cut.stderr
    rest = flock(*line, cwd=tmp_path)
    assert "2 of 4 questions are answered already" in rest.stderr


def test_the_command_asks_nothing_where_it_is_told_so(tmp_path: Path) -> None:
    dry = flock("exam", "openai:gpt-5-mini", "--limit", "2", "--dry-run", "--json", cwd=tmp_path)
    (expected,) = json.loads(dry.stdout)
    assert expected["questions"] == 18 and expected["expected"]["cost_usd"] > 0
    flock("exam", "--export", "questions.jsonl", "--split", "private", "--seed", "7", "--limit", "1", cwd=tmp_path)
    assert len((tmp_path / "questions.jsonl").read_text().splitlines()) == 9
    assert {path.name for path in tmp_path.iterdir()} == {"questions.jsonl"}


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("exam", "at least one model"),
        ("exam simulated:idael", "did you mean 'ideal'"),
        ("exam simulated:ideal --sections stepp", "unknown section"),
        ("exam simulated:ideal --split private", "seed of the private split"),
        ("exam simulated:ideal --sections mission", "a section that simulated:ideal can be asked"),
        ("exam simulated:ideal --prompts brief", "simulated models understand no others"),
        ("exam replay:none --page page", "a recording is of a row that is there already"),
    ],
)
def test_wrong_input_is_refused_in_words(line: str, text: str, tmp_path: Path) -> None:
    done = flock(*line.split(), cwd=tmp_path, check=False)
    assert done.returncode == 2 and text in done.stderr, done.stderr


def test_a_row_with_an_endless_number_is_refused_in_one_line(tmp_path: Path) -> None:
    text = (FOLDER / "simulated-careful.json").read_text(encoding="utf-8")
    (tmp_path / "row.json").write_text(re.sub(r'"seconds": [0-9.e-]+', '"seconds": 1' + "0" * 400, text, count=1))
    done = flock("exam", "--page", str(tmp_path), cwd=tmp_path, check=False)
    assert done.returncode == 2 and "a row of the leaderboard" in done.stderr and done.stderr.count("\n") == 1
