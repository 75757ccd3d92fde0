"""A directory of results: whole files only, one sweep at a time."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sample_trials import stored_trial

from llm_flock.errors import InputError, RecordError
from llm_flock.llm._limits import Spent
from llm_flock_lab._cli.report import report
from llm_flock_lab._experiments.grid import Earlier
from llm_flock_lab._experiments.store import SpendingLog, Store, read_trial, trial_files, write_whole


def test_saved_trial_is_loaded_unchanged(tmp_path: Path) -> None:
    store = Store(tmp_path)
    trial = stored_trial("a", earlier=(Earlier(stopped="budget", model_calls=3, tokens=9, cost_usd=None),))
    store.save(trial)
    assert read_trial(store.trial_path("a")) == trial
    assert not trial.formed and trial.stopped == "failed"
    assert trial.as_earlier()[1] == Earlier(stopped="failed", model_calls=0, tokens=0, cost_usd=0.0)


def test_files_that_were_never_completed_are_passed_over(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(stored_trial("a"))
    (tmp_path / "trials" / ".b.json.partial").write_text('{"id": "b')
    assert [path.stem for path in trial_files(tmp_path)] == ["a"]


def test_full_disk_is_reported_and_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_whole(tmp_path / "x", b"old")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(RecordError, match="No space left"):
        write_whole(tmp_path / "x", b"new")
    assert (tmp_path / "x").read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("text", ["{", '{"id": "a"}'])
def test_damaged_trial_is_refused(text: str, tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(stored_trial("a"))
    store.trial_path("a").write_text(text)
    with pytest.raises(RecordError, match="not a trial"):
        read_trial(store.trial_path("a"))


def test_trial_of_a_newer_format_is_refused(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(stored_trial("a", format=99))
    with pytest.raises(RecordError, match="format 99"):
        read_trial(store.trial_path("a"))


def test_a_directory_of_a_killed_sweep_is_free_again(tmp_path: Path) -> None:
    store = Store(tmp_path)
    (tmp_path / "lock").touch()
    with store.held(), pytest.raises(InputError, match="no other sweep"), Store(tmp_path).held():
        pass
    with store.held():
        pass


def test_a_session_knows_what_those_before_it_have_spent(tmp_path: Path) -> None:
    store = Store(tmp_path)
    one, two = SpendingLog(store), SpendingLog(store)
    one.write(Spent(calls=2, tokens=10, cost_usd=0.5))
    two.write(Spent(calls=1, tokens=1))
    assert one.before == Spent() and SpendingLog(store).before == Spent(calls=3, tokens=11, cost_usd=0.5)


def test_many_may_write_one_file_at_once(tmp_path: Path) -> None:
    path, data = tmp_path / "table", [bytes([k]) * 200_000 for k in range(8)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda each: [write_whole(path, each) for _ in range(5)], data))
    assert path.read_bytes() in data
    assert list(tmp_path.iterdir()) == [path]


def test_damaged_spending_is_named(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for data in (b'{"calls":"x"}', b"[" * 100_000, b"\xff"):
        (tmp_path / "spent" / "x.json").write_bytes(data)
        with pytest.raises(RecordError, match=r"x\.json"):
            SpendingLog(store)


@pytest.mark.parametrize(
    "left", ['{"calls":-999999,"tokens":0,"cost_usd":0.0}', '{"cost_usd":-1.0}', '{"tokens":1e300}']
)
def test_no_file_gives_a_sweep_its_budget_back(left: str, tmp_path: Path) -> None:
    store = Store(tmp_path)
    (tmp_path / "spent" / "a.json").write_text(left)
    with pytest.raises(RecordError, match="what a session has spent"):
        SpendingLog(store)


def test_a_lock_follows_no_link_and_waits_for_no_pipe(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("mine")
    store = Store(tmp_path / "results")
    (tmp_path / "results" / "lock").symlink_to(precious)
    with pytest.raises(InputError, match="a file of its own"), store.held():
        pass
    assert precious.read_text() == "mine"
    (tmp_path / "results" / "lock").unlink()
    os.mkfifo(tmp_path / "results" / "lock")
    with store.held():
        pass


@pytest.mark.parametrize("name", ["trials", "records", "spent"])
def test_a_linked_folder_of_results_is_refused(name: str, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / name).symlink_to(elsewhere)
    with pytest.raises(InputError, match="not a link"):
        Store(tmp_path / "results")


def test_a_report_is_written_through_no_link_of_a_stranger(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "report").symlink_to(elsewhere)
    with pytest.raises(InputError, match="not a link"):
        report(tmp_path / "results")
    assert not list(elsewhere.iterdir())
