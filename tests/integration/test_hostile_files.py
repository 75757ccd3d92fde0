"""Hostile but legal records and results are shown or rejected in one line, and reach nothing outside their folder.

They are made from the types that read them (`hostile.py`). Drawings take long, so that few of them are drawn.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from audit import kept_inside
from hostile import Hostile, damaged, drawn, seeds, toml
from mangled import tried
from mcap.writer import Writer
from sample_records import FakeRun, make_record
from sample_results import trial

from llm_flock.cli._display import show_conversation, show_overview
from llm_flock.errors import FlockError, InputError, RecordError
from llm_flock.llm import Spent
from llm_flock.record._reader import read_record
from llm_flock.record._schema import CHANNELS, ROUND_NS, TOPICS, BodySample, Entry, FlightEvent
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._result import Summary
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.store import SpendingLog, Store
from llm_flock_lab._experiments.sweep import PLAN_NAME, SWEEP_NAME
from llm_flock_lab._experiments.sweep_file import SweepFile
from llm_flock_lab._experiments.trial import TrialResult
from llm_flock_lab._report.gallery import gallery
from llm_flock_lab._report.page import write_report
from llm_flock_lab._report.results import Results
from llm_flock_swarm._cli.accusations import show_accusations
from llm_flock_view._figures import figures
from llm_flock_view._figures.animation import animate
from llm_flock_view._foxglove.file import write_file
from llm_flock_view._viewer import data, events
from llm_flock_view._viewer.library import Library, load
from llm_flock_view._viewer.mind import mind
from llm_flock_view._viewer.replay_page import write_page

PARTS = 4
parts = pytest.mark.parametrize("part", range(PARTS))
CASES = 200
DRAWN_S = 20.0
"""Longest time for a drawing [s]."""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Tests run in a folder of their own, with bait in it and beside it."""
    with kept_inside(tmp_path, monkeypatch) as folder:
        yield folder


# --- records ----------------------------------------------------------------------------------------------------------


class Kept(list[Entry]):
    """A sink that keeps entries."""

    def write(self, entry: Entry) -> None:
        self.append(entry)


def good_entries() -> list[tuple[type[Entry], dict[str, Any]]]:
    """The entries of a flight of three robots, of every kind."""
    sink = Kept()
    FakeRun(n=3, rounds=2).write(sink)
    places = [[1.0, 2.0, 1.0]] * 3
    body = BodySample(
        round=1, time_s=1.0, measured=places, commanded=places, flying=[True] * 3, battery_v=[3.7] * 3, link=[1.0] * 3
    )
    sink[-1:-1] = [body, FlightEvent(round=1, time_s=1.0, kind="landed", robot=0, detail={})]
    assert {type(entry) for entry in sink} == set(CHANNELS.values())
    return [(type(entry), entry.model_dump(mode="json", exclude_none=True)) for entry in sink]


def write_record(path: Path, entries: list[tuple[type[Entry], dict[str, Any]]], rng: random.Random) -> None:
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=rng.random() < 0.3)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {topic: writer.register_channel(topic, "json", schema) for topic in CHANNELS}
        for number, (kind, fields) in enumerate(entries):
            body = json.dumps(fields, ensure_ascii=rng.random() < 0.5).encode("utf-8", "surrogatepass")
            writer.add_message(channels[TOPICS[kind]], number * ROUND_NS, body, 0)
        writer.finish()
    path.write_bytes(damaged(path.read_bytes(), rng))


def inspected(path: Path) -> None:
    found = read_record(path)
    show_overview(found)
    show_accusations(found, keys=None)
    found.diagnosis()
    for table in ("rounds", "robots"):
        found.to_polars(table)
    if any(call.robot == 1 for call in found.llm):
        show_conversation(found, 1, None)


def watched(path: Path) -> bool:
    library = Library()
    run = library.add("run", path, live=False)
    load(run)
    for name in ("about", "news", "frames"):
        assert data.answer(library, f"/data/{run.key}/{name}", {"count": "9"})
    if not run.ready:
        assert run.failure
        return False
    assert run.description
    history = run.history
    for number in range(min(history.last_round, 5) + 1):
        assert all(events.in_words(event, history.plan_name) for event in history.events[number])
        data.event_lines(history, number)
        for robot in range(history.n_robots):
            history.provenance(robot, number)
            mind(history, robot, number)
    return True


