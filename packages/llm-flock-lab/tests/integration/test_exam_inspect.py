"""The exam in Inspect: the same scores as without it, logs that go on where they broke off, and rows that come back."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from dataclasses import dataclass
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


LEFT = "simulated:malformed@0.5 --sections step,place --limit 4 --repeats 2"
ASKED = "--sections plan,step,retry,path --limit 3"
RECORDED = [row for row in ROWS.values() if "replay:" in row.command]
CANNOT = {
    "simulated:idael": "did you mean 'ideal'",
    "simulated:ideal simulated:ideal": "each model once",
    "simulated:ideal simulated:nope": "unknown profile 'nope'",
    "simulated:ideal --prompts brief": "simulated models understand no others",
    "simulated:ideal --frame moon": "--frame moon: expected world or own",
    "openai:gpt-5-mini": "needs a key: export OPENAI_API_KEY",
    "replay:none.jsonl": "a cassette that can be read",
}


def command_of(row: Row) -> str:
    assert row.command.startswith("llm-flock exam ")
    return row.command.removeprefix("llm-flock exam ").replace("docs/leaderboard", str(FOLDER)) + " --page page"


@dataclass(frozen=True, slots=True)
class Sat:
    """Exams that were taken, each kind in a folder of its own."""

    folder: Path
    said: dict[str, list[tuple[int, str]]]  # exit code and stderr of each line
    by_inspect: dict[str, Any]
    server: dict[str, int]

    def rows(self, page: str) -> dict[str, Row]:
        return {row.model: row for row in read_rows(self.folder / page)}


@pytest.fixture(scope="module")
def sat(tmp_path_factory: pytest.TempPathFactory) -> Sat:
    """All exams in one process, as importing Inspect takes longer than most of them."""
    folder = tmp_path_factory.mktemp("exams")
    with running(rate_limit=0.2, server_error=0.1, seed=3) as server:
        lines = {
            "geometry": [command_of(ROWS["geometry"])],
            "recorded": [command_of(row) for row in RECORDED],
            "left": [
                f"{LEFT} --max-calls 5 --page cut",
                *[f"{LEFT} --page page"] * 2,
                f"{LEFT} --out whole --page other",
            ],
            "server": [f"openai-compatible:test --base-url {server.base_url} {ASKED} --temperature 0 --page page"],
            "cannot": list(CANNOT),
        }
        env = {name: value for name, value in ENV.items() if not name.endswith("_API_KEY")}
        command = [sys.executable, str(ROOT / "tests" / "exam_inspect.py"), json.dumps(lines), "6"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, env=env, cwd=folder)
        assert done.returncode == 0, done.stderr
        said, by_inspect = json.loads(done.stdout.splitlines()[-1])
        return Sat(folder, said, by_inspect, server.stats())


def told(row: Row) -> Row:
    """What comes back: everything about the questions and the answers, but not when, how long, and with what."""
    update = {"seconds": 0.0, "date": "", "versions": {}, "command": "", "taught": None}
    return row.model_copy(update=update)


def test_models_of_inspect_score_as_without_it(sat: Sat) -> None:
    examiner, model, found = Examiner(PromptSet.load("full"), "world"), OwnModel(Hashed()), sat.by_inspect

    async def ask() -> list[Outcome]:
        return [await examiner.ask(question, model) for question in paper(limit=6)]

    ours = asyncio.run(ask())
    assert found["status"] == "success"
    skipped = ("seconds", "tokens_input", "tokens_output", "cost_usd", "tags", "answered_by")
    assert len(ours) == len(found["outcomes"]) == 66
    for outcome in ours:
        theirs = found["outcomes"][outcome.question]
        compared = [name for name in Outcome.__slots__ if name not in skipped]
        assert {name: theirs[name] for name in compared} == {name: getattr(outcome, name) for name in compared}
    assert len({outcome.tries for outcome in ours}) == 4, "right at once, after one and two reasons, and never"
    right = [outcome.tries == 0 for outcome in ours if outcome.section == "step"]
    assert found["metrics"]["step"] == pytest.approx(sum(right) / len(right))


def test_a_stand_ins_row_comes_back_from_its_command(sat: Sat) -> None:
    (again,) = sat.rows("geometry/page").values()
    assert told(again) == told(ROWS["geometry"])


def test_models_rows_come_back_from_their_recordings(sat: Sat) -> None:
    found = sat.rows("recorded/page")
    assert [told(found[row.model]) for row in RECORDED] == [told(row) for row in RECORDED]
    assert [found[row.model].seconds for row in RECORDED] == [row.seconds for row in RECORDED]


def test_an_exam_without_a_budget_left_goes_on_later(sat: Sat) -> None:
    (code, errors), *_ = sat.said["left"]
    assert code == 1 and "max_calls = 5 is used up" in errors, errors
    assert not list((sat.folder / "left/cut").glob("*.json")), "a row has no questions without an answer"
    (rest,), (whole,) = sat.rows("left/page").values(), sat.rows("left/other").values()
    assert told(rest) == told(whole) and rest.repeats == 2
    assert len(list((sat.folder / "left/runs/exam").glob("*.eval"))) == 1, "the log that broke off is in the whole one"


def test_a_provider_that_turns_away_is_asked_again(sat: Sat) -> None:
    assert sat.server["rate_limit"] and sat.server["server_error"]
    (row,) = sat.rows("server/page").values()
    assert {name: found.first.value for name, found in row.sections.items()} == dict.fromkeys(row.sections, 1.0)
    assert len(row.sections) == 4 and row.calls == 12 and row.tokens > 0 and row.cost_usd is None
    assert row.answered_by == "openai-compatible:stand-in", "what the server says of itself"
    assert row.command == f"llm-flock exam openai-compatible:test {ASKED} --temperature 0.0" and not row.simulated


def test_models_that_cannot_take_the_exam_are_explained(sat: Sat) -> None:
    for text, (code, errors) in zip(CANNOT.values(), sat.said["cannot"], strict=True):
        assert code == 2 and text in errors and errors.count("\n") == 1, errors
