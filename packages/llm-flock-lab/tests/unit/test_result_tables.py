"""The tables of results hold every trial, and a column for every figure."""

from __future__ import annotations

import re
from pathlib import Path

import polars as pl
import pytest
from sample_results import summary
from sample_trials import stored_trial

from llm_flock.errors import InputError, RecordError
from llm_flock.runtime._result import Summary
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.store import Store
from llm_flock_lab._experiments.sweep import PLAN_NAME
from llm_flock_lab._report.results import Results

DOCS = Path(__file__).parents[4] / "docs"
NOT_IN_TABLES = {"waypoints", "waypoint_shares", "flight"}  # lists, and what only flights fill


def test_tables_hold_every_trial_in_the_order_of_cells_and_seeds(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for name, seed, cell in (("a", 1, "circle/10"), ("b", 0, "circle/10"), ("c", 0, "circle/6")):
        store.save(stored_trial(name, seed=seed, cell=cell, axes={"fault": "loss"}))
    found = tables.read_trials(tmp_path)
    assert found["trial"].to_list() == ["c", "b", "a"]
    assert found["formed"].to_list() == [False] * 3 and found["error"][0] == "ValueError: no"
    assert found["axis_fault"].to_list() == ["loss"] * 3
    assert found.schema == pl.Schema({c.name: c.dtype() for c in tables.TRIALS} | {"axis_fault": pl.String()})
    assert not (tmp_path / "trials.parquet").exists()


def test_the_files_hold_the_tables(tmp_path: Path) -> None:
    Store(tmp_path).save(stored_trial("a"))
    tables.build_tables(tmp_path)
    assert tables.read_trials(tmp_path).equals(pl.read_parquet(tmp_path / "trials.parquet"))
    assert pl.read_parquet(tmp_path / "rounds.parquet").height == 0


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="directory of results"):
        tables.read_trials(tmp_path)


def test_values_that_no_column_holds_are_refused(tmp_path: Path) -> None:
    """Polars took minutes and gigabytes to say so of nested lists."""
    deep: list[object] = []
    for _ in range(500):
        deep = [deep]
    store = Store(tmp_path)
    store.save(stored_trial("a", summary=summary(missions=[], rounds=deep)))
    with pytest.raises(RecordError, match="a list or a table as a value"):
        tables.read_trials(tmp_path)


def test_a_trial_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = Store(tmp_path).trial_path("a")
    path.write_bytes(b'{"id": "\xff"}')
    with pytest.raises(RecordError, match="not a trial"):
        tables.read_trials(tmp_path)


@pytest.mark.parametrize("plan", [b"{}", b'{"\xff": []}'])
def test_a_plan_of_no_trial_changes_no_order(plan: bytes, tmp_path: Path) -> None:
    Store(tmp_path).save(stored_trial("a"))
    (tmp_path / PLAN_NAME).write_bytes(plan)
    assert [trial.id for trial in Results.read(tmp_path).trials] == ["a"]


def test_every_figure_of_a_summary_has_its_column() -> None:
    columns = {column.name for column in tables.TRIALS}
    assert set(Summary.__dataclass_fields__) - columns <= NOT_IN_TABLES


def test_the_data_dictionary_is_drawn_from_the_columns() -> None:
    text = (DOCS / "reference" / "results.md").read_text(encoding="utf-8")
    assert re.findall(r"^```\{result-columns\} (\w+)$", text, re.MULTILINE) == ["trials", "rounds"]
    for column in (*tables.TRIALS, *tables.ROUNDS):
        assert column.meaning and column.kind