def pictured(path: Path) -> None:
    found = read_record(path)
    figures.save(figures.snapshots(found, None), path.with_suffix(".png"))
    figures.save(figures.error_over_time([found], ["a"]), path.with_suffix(".svg"))
    figures.save(figures.comparison([found, found], ["a", "b"]), path.with_suffix(".pdf"))


@parts
def test_a_record_is_shown_or_rejected(part: int, here: Path) -> None:
    good = good_entries()
    path = here / "run.mcap"
    shown = tried_files = 0
    for seed in seeds("record", CASES, part, PARTS):
        with drawn(seed) as rng:
            hostile = Hostile(rng)
            entries = list(good)
            for _ in range(rng.choice((1, 1, 2, 5))):
                at = rng.randrange(len(entries))
                kind, fields = entries[at]
                match rng.randrange(12):
                    case 0:
                        del entries[at]
                    case 1:
                        entries.insert(rng.randrange(len(entries)), entries[at])
                    case _:
                        entries[at] = (kind, hostile.model(kind, fields))
            write_record(path, entries, rng)
            shown, tried_files = shown + bool(watched(path)), tried_files + 1
            if rng.random() < 0.5:
                tried(lambda: inspected(path), RecordError)
            else:
                tried(lambda: write_page(path, path.with_suffix(".html")), RecordError)
            if rng.random() < 0.1:
                tried(lambda: write_file(path, path.with_suffix(".foxglove")), RecordError)
            if rng.random() < 0.003:
                tried(lambda: pictured(path), FlockError, within_s=DRAWN_S)
            if rng.random() < 0.0002:
                tried(lambda: animate(read_record(path), path.with_suffix(".gif")), FlockError, within_s=DRAWN_S)
    assert 0.1 * tried_files < shown < tried_files


# --- results ----------------------------------------------------------------------------------------------------------


def hostile_trial(good: TrialResult, rng: random.Random) -> dict[str, Any]:
    hostile = Hostile(rng, beyond=False)
    plain = msgspec.to_builtins(good)
    match rng.randrange(3):
        case 0:
            plain["config"] = hostile.model(RunConfig, plain["config"])
        case 1:
            plain["summary"] = hostile.struct(Summary, plain["summary"])
        case _:
            plain = hostile.struct(TrialResult, plain)
    return plain


def resumed(folder: Path) -> None:
    SpendingLog(Store(folder))


def told(folder: Path) -> None:
    results = Results.read(folder)
    assert len(results.trials) and results.cells and results.teams and sum(results.outcomes().values())
    results.curves(results.trials, results.longest)
    _ = results.axes


@parts
def test_results_are_told_or_rejected(part: int, here: Path) -> None:
    good = [trial("triangle", 3, "flock", 0), trial("triangle", 3, "paper", 1, simulated=True)]
    sweep = {"sweep": {"name": "a", "about": "b", "seeds": 2}, "grid": {"team": ["triangle/3"]}}
    make_record(here / "records" / "kept.mcap", n=3, rounds=2)
    taken = 0
    for seed in seeds("results", CASES, part, PARTS):
        with drawn(seed) as rng:
            hostile = Hostile(rng, beyond=False)
            store = Store(here)
            store.save(good[0])
            changed = hostile_trial(good[1], rng)
            if rng.random() < 0.3:
                changed["record"] = rng.choice(("records/kept.mcap", hostile.text()))
            name = good[1].id
            path = store.trial_path(name)
            path.write_bytes(damaged(json.dumps(changed).encode("utf-8", "surrogatepass"), rng))
            (here / SWEEP_NAME).write_bytes(damaged(toml(hostile.model(SweepFile, sweep)).encode(), rng))
            plan = hostile.struct(dict[str, list[str]], {good[0].id: ["a"], name: ["b"]})
            (here / PLAN_NAME).write_bytes(damaged(msgspec.json.encode(plan), rng))
            (here / "spent" / "one.json").write_bytes(msgspec.json.encode(hostile.struct(Spent)))
            taken += tried(lambda: told(here), RecordError, InputError) is None
            if rng.random() < 0.2:
                tried(lambda: tables.export_csv(here, here / "csv"), RecordError, InputError)
                tried(lambda: resumed(here), RecordError, InputError)
            if rng.random() < 0.003:
                tried(
                    lambda rng=rng: list(gallery(Results.read(here), 2, fly_again=rng.random() < 0.5)),
                    FlockError,
                    within_s=DRAWN_S,
                )
            if rng.random() < 0.0005:
                tried(lambda: write_report(here, here / "report", formats=["svg"]), FlockError, within_s=DRAWN_S)
    assert taken
