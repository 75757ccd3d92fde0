"""The exam in Inspect: the same scores as without it, logs that go on where they broke off, and rows that come back."""

from __future__ import annotations

import pytest

pytest.importorskip("inspect_ai")


import asyncio
import json
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from command_line import ENV
from exam_models import Hashed
from integration.fault_server import running

from llm_flock.llm._own import OwnModel
from llm_flock.llm._prompting import PromptSet
from llm_flock_lab._exam.ask import Examiner, Outcome
from llm_flock_lab._exam.rows import Row, read_rows
from llm_flock_lab._exam.splits import paper

pytestmark = pytest.mark.skipif(find_spec("inspect_ai") is None, reason="the extra exam is not installed")

ROOT = Path(__file__).parents[4]
FOLDER = ROOT / "docs" / "leaderboard"
ROWS = {row.model: row for row in read_rows(FOLDER)}


def child(script: str, *arguments: str, cwd: Path) -> Any:
    """What a script beside the tests prints last."""
    line = [sys.executable, str(ROOT / "tests" / script), *arguments]
    env = {name: value for name, value in ENV.items() if not name.endswith("_API_KEY")}
    done = subprocess.run(line, capture_output=True, text=True, timeout=300, env=env, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def sat(tmp_path: Path, *lines: str) -> list[tuple[int, str]]:
    """Exit code and stderr of each exam."""
    return child("exam_lines.py", *lines, cwd=tmp_path)


def told(row: Row) -> Row:
    """What comes back: everything about the questions and the answers, but not when, how long, and with what."""
    update = {"seconds": 0.0, "date": "", "versions": {}, "command": "", "taught": None}
    return row.model_copy(update=update)


def test_models_of_inspect_score_as_without_it(tmp_path: Path) -> None:
    examiner, model = Examiner(PromptSet.load("full"), "world"), OwnModel(Hashed())

    async def ask() -> list[Outcome]:
        return [await examiner.ask(question, model) for question in paper(limit=6)]

    ours = asyncio.run(ask())
    found = child("exam_inspect.py", str(tmp_path), "6", cwd=tmp_path)
    assert found["status"] == "success"
    skipped = ("seconds", "tokens_input", "tokens_output", "cost_usd", "tags", "answered_by")
    assert len(ours) == len(found["outcomes"]) == 54
    for outcome in ours:
        theirs = found["outcomes"][outcome.question]
        compared = [name for name in Outcome.__slots__ if name not in skipped]
        assert {name: theirs[name] for name in compared} == {name: getattr(outcome, name) for name in compared}
    assert len({outcome.tries for outcome in ours}) == 4, "right at once, after one and two reasons, and never"
    right = [outcome.tries == 0 for outcome in ours if outcome.section == "step"]
    assert found["metrics"]["step"] == pytest.approx(sum(right) / len(right))


def test_a_stand_ins_row_comes_back_from_its_command(tmp_path: Path) -> None:
    program, command, *arguments = shlex.split(ROWS["simulated:ideal"].command)
    assert (program, command) == ("llm-flock", "exam")
    sat(tmp_path, f"{shlex.join(arguments)} --page page")
    (again,) = read_rows(tmp_path / "page")
    assert told(again) == told(ROWS["simulated:ideal"])


def test_models_rows_come_back_from_their_recordings(tmp_path: Path) -> None:
    rows = [ROWS["local:smollm2"], ROWS["local:smollm2+none"]]
    lines = [row.command.removeprefix("llm-flock exam ").replace("docs/leaderboard", str(FOLDER)) for row in rows]
    sat(tmp_path, *(f"{line} --page page" for line in lines))
    found = {row.model: row for row in read_rows(tmp_path / "page")}
    assert [told(found[row.model]) for row in rows] == [told(row) for row in rows]
    assert [found[row.model].seconds for row in rows] == [row.seconds for row in rows]


def test_an_exam_without_a_budget_left_goes_on_later(tmp_path: Path) -> None:
    line = "simulated:malformed@0.5 --sections step,place --limit 4 --repeats 2"
    ((code, errors),) = sat(tmp_path, f"{line} --max-calls 5 --page page")
    assert code == 1 and "max_calls = 5 is used up" in errors, errors
    assert not list((tmp_path / "page").glob("*.json")), "a row has no questions without an answer"
    sat(tmp_path, f"{line} --page page", f"{line} --page page", f"{line} --out whole --page other")
    (rest,) = read_rows(tmp_path / "page")
    (whole,) = read_rows(tmp_path / "other")
    assert told(rest) == told(whole) and rest.repeats == 2
    assert len(list((tmp_path / "runs/exam").glob("*.eval"))) == 1, "the log that broke off went into the whole one"


def test_a_provider_that_turns_away_is_asked_again(tmp_path: Path) -> None:
    questions = "--sections plan,step,retry,agreement --limit 3"
    with running(rate_limit=0.2, server_error=0.1, seed=3) as server:
        sat(tmp_path, f"openai-compatible:test --base-url {server.base_url} {questions} --temperature 0 --page page")
        sent = server.stats()
    assert sent["rate_limit"] and sent["server_error"]
    (row,) = read_rows(tmp_path / "page")
    assert {name: found.first.value for name, found in row.sections.items()} == dict.fromkeys(row.sections, 1.0)
    assert len(row.sections) == 4 and row.calls == 12 and row.tokens > 0 and row.cost_usd is None
    assert row.answered_by == "openai-compatible:stand-in", "what the server says of itself"
    assert row.command == f"llm-flock exam openai-compatible:test {questions} --temperature 0.0" and not row.simulated


def test_models_that_cannot_take_the_exam_are_explained(tmp_path: Path) -> None:
    said = {
        "simulated:idael": "did you mean 'ideal'",
        "simulated:ideal simulated:ideal": "each model once",
        "simulated:ideal simulated:nope": "unknown profile 'nope'",
        "simulated:ideal --sections mission": "a section that simulated:ideal can be asked",
        "simulated:ideal --prompts brief": "simulated models understand no others",
        "simulated:ideal --frame moon": "--frame moon: expected world or own",
        "openai:gpt-5-mini": "needs a key: export OPENAI_API_KEY",
        "replay:none.jsonl": "a cassette that can be read",
    }
    for text, (code, errors) in zip(said.values(), sat(tmp_path, *said), strict=True):
        assert code == 2 and text in errors and errors.count("\n") == 1, errors
