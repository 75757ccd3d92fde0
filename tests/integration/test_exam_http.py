"""The exam over HTTP, of a server that turns questions away: its faults are no wrong answers."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from command_line import flock
from integration.fault_server import running

from llm_flock.exam import examinee
from llm_flock.exam.results import read_results
from llm_flock.llm.limits import RetryPolicy

QUESTIONS = ("--sections", "plan,step,retry,agreement", "--limit", "5")


def test_a_provider_sits_the_exam_and_its_recording_replays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examinee, "RetryPolicy", partial(RetryPolicy, first_wait_s=0.01))
    model = "openai-compatible:test"
    with running(rate_limit=0.2, server_error=0.1, seed=3) as server:
        line = ("exam", model, "--base-url", server.base_url, *QUESTIONS, "--out", "asked", "--json")
        (row,) = json.loads(flock(*line, cwd=tmp_path).stdout)
        sent = server.stats()
    assert sent["rate_limit"] and sent["server_error"]
    assert {name: found["first"]["value"] for name, found in row["figures"]["sections"].items()} == {
        "plan": 1.0,
        "step": 1.0,
        "retry": 1.0,
        "agreement": 1.0,
    }
    assert row["simulated"] is False and row["figures"]["use"]["calls"] == 20
    assert row["answered_by"] == "openai-compatible:stand-in", "what the server says of itself"
    recording = tmp_path / "asked" / "openai-compatible-test.cassette.jsonl"
    flock("exam", f"replay:{recording}", *QUESTIONS, "--out", "again", "--quiet", cwd=tmp_path)
    (again,) = (tmp_path / "again").glob("*test.cassette.jsonl.jsonl")
    asked = read_results(tmp_path / "asked" / "openai-compatible-test.jsonl")[1]
    by_id = {outcome.question: outcome for outcome in asked}
    assert {outcome.question: outcome for outcome in read_results(again)[1]} == by_id
