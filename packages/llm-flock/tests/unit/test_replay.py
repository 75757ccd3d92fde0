"""Cassettes: what is written is what is answered, and drift or damage is said clearly."""

from __future__ import annotations

import asyncio
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from llm_flock.errors import BudgetExceeded, InputError, ModelError, RecordError, ReplayDrift
from llm_flock.llm._port import Attempt, Call, ChatMessage, Reply, Usage
from llm_flock.llm._replay import CassetteLine, CassetteWriter, ReplayModel


def call(robot: int = 0, round: int = 0, attempt: int = 0, text: str = "Where to?", **changes: Any) -> Call:
    values: dict[str, Any] = {"kind": "step", "schema": None, **changes}
    messages = (ChatMessage("system", "You are a robot.\nBe brief."), ChatMessage("user", text))
    return Call(robot=robot, round=round, attempt=attempt, messages=messages, **values)


def answered(question: Call, text: str = "Position: [1, 2]") -> Attempt:
    reply = Reply(
        text=text,
        model="openai:o3-mini-2025",
        settings={"temperature": 0.1},
        usage=Usage(input=100, output=7, cached=64),
        cost_usd=0.1 + 0.2,
        latency_s=1 / 3,
        faults=("rate_limit", "server"),
    )
    return Attempt(call=question, reply=reply, parsed={"waypoint": [1.0, 2.0]})


def failed(question: Call, kind: str, faults: tuple[str, ...] = ()) -> Attempt:
    reply = Reply(text="", model="openai:o3-mini", faults=faults, latency_s=2.0)
    return Attempt(call=question, reply=reply, error=(kind, "so it was"))


def record(path: Path, *attempts: Attempt) -> Path:
    with CassetteWriter(path) as writer:
        for attempt in attempts:
            writer(attempt)
    return path


def ask(path: Path, question: Call) -> Reply:
    with ReplayModel(path) as model:
        return asyncio.run(model.ask(question))


def test_answers_come_back_exactly_in_any_order(tmp_path: Path) -> None:
    wild = "\x00 \u2028 \r\n```json {} ``` ☃"
    attempts = [answered(call(robot=r, round=t), f"{wild} {r} {t}") for t in range(3) for r in range(4)]
    path = record(tmp_path / "a.jsonl", *attempts)
    with ReplayModel(path) as model:
        assert len(model._offsets) == 12
        assert model.name == f"replay:{path}"
        assert model.models == {"openai:o3-mini-2025"}
        for attempt in reversed(attempts):
            assert asyncio.run(model.ask(attempt.call)) == attempt.reply


def test_end_reason_of_an_answer_is_kept(tmp_path: Path) -> None:
    attempt = answered(call())
    cut = replace(attempt, reply=replace(attempt.reply, finish_reason="length", thought=True))
    path = record(tmp_path / "a.jsonl", cut)
    reply = ask(path, call())
    assert (reply.finish_reason, reply.thought) == ("length", True)


def test_each_attempt_has_its_own_answer(tmp_path: Path) -> None:
    first = answered(call(attempt=0), "nonsense")
    second = answered(call(attempt=1, text="Again, please."), "better")
    path = record(tmp_path / "a.jsonl", first, second)
    assert ask(path, second.call).text == "better"
    assert ask(path, first.call).text == "nonsense"


def test_lines_are_as_documented(tmp_path: Path) -> None:
    schema = {"type": "object"}
    path = record(tmp_path / "a.jsonl", answered(call(schema=schema)), failed(call(round=1), "timeout"))
    header, one, two = path.read_text().splitlines()
    assert json.loads(header) == {"llm_flock_cassette": 1}
    line = CassetteLine.model_validate_json(one)
    assert line.answer_schema == schema
    assert line.parsed == {"waypoint": [1.0, 2.0]}
    assert line.request_hash == call(schema=schema).request_hash
    assert json.loads(two)["text"] is None and json.loads(two)["latency_s"] == 2.0


@pytest.mark.parametrize("kind", ["timeout", "server", "refused"])
def test_an_error_happens_again(tmp_path: Path, kind: str) -> None:
    path = record(tmp_path / "a.jsonl", failed(call(), kind, ("server", kind)))
    with pytest.raises(ModelError) as caught:
        ask(path, call())
    assert (caught.value.kind, caught.value.detail, caught.value.faults) == (kind, "so it was", ("server", kind))


def test_a_used_up_budget_is_used_up_again(tmp_path: Path) -> None:
    path = record(tmp_path / "a.jsonl", failed(call(), "timeout"), failed(call(robot=1), "budget"))
    with ReplayModel(path) as model:
        with pytest.raises(ModelError, match="timeout"):
            asyncio.run(model.ask(call()))
        assert not model.exhausted
        with pytest.raises(BudgetExceeded, match="so it was"):
            asyncio.run(model.ask(call(robot=1)))
        assert model.exhausted


