"""Examples from recorded conversations: only first answers that passed."""

from pathlib import Path
from typing import Any

import pytest

import llm_flock
from llm_flock.errors import InputError
from llm_flock.mission import build_mission
from llm_flock_onboard._distill.examples import RECORDED, recorded_examples


def test_answers_that_passed_at_first_ask_become_examples(tmp_path: Path) -> None:
    mission = build_mission(shape="triangle", n_robots=3)
    tape = tmp_path / "tape.jsonl"
    llm_flock.run(mission, seed=1, model="simulated:overshoot@0.3", frame="own", rounds=6, record_llm=str(tape))
    found = list(recorded_examples(tape))
    text = tape.read_text()
    assert 0 < len(found) < len(text.splitlines()) - 1, "some were sent back"
    assert {example.kind for example in found} == {"plan", "step"} and found[0].team == RECORDED
    for example in found:
        assert example.answer == example.answer.strip() and ("Position:" in example.answer) != (
            "Plan:" in example.answer
        )
        assert "Your position: [0.000, 0.000]" in example.user or example.kind == "plan"
        assert "cannot be used" not in example.user


def test_paths_are_told_from_steps_and_remembered_exchanges_are_left_out(tmp_path: Path) -> None:
    mission = build_mission(shape="triangle", n_robots=3)
    kinds: dict[str, dict[str, Any]] = {"a": {"decide": "on-event"}, "b": {"history": "full"}}
    for name, options in kinds.items():
        llm_flock.run(mission, seed=1, rounds=4, record_llm=str(tmp_path / name), **options)
    assert {example.kind for example in recorded_examples(tmp_path / "a")} == {"plan", "path"}
    assert {example.kind for example in recorded_examples(tmp_path / "b")} == {"plan"}


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad").write_text('{"llm_flock_cassette": 1}\n{"robot": 1}\n')
    for name in ("bad", "missing"):
        with pytest.raises(InputError, match="cassette"):
            list(recorded_examples(tmp_path / name))
    for content in ("", "buy milk", "buy milk\n", "null\n", '{"llm_flock_cassette": 9}\n', "[" * 100_000 + "\n"):
        (tmp_path / "other").write_text(content)
        with pytest.raises(InputError, match=r"cassette = .*other.* expected a recording of --record-llm"):
            list(recorded_examples(tmp_path / "other"))


def test_a_recording_of_a_run_that_was_killed_is_used_up_to_its_last_whole_line(tmp_path: Path) -> None:
    tape = tmp_path / "tape.jsonl"
    mission = build_mission(shape="triangle", n_robots=3)
    llm_flock.run(mission, seed=1, rounds=3, record_llm=str(tape))
    whole = list(recorded_examples(tape))
    tape.write_text(tape.read_text()[:-5])
    assert list(recorded_examples(tape)) == whole[:-1]
