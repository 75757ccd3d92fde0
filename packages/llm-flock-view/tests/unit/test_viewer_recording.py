"""A run as pages see it: from a record, from one that grows, and from one that broke off."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from sample_records import FakeRun, llm_entry, make_record

from llm_flock.errors import InputError
from llm_flock.record._schema import BodySample, FlightEvent, ProtocolEvent, RoundEnd
from llm_flock.record._stream import RecordStream
from llm_flock.record._words import understood, verdict, work_text
from llm_flock.record._writer import RecordWriter
from llm_flock_view._viewer import library as viewer_library
from llm_flock_view._viewer.data import answer, frames, news
from llm_flock_view._viewer.events import in_words
from llm_flock_view._viewer.library import Library, load
from llm_flock_view._viewer.mind import breakers, claims_heard
from llm_flock_view._viewer.paths import newest_in, records_in, title_of
from llm_flock_view._viewer.recording import Recording


def replayed(path: Path) -> Recording:
    run = Library().add("test", path, live=False)
    load(run)
    return run


def test_a_record_is_shown_whole(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=5, rounds=4))
    assert (run.history.last_round, run.open, run.failure, run.history.n_robots) == (4, False, None, 5)
    newest = news(run, 0, 0, 0)
    assert newest["last"] == 4 and len(newest["plans"]) == 5 and len(newest["figures"]["procrustes_mean"]) == 5
    assert newest["marks"]["1"] == {"plans": 5}
    some = frames(run.history, 3, 100)
    assert [frame["r"] for frame in some] == [3, 4]
    assert len(some[0]["x"]) == 5 and some[1]["p"] == [0] * 5
    assert news(run, 5, 5, 1) == newest | {
        "plans": [],
        "missions": [],
        "figures": {name: [] for name in newest["figures"]},
        "marks": {},
    }


def test_a_growing_record_is_read_in_whole_messages(tmp_path: Path) -> None:
    whole = make_record(tmp_path / "whole.mcap", n=3, rounds=3).read_bytes()
    growing = tmp_path / "growing.mcap"
    stream = RecordStream(growing)
    assert list(stream.entries()) == []
    rounds: list[int] = []
    written = 0
    with growing.open("wb") as file:
        for end in range(0, len(whole) + 997, 997):
            file.write(whole[written:end])
            file.flush()
            written = end
            rounds += [entry.round for entry in stream.entries() if isinstance(entry, RoundEnd)]
    assert rounds == [0, 1, 2, 3] and stream.ended
    assert list(stream.entries()) == []


def test_broken_record_is_shown_up_to_its_last_whole_round(tmp_path: Path) -> None:
    path = make_record(tmp_path / "run.mcap", n=3, rounds=6, finish=False)
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.rindex(b'"round":5')])
    run = replayed(path)
    assert 0 <= run.history.last_round < 6 and not run.open and run.failure is None
    assert len(frames(run.history, 0, 100)) == run.history.last_round + 1


@pytest.mark.parametrize("content", [b"", b"not a record", b"\x89MCAP0\r\n"])
def test_viewer_reports_a_file_that_is_no_record(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    run = replayed(path)
    assert run.failure and not run.ready and not run.open


def test_records_are_found_where_they_are_named(tmp_path: Path) -> None:
    one, two = (make_record(tmp_path / name / "run.mcap", n=2, rounds=1) for name in ("one", "two"))
    assert records_in([tmp_path]) == [one, two] == records_in([tmp_path / "one", two])
    assert title_of(one) == "one" and title_of(tmp_path / "other.mcap") == "other"
    assert newest_in(tmp_path) in (one, two)
    with pytest.raises(InputError, match="a run in it"):
        newest_in(tmp_path / "one")
    with pytest.raises(InputError, match="a folder with"):
        records_in([tmp_path / "three"])


def test_a_page_gets_its_run_by_its_key(tmp_path: Path) -> None:
    library = Library()
    run = library.add("one", make_record(tmp_path / "run.mcap", n=4, rounds=3), live=False)
    load(run)

    def asked(path: str, **query: str) -> Any:
        found = answer(library, path.replace("KEY", run.key), query)
        return None if found is None else json.loads(found)

    about = asked("/data/KEY/about")
    assert about["robots"] == 4 and about["live"] is False
    news = asked("/data/KEY/news", rounds="0", plans="0", missions="0")
    assert news["last"] == 3 and len(news["figures"]["procrustes_mean"]) == 4
    assert [frame["r"] for frame in asked("/data/KEY/frames", first="1", count="2")] == [1, 2]
    mind = asked("/data/KEY/mind", robot="2", round="1")
    assert mind["calls"][0]["verdict"] == "used: next waypoint (1, 2)"
    assert asked("/data/KEY/mind", robot="9", round="1") is None
    assert asked("/data/KEY/events", round="1")["total"] == 4
    found = asked("/data/KEY/events", find="Robot 2", round="1")
    assert [(who, number) for who, _, number in found["lines"]] == [("robot 2", k) for k in (1, 2, 3)]
    assert found["more"] is False and asked("/data/KEY/events", find="robot 2 nonsense")["lines"] == []
    assert isinstance(asked("/data/KEY/frames", first="x", count="-3"), list)
    for nothing in ("/data/1/about", f"/data/{run.key}/secret", "/data/../run.mcap", "/run.mcap"):
        assert answer(library, nothing, {}) is None, nothing


def test_keys_are_all_that_a_page_can_name() -> None:
    library = Library()
    run = library.add("a")
    assert library.find(run.key) is run
    assert library.find("../../etc/passwd") is None and library.find("1") is None


def test_address_of_a_record_outlives_viewer_and_folder(tmp_path: Path) -> None:
    path = make_record(tmp_path / "runs" / "one" / "run.mcap", n=2, rounds=2)
    other = make_record(tmp_path / "runs" / "two" / "run.mcap", n=3, rounds=2, seed=1)
    first = Library().add("one", path, live=False)
    path.parent.rename(tmp_path / "runs" / "moved")
    later = Library(tmp_path / "runs")
    assert later.add("two", other, live=False).key != first.key
    found = later.find(first.key)
    assert found is not None and found.title == "moved" and found.ready
    copies = [later.add(name, other, live=False).key for name in ("copy", "again")]
    assert len({*copies, first.key}) == 3, "a copy has an address of its own"


def test_records_made_while_a_viewer_runs_appear_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer_library, "WATCH_S", 0.02)
    make_record(tmp_path / "runs" / "before" / "run.mcap", n=2, rounds=2)
    library = Library(tmp_path / "runs")
    library.expect(tmp_path / "runs" / "own" / "run.mcap")
    watcher = threading.Thread(target=library.watch, args=([tmp_path / "named"],), daemon=True)
    watcher.start()
    while len(library._known) < 2:  # what is there already is looked at first
        time.sleep(0.01)
    for folder in ("runs/own", "runs/new", "named/new"):
        make_record(tmp_path / folder / "run.mcap", n=2, rounds=2, seed=len(folder))
    (tmp_path / "named" / "flies").mkdir()
    with RecordWriter(tmp_path / "named" / "flies" / "run.mcap") as writer:
        fake = FakeRun(n=2, rounds=2, seed=9)
        fake.write(writer, finish=False)
        end = time.monotonic() + 20
        while sum(run.ready and not run.open for run in library.runs.values()) < 2 and time.monotonic() < end:
            time.sleep(0.02)
        while len(library.runs) < 3 and time.monotonic() < end:
            time.sleep(0.02)
        states = {(run.path.parent.name if run.path else "", run.open) for run in library.runs.values()}
        assert states == {("new", False), ("flies", True)} and len(library.runs) == 3
        said = json.loads(answer(library, "/data/runs", {}) or b"")
        assert len(said["rows"]) == 3 and said["changes"] == library.changes
    library.closed.set()
    watcher.join(20)
    assert not watcher.is_alive()


def test_a_plan_is_traced_to_its_proposer(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=3, rounds=3))
    plan = run.history.states[3].plan_ids[0]
    for number, robot, kind, source in ((1, 0, "proposed", None), (2, 1, "adopted", 0), (3, 2, "adopted", 1)):
        detail = {"plan": plan, "slot": 0} if source is None else {"plan": plan, "from": source}
        run.write(ProtocolEvent(round=number, comm_round=0, robot=robot, kind=kind, detail=detail))
    assert [(step.robot, step.source, step.round) for step in run.history.provenance(2, 3)] == [
        (0, None, 1),
        (1, 0, 2),
        (2, 1, 3),
    ]
    assert run.history.provenance(2, 0) == []


def test_claims_are_those_in_radio_range_the_own_first(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=10, rounds=3))
    found = claims_heard(run.history, 4, 3)
    assert found[0].robot == 4 and not found[0].rival
    assert all(claim.distance <= 15.0 for claim in found)
    assert [claim.distance for claim in found[1:]] == sorted(claim.distance for claim in found[1:])


def test_a_verdict_says_what_became_of_an_answer() -> None:
    assert verdict(llm_entry(1, 0)) == "used: next waypoint (1, 2)"
    assert verdict(llm_entry(1, 0, parsed=None, rejected="too far")) == "refused: too far"
    assert verdict(llm_entry(1, 0, parsed=None, text=None, error="timeout: 3 s")) == "no answer: timeout: 3 s"


def test_understood_answer_is_shown_as_text() -> None:
    assert understood({"waypoint": [10**400, 1]}) == f"next waypoint [{10**400}, 1]"
    assert understood({"waypoint": [1.004, 2.5], "path": [[1.004, 2.5], [3, -4.0]]}) == (
        "next waypoint (1, 2.5); path (1, 2.5) → (3, -4)"
    )
    assert understood({"plan": [[0.0, 1.0], [2.0, 3.0]], "slot": 1}) == "a plan of 2 places: (0, 1) (2, 3); own place 1"
    many = understood({"plan": [[0.0, float(k)] for k in range(40)], "slot": None})
    assert many.startswith("a plan of 40 places: (0, 0) ") and many.endswith(" (0, 11) and 28 more; no own place")
    # A record is a file from anywhere: what is not as it should be is shown as it is.
    assert understood({"waypoint": "<b>", "other": [1, "x"], "path": ["y"]}) == "waypoint <b>; other [1, 'x']; path y"


def test_a_live_run_shows_no_half_round(tmp_path: Path) -> None:
    with RecordWriter(tmp_path / "run.mcap") as writer:
        fake = FakeRun(n=2, rounds=3)
        fake.rounds = 1
        fake.write(writer, finish=False)
        writer.write(ProtocolEvent(round=2, comm_round=0, robot=0, kind="killed", detail={}))
        run = replayed(tmp_path / "run.mcap")
    assert run.history.last_round == 1 and "2" not in news(run, 0, 0, 0)["marks"]


def test_flight_events_are_shown_and_marked_unless_routine(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=3, rounds=3))
    row = [[0.0, 0.0, 1.0]]
    run.write(BodySample(round=2, time_s=1.0, measured=row, commanded=row, flying=[True], battery_v=[3.9], link=[1.0]))
    for robot, kind in ((1, "aloft"), (1, "link_lost"), (None, "abort")):
        run.write(FlightEvent(round=2, time_s=1.0, kind=kind, robot=robot, detail={}))
    assert news(run, 0, 0, 0)["marks"]["2"]["faults"] == 2
    assert [event.kind for event in run.history.events[2] if event.robot == 1][-2:] == ["aloft", "link_lost"]


def test_open_circuit_breaker_is_shown_as_text_and_marked(tmp_path: Path) -> None:
    """A real run with one hopeless model: the panel's sentences, the frames' marks, and who did the work."""
    import llm_flock

    path = tmp_path / "run.mcap"
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    result = llm_flock.run(mission, model="0=simulated:malformed,1-2=simulated:ideal", seed=1, out=str(tmp_path))
    assert result.formed and result.summary.breakers_opened == (0,)
    run = replayed(path)
    opened = next(k for k, state in enumerate(run.history.states) if "step" in state.open_breakers[0])
    (sentence,) = [text for text in breakers(run.history, 0, opened) if "step" in text]
    assert (
        "its model is not asked for a step after 2 refusals in a row" in sentence and "next probe in round" in sentence
    )
    assert breakers(run.history, 0, 0) == breakers(run.history, 1, opened) == []
    assert frames(run.history, opened, 1)[0]["b"] == [0] and frames(run.history, 0, 1)[0]["b"] == []
    assert run.marks[opened]["fallbacks"] > 0
    assert any(call.probe for k in range(run.history.last_round + 1) for call in run.history.calls[k, 0])
    words = [
        in_words(event, run.history.plan_name)
        for k in range(run.history.last_round + 1)
        for event in run.history.events[k]
    ]
    assert any("was helped by geometry, for its model gave no usable step" in text for text in words)
    work = work_text(run.history.result or {})
    assert (
        work.startswith("plan by robot ")
        and "geometry" in work
        and work.endswith("circuit breakers opened for robot 0")
    )
