"""Records that a page deletes: only what it showed, only if no process writes it, and never half."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sample_records import FakeRun, make_record

from llm_flock.errors import InputError
from llm_flock.record._writer import RecordWriter
from llm_flock_view._viewer.launcher import Launcher
from llm_flock_view._viewer.library import Library, load
from llm_flock_view._viewer.orders import PageOrders
from llm_flock_view._viewer.paths import growing_in, records_in, title_of
from llm_flock_view._viewer.run_rows import run_row


def shown(*paths: Path) -> PageOrders:
    library = Library()
    for path in paths:
        load(library.add(title_of(path), path, live=False))
    return PageOrders(library, Launcher(library, Path("runs")))


def ordered(orders: PageOrders, **order: object) -> dict[str, Any]:
    return asyncio.run(orders.carry_out(order))


def deleted(orders: PageOrders, key: object = "") -> dict[str, Any]:
    """The answer to an order that deletes the run of a key, by default the first."""
    key = next(iter(orders.library.runs), "none") if key == "" else key
    return ordered(orders, order="delete", run=key)


def record(folder: Path) -> Path:
    return make_record(folder / "run.mcap", n=2, rounds=2)


def test_a_record_goes_with_its_folder_unless_that_holds_more(tmp_path: Path) -> None:
    alone, more = record(tmp_path / "alone"), record(tmp_path / "more")
    (tmp_path / "more" / "notes.txt").write_text("mine", encoding="utf-8")
    orders = shown(alone, more)
    assert "done" in deleted(orders) and "done" in deleted(orders)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["more", "notes.txt"]
    assert not orders.library.runs


def test_a_folder_that_was_not_made_for_a_record_stays(tmp_path: Path) -> None:
    named = make_record(tmp_path / "mine" / "precious.mcap", n=2, rounds=2)
    assert "done" in deleted(shown(named))
    assert (tmp_path / "mine").is_dir() and not named.exists()


def test_records_here_and_behind_a_link_can_be_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record(tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    assert "done" in deleted(shown(Path("run.mcap")))
    record(tmp_path / "real")
    (tmp_path / "link").symlink_to("real")
    orders = shown(tmp_path / "link" / "run.mcap")
    assert "done" in deleted(orders) and not orders.library.runs
    assert (tmp_path / "real").is_dir() and not list((tmp_path / "real").iterdir())


def test_a_link_is_never_followed_to_the_file_of_somebody(tmp_path: Path) -> None:
    real = record(tmp_path / "real")
    (tmp_path / "other").mkdir()
    link = tmp_path / "other" / "run.mcap"
    link.symlink_to(real)
    orders = shown(link)
    assert run_row(next(iter(orders.library.runs.values())))["deletable"] is False
    assert "symbolic link" in deleted(orders)["error"]
    assert link.is_symlink() and real.exists() and len(orders.library.runs) == 1


def test_one_record_by_two_names_is_one_run(tmp_path: Path) -> None:
    for name in ("b", "a"):
        record(tmp_path / name)
    (tmp_path / "c").symlink_to("a")
    assert records_in([tmp_path / "c", tmp_path]) == [tmp_path / "c" / "run.mcap", tmp_path / "b" / "run.mcap"]


def test_record_being_written_by_any_process_stays(tmp_path: Path) -> None:
    path = tmp_path / "run" / "run.mcap"
    with RecordWriter(path) as writer:
        FakeRun(n=2, rounds=2).write(writer, finish=False)
        writer._file.flush()  # as after a round
        orders = shown(path)
        assert "writes this record" in deleted(orders)["error"] and path.exists()
    assert "changed since it was read" in deleted(orders)["error"], "its end came after it was read"
    assert "done" in deleted(shown(path)) and not path.exists()


@pytest.mark.parametrize(
    "change",
    [
        lambda path: path.write_bytes(path.read_bytes() + b"more"),
        lambda path: Path(shutil.copy(path, f"{path}.new")).replace(path),
    ],
    ids=["grown", "another"],
)
def test_a_record_that_is_another_by_now_stays(change: Callable[[Path], object], tmp_path: Path) -> None:
    path = record(tmp_path / "run")
    orders = shown(path)
    change(path)
    assert "changed since it was read" in deleted(orders)["error"]
    assert path.exists() and len(orders.library.runs) == 1


def test_a_record_that_is_gone_leaves_the_list(tmp_path: Path) -> None:
    path = record(tmp_path / "run")
    orders = shown(path)
    shutil.rmtree(path.parent)
    assert "done" in deleted(orders) and not orders.library.runs


def test_two_deletions_at_once_are_one(tmp_path: Path) -> None:
    orders = shown(*(record(tmp_path / name) for name in "abcd"))
    with ThreadPoolExecutor(12) as pool:
        said = list(pool.map(lambda key: deleted(orders, key), [*orders.library.runs] * 3))
    assert sum("done" in one for one in said) == 4
    assert {one["error"] for one in said if "error" in one} == {"There is no such record"}
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("key", [" ", "0", "../1", "1\0", "1 ", None, 1.5, ["1"], {"1": "1"}, True, "\uff11"])
def test_no_other_word_is_the_key_of_a_run(key: object, tmp_path: Path) -> None:
    path = record(tmp_path / "run")
    assert deleted(shown(path), key)["error"] == "There is no such record" and path.exists()


def test_a_file_that_is_no_record_is_refused_by_its_name(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("buy milk", encoding="utf-8")
    for find in (records_in, growing_in):
        with pytest.raises(
            InputError, match=r"notes.txt.* expected a record of a run \(MCAP\); this file does not begin"
        ):
            find([notes])
    cut = tmp_path / "run.mcap"
    cut.write_bytes(b"\x89MC")
    assert records_in([cut]) == growing_in([cut]) == [cut], "a run that was killed early is shown, and says so"
    later = tmp_path / "later"
    assert growing_in([later, later / "a.mcap"]) == [later / "run.mcap", later / "a.mcap"], "both may come later"


FIELDS = {"shape": "circle", "n_robots": 3, "model": "simulated:ideal", "rounds": 40, "stop_when_formed": False}


@pytest.mark.parametrize(
    ("order", "field"),
    [
        ({"order": "start", "fields": FIELDS, "pace": 10**400}, "pace"),
        ({"order": "start", "fields": FIELDS, "pace": 5, "protocols": []}, "protocols"),
        ({"order": "start", "fields": FIELDS, "pace": 5, "protocols": "flock"}, "protocols"),
        ({"order": "start", "fields": FIELDS, "pace": 5, "protocols": ["flock"] * 3}, "protocols"),
        ({"order": "start", "fields": {**FIELDS, "n_robots": 1e300}, "pace": 5}, "n_robots"),
    ],
)
def test_an_order_of_a_wrong_kind_starts_nothing(order: dict[str, Any], field: str, tmp_path: Path) -> None:
    library = Library()
    orders = PageOrders(library, Launcher(library, tmp_path / "runs"))
    said = asyncio.run(orders.carry_out(order))
    assert said["field"] == field and ("xpected" in said["error"] or "needs" in said["error"])
    assert not library.runs and not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("order", "field"),
    [
        ({"order": "pace", "pace": -(10**400)}, "pace"),
        ({"order": "lose", "loss": 10**400}, "loss"),
        ({"order": "hold", "paused": "no"}, "paused"),
        ({"order": "hold"}, "paused"),
        ({"order": "change", "fields": None}, "fields"),
        ({"order": "change", "fields": {"spacing": ""}}, "fields"),
        ({"order": "change", "fields": {"center": [1]}}, "center"),
        ({"order": "change", "fields": {"shape": "nonsense"}}, "shape"),
    ],
)
def test_an_order_of_a_wrong_kind_changes_nothing(order: dict[str, Any], field: str, tmp_path: Path) -> None:
    library = Library()
    launcher = Launcher(library, tmp_path / "runs")
    orders = PageOrders(library, launcher)
    (flight,) = launcher.start(FIELDS, pace=0.1)
    said = asyncio.run(orders.carry_out({"runs": list(library.runs), **order}))
    paused, loss, pace = flight.paused, flight.loss, flight.pace
    flight.end()
    assert said.get("field") == field, said
    assert (paused, loss, pace) == (False, 0.0, 0.1)
    assert "changes" not in said["error"].lower(), "the form has no such field"