@pytest.mark.parametrize(
    ("asked", "shows"),
    [
        (call(text="Where from?"), ["-Where to?", "+Where from?"]),
        (call(kind="plan"), ["-kind: step", "+kind: plan"]),
        (call(schema={"type": "object"}), ['+[schema] {"type": "object"}']),
    ],
)
def test_drift_shows_the_difference(tmp_path: Path, asked: Call, shows: list[str]) -> None:
    path = record(tmp_path / "a.jsonl", answered(call()))
    with pytest.raises(ReplayDrift) as caught:
        ask(path, asked)
    lines = str(caught.value).splitlines()
    assert "robot 0, round 0, attempt 0" in lines[0]
    for text in shows:
        assert text in lines


def test_a_long_difference_is_cut(tmp_path: Path) -> None:
    path = record(tmp_path / "a.jsonl", answered(call()))
    with pytest.raises(ReplayDrift) as caught:
        ask(path, call(text="\n".join("x" * 10_000 for _ in range(1000))))
    assert len(str(caught.value)) < 2_000


def test_a_question_that_was_never_asked_is_drift(tmp_path: Path) -> None:
    path = record(tmp_path / "a.jsonl", answered(call(round=2)), answered(call(round=5)))
    with pytest.raises(ReplayDrift, match="rounds 2 to 5"):
        ask(path, call(round=6))
    with pytest.raises(ReplayDrift, match="holds nothing of this robot"):
        ask(path, call(robot=1))


def test_cassette_cut_off_in_its_last_line_loses_only_that(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    whole = record(tmp_path / "whole.jsonl", answered(call()), answered(call(round=1))).read_bytes()
    last = whole.rstrip(b"\n").rfind(b"\n") + 1
    path = tmp_path / "cut.jsonl"
    for size in range(last + 1, len(whole) - 1, 7):
        path.write_bytes(whole[:size])
        with ReplayModel(path) as model:
            assert len(model._offsets) == 1
    assert "line 3 was cut off" in caplog.text
    path.write_bytes(whole[:-1])  # only the line break is missing: nothing is lost
    with ReplayModel(path) as model:
        assert len(model._offsets) == 2


def test_other_damage_names_the_line(tmp_path: Path) -> None:
    path = record(tmp_path / "a.jsonl", answered(call()), answered(call(round=1)))
    header, one, two = path.read_text().splitlines()
    for damaged, says in [
        ([header, one[:50], two], "line 2: damaged"),
        ([header, one, two.replace('"round":1', '"round":"one"')], "line 3: damaged: round"),
        ([header, one, two.replace('"robot"', '"robots"')], "line 3: damaged: robot"),
        (
            [header, one, re.sub(r'"settings":{.*?}', f'"settings":{{"a":{"[" * 80 + "]" * 80}}}', two)],
            "line 3: damaged: settings",
        ),
        ([header, one, re.sub(r'"settings":{.*?}', f'"settings":{{"a":{10**400}}}', two)], "line 3: damaged: "),
        ([header, one, re.sub(r'"input":\d+', f'"input":{2**60}', two)], "line 3: damaged: usage"),
        ([header, one, re.sub(r'"latency_s":[^,]*', '"latency_s":1.7e308', two)], "line 3: damaged: latency_s"),
        ([header, one, re.sub(r'"cost_usd":[^,]*', '"cost_usd":1e999', two)], "line 3: damaged: cost_usd"),
        ([header, one, one], "line 3: robot 0, round 0, attempt 0 is there twice"),
        ([one, two], "not a cassette"),
        ([], "not a cassette"),
        (["[]"], "not a cassette"),
        (['{"llm_flock_cassette":2}'], "cassette version 2"),
    ]:
        path.write_text("".join(line + "\n" for line in damaged))
        with pytest.raises(RecordError, match=says):
            ReplayModel(path)


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        ReplayModel(tmp_path / "missing.jsonl")
    assert caught.value.field == "model"
    path = record(tmp_path / "a.jsonl", answered(call()))
    before = path.read_bytes()
    for bad in (path, tmp_path / "no" / "folder.jsonl"):
        with pytest.raises(InputError) as caught:
            CassetteWriter(bad)
        assert caught.value.field == "record_llm"
    assert path.read_bytes() == before


def test_every_line_is_on_disk_as_soon_as_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    with CassetteWriter(path) as writer:
        for number in range(3):
            writer(answered(call(round=number)))
            with ReplayModel(path) as model:
                assert len(model._offsets) == number + 1
