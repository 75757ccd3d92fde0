"""A directory of results: whole files only, one sweep at a time, tables that drop nothing."""

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from llm_flock.errors import InputError, RecordError
from llm_flock.llm._limits import Spent
from llm_flock.runtime._config import build_config
from llm_flock.runtime._result import Summary
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.grid import Earlier
from llm_flock_lab._experiments.store import SpendingLog, Store, read_trial, trial_files, write_whole
from llm_flock_lab._experiments.trial import TrialResult

DOCS = Path(__file__).parents[4] / "docs"


def stored(name: str, *, seed: int = 0, cell: str = "triangle/3 flock", **fields: Any) -> TrialResult:
    plain: dict[str, Any] = {
        "id": name,
        "cell": cell,
        "axes": {},
        "config": build_config(shape="triangle", n_robots=3, seed=seed).model_dump(mode="json"),
        "summary": None,
        "rounds": {column.name: [] for column in tables.ROUNDS[1:]},
        "error": "ValueError: no",
        "cut": False,
        "simulated": True,
        "code": "0",
    }
    return TrialResult(**{**plain, **fields})


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    store = Store(tmp_path)
    trial = stored("a", earlier=(Earlier(stopped="budget", model_calls=3, tokens=9, cost_usd=None),))
    store.save(trial)
    assert read_trial(store.trial_path("a")) == trial
    assert not trial.formed and trial.stopped == "failed"
    assert trial.as_earlier()[1] == Earlier(stopped="failed", model_calls=0, tokens=0, cost_usd=0.0)


def test_files_that_were_never_completed_are_passed_over(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(stored("a"))
    (tmp_path / "trials" / ".b.json.partial").write_text('{"id": "b')
    assert [path.stem for path in trial_files(tmp_path)] == ["a"]


def test_full_disk_is_told_and_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_whole(tmp_path / "x", b"old")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(RecordError, match="No space left"):
        write_whole(tmp_path / "x", b"new")
    assert (tmp_path / "x").read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("text", "reason"), [("{", "not a trial"), ('{"id": "a"}', "not a trial"), (None, "format 99")]
)
def test_damaged_and_newer_files_are_named(tmp_path: Path, text: str | None, reason: str) -> None:
    store = Store(tmp_path)
    store.save(stored("a", format=99))
    if text is not None:
        store.trial_path("a").write_text(text)
    with pytest.raises(RecordError, match=reason):
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


def test_tables_hold_every_trial_in_the_order_of_cells_and_seeds(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for name, seed, cell in (("a", 1, "circle/10"), ("b", 0, "circle/10"), ("c", 0, "circle/6")):
        store.save(stored(name, seed=seed, cell=cell, axes={"fault": "loss"}))
    found = tables.read_trials(tmp_path)
    assert found["trial"].to_list() == ["c", "b", "a"]
    assert found["formed"].to_list() == [False] * 3 and found["error"][0] == "ValueError: no"
    assert found["axis_fault"].to_list() == ["loss"] * 3
    assert found.schema == pl.Schema({c.name: c.dtype() for c in tables.TRIALS} | {"axis_fault": pl.String()})
    assert not (tmp_path / "trials.parquet").exists()


def test_the_files_hold_the_tables(tmp_path: Path) -> None:
    Store(tmp_path).save(stored("a"))
    tables.build_tables(tmp_path)
    assert tables.read_trials(tmp_path).equals(pl.read_parquet(tmp_path / "trials.parquet"))
    assert pl.read_parquet(tmp_path / "rounds.parquet").height == 0


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="directory of results"):
        tables.read_trials(tmp_path)


def test_every_figure_of_a_summary_has_its_column() -> None:
    named = {column.name for column in tables.TRIALS}
    assert set(Summary.__dataclass_fields__) - named == {"waypoints", "waypoint_shares", "flight"}, (
        "sweeps fly nothing real"
    )


def test_the_data_dictionary_is_drawn_from_the_columns() -> None:
    text = (DOCS / "reference" / "results.md").read_text(encoding="utf-8")
    assert re.findall(r"^```\{result-columns\} (\w+)$", text, re.MULTILINE) == ["trials", "rounds"]
    for column in (*tables.TRIALS, *tables.ROUNDS):
        assert column.meaning and column.kind


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
