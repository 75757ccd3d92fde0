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
from command_line import ENV, Done, flock_process
from exam_models import Hashed
from integration.fault_server import running

from llm_flock.llm._own import OwnModel
from llm_flock.llm._prompting import PromptSet
from llm_flock_lab._exam.ask import Examiner, Outcome
from llm_flock_lab._exam.leaderboard import Row, read_rows
from llm_flock_lab._exam.splits import paper

pytestmark = pytest.mark.skipif(find_spec("inspect_ai") is None, reason="the extra exam is not installed")

CHILD = Path(__file__).parents[1] / "exam_inspect.py"
FOLDER = Path(__file__).parents[2] / "docs" / "leaderboard"
ROWS = {row.model: row for row in read_rows(FOLDER)}


def child(*arguments: str) -> dict[str, Any]:
    line = [sys.executable, str(CHILD), *arguments]
    done = subprocess.run(line, capture_output=True, text=True, timeout=300, env=ENV)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def sat(tmp_path: Path, line: str, *, check: bool = True) -> Done:
    arguments = ("exam", *shlex.split(line), "--quiet", "--page", "page")
    return flock_process(*arguments, cwd=tmp_path, check=check, timeout_s=300)


def told(row: Row) -> Row:
    """What comes back: everything about the questions and the answers, but not when, how long, and with what."""
    update = {"seconds": 0.0, "date": "", "versions": {}, "command": "", "taught": None}
    return row.model_copy(update=update)


def test_models_of_inspect_score_as_without_it(tmp_path: Path) -> None:
    examiner, model = Examiner(PromptSet.load("full"), "world"), OwnModel(Hashed())

    async def ask() -> list[Outcome]:
        return [await examiner.ask(question, model) for question in paper(limit=6)]

    ours = asyncio.run(ask())
    found = child(str(tmp_path), "6")
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
    sat(tmp_path, shlex.join(arguments))
    (again,) = read_rows(tmp_path / "page")
    assert told(again) == told(ROWS["simulated:ideal"])


@pytest.mark.parametrize("model", ["local:smollm2", "local:smollm2+none"])
def test_a_models_row_comes_back_from_its_recording(model: str, tmp_path: Path) -> None:
    row = ROWS[model]
    sat(tmp_path, row.command.removeprefix("llm-flock exam ").replace("docs/leaderboard", str(FOLDER)))
    (again,) = read_rows(tmp_path / "page")
    assert told(again) == told(row) and again.seconds == row.seconds


def test_an_exam_without_a_budget_left_goes_on_later(tmp_path: Path) -> None:
    line = "simulated:malformed@0.5 --sections step,place --limit 4 --repeats 2"
    cut = sat(tmp_path, f"{line} --max-calls 5", check=False)
    assert cut.returncode == 1 and "max_calls = 5 is used up" in cut.stderr, cut.stderr
    assert not list((tmp_path / "page").glob("*.json")), "a row has no questions without an answer"
    sat(tmp_path, line)
    sat(tmp_path, line)
    (rest,) = read_rows(tmp_path / "page")
    sat(tmp_path, f"{line} --out whole")
    (whole,) = read_rows(tmp_path / "page")
    assert told(rest) == told(whole) and rest.repeats == 2
    assert len(list((tmp_path / "runs/exam").glob("*.eval"))) == 1, "the log that broke off went into the whole one"


def test_a_provider_that_turns_away_is_asked_again(tmp_path: Path) -> None:
    questions = "--sections plan,step,retry,agreement --limit 3"
    with running(rate_limit=0.2, server_error=0.1, seed=3) as server:
        sat(tmp_path, f"openai-compatible:test --base-url {server.base_url} {questions} --temperature 0")
        sent = server.stats()
    assert sent["rate_limit"] and sent["server_error"]
    (row,) = read_rows(tmp_path / "page")
    assert {name: found.first.value for name, found in row.sections.items()} == dict.fromkeys(row.sections, 1.0)
    assert len(row.sections) == 4 and row.calls == 12 and row.tokens > 0 and row.cost_usd is None
    assert row.answered_by == "openai-compatible:stand-in", "what the server says of itself"
    assert row.command == f"llm-flock exam openai-compatible:test {questions} --temperature 0.0" and not row.simulated


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("simulated:idael", "did you mean 'ideal'"),
        ("simulated:ideal simulated:ideal", "each model once"),
        ("simulated:ideal simulated:nope", "unknown profile 'nope'"),
        ("simulated:ideal --sections mission", "a section that simulated:ideal can be asked"),
        ("simulated:ideal --prompts brief", "simulated models understand no others"),
        ("simulated:ideal --frame moon", "--frame moon: expected world or own"),
        ("openai:gpt-5-mini", "needs a key: export OPENAI_API_KEY"),
        ("replay:none.jsonl", "a cassette that can be read"),
    ],
)
def test_models_that_cannot_sit_are_refused_in_words(line: str, text: str, tmp_path: Path) -> None:
    done = sat(tmp_path, line, check=False)
    assert done.returncode == 2 and text in done.stderr, done.stderr
    assert done.stderr.count("\n") == 1
