"""What a run leaves behind when it is stopped, refused or cancelled: a readable record, or nothing."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

import llm_flock
from llm_flock.errors import InputError
from llm_flock.runtime import _trial
from llm_flock.runtime._trial import TrialProgress


def test_a_budget_stops_the_run_cleanly(tmp_path: Path) -> None:
    mission = llm_flock.Mission(shape="circle", n_robots=5)
    figures = llm_flock.run(mission, max_calls=12, seed=1, out=str(tmp_path)).summary
    assert figures.stopped == "budget"
    record = llm_flock.read_record(tmp_path / "run.mcap")
    assert record.complete and any(e.detail.get("cause") == "budget" for e in record.events)
    assert sum(entry.text is not None for entry in record.llm) == 12


def test_cancelling_leaves_a_readable_record(tmp_path: Path) -> None:

    async def scene() -> None:
        third = asyncio.Event()

        def watch(now: TrialProgress) -> None:
            if now.round == 3:
                third.set()

        running = asyncio.create_task(
            llm_flock.run_async(llm_flock.Mission(), seed=1, out=str(tmp_path), on_round=watch)
        )
        await third.wait()
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running

    asyncio.run(scene())
    record = llm_flock.read_record(tmp_path / "run.mcap")
    assert record.complete and len(record.states) >= 4
    assert record.result is not None and record.result["stopped"] == "interrupted"


def test_robots_that_wait_for_their_models_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_trial, "WAIT_S", 0.01)
    heard: list[TrialProgress] = []
    mission = llm_flock.Mission(shape="line", n_robots=2)
    llm_flock.run(mission, model="simulated:brisk", rounds=1, seed=1, on_round=heard.append)
    *late, last = heard
    assert late and not last.waiting and last.round == 1
    assert late[0].waiting == (0, 1) and late[0].text.startswith("round 1 · no answer for 0 s: 2 of 2 robots (0, 1)")
    assert [now.model_calls for now in heard] == sorted(now.model_calls for now in heard)


def test_nothing_is_written_when_something_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("")
    foreign = tmp_path.with_name("foreign")
    foreign.mkdir(exist_ok=True)
    (foreign / "step.j2").write_text("Where to?")
    for options, cause in (
        ({"record_llm": str(tmp_path / "old")}, "a file that does not exist yet"),
        ({"model": "nobody:nothing"}, "unknown provider 'nobody'"),
        ({"model": "openai:o3-mini"}, "needs a key"),
        ({"history": "some"}, "^history"),
        ({"prompts": "none"}, "expected a folder"),
        ({"prompts": str(foreign)}, "simulated models understand no others"),
    ):
        given: dict[str, Any] = {"out": str(tmp_path / "run"), "record_llm": str(tmp_path / "tape"), **options}
        with pytest.raises(InputError, match=cause):
            llm_flock.run(llm_flock.Mission(), **given)
    assert list(tmp_path.iterdir()) == [tmp_path / "old"]


def test_a_record_is_never_overwritten(tmp_path: Path) -> None:
    llm_flock.run(llm_flock.Mission(shape="line", n_robots=2), seed=1, out=str(tmp_path), rounds=1)
    with pytest.raises(InputError, match="out"):
        llm_flock.run(
            llm_flock.Mission(shape="line", n_robots=2), seed=1, out=str(tmp_path), record_llm=str(tmp_path / "tape")
        )
    assert not (tmp_path / "tape").exists()
