"""Examples from recorded conversations: only first answers that passed."""

from pathlib import Path

import pytest

import llm_flock
from llm_flock.distill.examples import RECORDED, recorded_examples
from llm_flock.errors import InputError
from llm_flock.mission import build_mission


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
    for name, options in {"a": {"decide": "on-event"}, "b": {"history": "full"}}.items():
        llm_flock.run(mission, seed=1, rounds=4, record_llm=str(tmp_path / name), **options)
    assert {example.kind for example in recorded_examples(tmp_path / "a")} == {"plan", "path"}
    assert {example.kind for example in recorded_examples(tmp_path / "b")} == {"plan"}


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad").write_text('{"llm_flock_cassette": 1}\n{"robot": 1}\n')
    for name in ("bad", "missing"):
        with pytest.raises(InputError, match="cassette"):
            list(recorded_examples(tmp_path / name))
    (tmp_path / "empty").write_text("")
    with pytest.raises(InputError, match="cassette"):
        list(recorded_examples(tmp_path / "empty"))
