"""The task of Inspect and `llm-flock exam` agree question by question, with the same answers."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from datetime import date
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from exam_inspect import answer

from llm_flock.exam.ask import Outcome
from llm_flock.exam.examinee import Setup
from llm_flock.exam.session import Paper, hold_exam
from llm_flock.llm.own import OwnModel
from llm_flock.llm.port import Call

CHILD = Path(__file__).parents[1] / "exam_inspect.py"


class Hashed:
    simulated = True

    async def ask(self, call: Call) -> str:
        return answer([(message.role, message.text) for message in call.messages])


@pytest.mark.skipif(find_spec("inspect_ai") is None, reason="the extra exam is not installed")
def test_the_task_agrees_with_the_command(tmp_path: Path) -> None:
    setup, own = Setup(model="test:Hashed"), OwnModel(Hashed())
    ours = asyncio.run(hold_exam(setup, Paper(limit=6), tmp_path / "ours", own=own, today=date(2026, 1, 1))).outcomes
    line = [sys.executable, str(CHILD), str(tmp_path / "theirs"), "6"]
    done = subprocess.run(line, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["status"] == "success"

    def told(fields: dict[str, Any]) -> dict[str, Any]:
        skipped = ("seconds", "tokens_input", "tokens_output", "cost_usd", "tags")
        return {name: value for name, value in fields.items() if name not in skipped}

    assert len(ours) == len(found["outcomes"]) == 54
    for outcome in ours:
        assert told(found["outcomes"][outcome.question]) == told({f: getattr(outcome, f) for f in Outcome.__slots__})
    assert len({outcome.tries for outcome in ours}) == 4, "right at once, after one and two reasons, and never"
    right = [outcome.tries == 0 for outcome in ours if outcome.section == "step"]
    assert found["metrics"]["step"] == pytest.approx(sum(right) / len(right))
