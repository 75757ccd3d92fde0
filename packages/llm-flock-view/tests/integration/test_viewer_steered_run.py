"""Runs that are steered while they fly: what is asked for happens and is recorded, or is refused."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from llm_flock.errors import InputError
from llm_flock.record._reader import RunRecord, read_record
from llm_flock_view._viewer.launcher import MAX_RUNS, Launcher
from llm_flock_view._viewer.library import Library
from llm_flock_view._viewer.steered_run import HALLUCINATING, SteeredRun

FIELDS = {"shape": "circle", "n_robots": 5, "model": "simulated:ideal", "rounds": 60, "stop_when_formed": False}


def until(true: Callable[[], bool], timeout_s: float = 30.0) -> None:
    end = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


def launched(folder: Path, **fields: object) -> tuple[Launcher, SteeredRun]:
    launcher = Launcher(Library(), folder)
    (flight,) = launcher.start({**FIELDS, **fields}, pace=50.0)
    return launcher, flight


def ended(flight: SteeredRun) -> RunRecord:
    flight.end()
    until(lambda: flight.over and not flight.recording.open)
    assert flight.recording.failure is None
    return record_of(flight)


def record_of(flight: SteeredRun) -> RunRecord:
    assert flight.recording.path is not None
    return read_record(flight.recording.path)


def test_faults_and_missions_happen_in_flight_and_are_recorded(tmp_path: Path) -> None:
    _, flight = launched(tmp_path)
    until(lambda: flight.round >= 3)
    flight.kill(4)
    assert flight.change({"shape": "line"}) == 0
    flight.hallucinate(2)
    flight.lose(0.4)
    with pytest.raises(InputError, match="no robot 9"):
        flight.kill(9)
    with pytest.raises(InputError, match=r"^shape = 'nonsense': unknown shape"):
        flight.change({"shape": "nonsense"})
    with pytest.raises(InputError, match="shape"):
        flight.change({"shape": "points:/etc/passwd"})
    with pytest.raises(InputError, match="loss"):
        flight.lose(2.0)
    with pytest.raises(InputError, match="robot"):
        flight.hallucinate(5)
    asked_at = flight.round
    until(lambda: flight.round >= asked_at + 5)
    with pytest.raises(InputError, match="Robot 4 is dead"):
        flight.kill(4)
    with pytest.raises(InputError, match="Robot 4 is dead"):
        flight.hallucinate(4)
    with pytest.raises(InputError, match="nonsense already"):
        flight.hallucinate(2)
    record = ended(flight)
    for order in (lambda: flight.kill(1), lambda: flight.hallucinate(1), lambda: flight.lose(0.1), flight.end):
        with pytest.raises(InputError, match="The run is over"):
            order()
    with pytest.raises(InputError, match="The run is over"):
        flight.change({"shape": "circle"})
    assert flight.refusal("pause") == flight.refusal("pace") == "The run is over: it takes no more orders."
    assert record.result is not None and record.result["stopped"] == "interrupted"
    assert [info.mission["shape"] for info in record.missions] == ["circle", "line"]
    assert record.states[-1].phases[4] == "dead"
    told = {(event.robot, event.detail.get("model"), event.detail.get("loss")) for event in record.events
            if event.kind == "injected"}  # fmt: skip
    assert (2, HALLUCINATING, None) in told and (0, None, 0.4) in told
    assert {entry.model for entry in record.llm} == {"simulated:ideal", HALLUCINATING}
    assert flight.recording.history.last_round == record.rounds


def test_senseless_order_says_why_before_it_is_given(tmp_path: Path) -> None:
    _, flight = launched(tmp_path, n_robots=3, shape="triangle")
    until(lambda: flight.round >= 2)
    assert flight.refusal("kill", 1) is None and flight.refusal("pause") is None
    flight.kill(1)
    assert flight.refusal("hallucinate", 1) == "Robot 1 is dead.", "at once, not only with the next round"
    flight.kill(2)
    assert flight.refusal("kill", 0) == "Robot 0 is the last one alive."
    with pytest.raises(InputError, match="the last one"):
        flight.kill(0)
    ended(flight)


def test_a_paused_run_waits(tmp_path: Path) -> None:
    _, flight = launched(tmp_path)
    until(lambda: flight.round >= 2)
    flight.paused = True
    time.sleep(0.2)
    stood = flight.round
    time.sleep(0.3)
    assert flight.round == stood
    flight.paused = False
    until(lambda: flight.round > stood)
    ended(flight)


def test_a_run_without_orders_is_the_run_of_the_command_line(tmp_path: Path) -> None:
    from llm_flock.runtime._api import run

    _, flight = launched(tmp_path, rounds=8)
    until(lambda: flight.over and not flight.recording.open)
    again = run(config=flight.config.model_copy(update={"trial": flight.config.trial.model_copy(update={"out": None})}))
    assert (record_of(flight).positions[-1] == again.positions[-1]).all()


def test_two_protocols_start_from_the_same_places(tmp_path: Path) -> None:
    launcher = Launcher(Library(), tmp_path)
    pair = launcher.start({**FIELDS, "rounds": 3}, pace=100.0, protocols=("paper", "flock"))
    until(lambda: all(flight.over and not flight.recording.open for flight in pair))
    one, other = (record_of(flight) for flight in pair)
    assert (one.positions[0] == other.positions[0]).all()
    assert one.run.config["protocol"]["assignment"] == "nearest-free"


def test_nothing_takes_off_that_the_command_line_refuses(tmp_path: Path) -> None:
    launcher = Launcher(Library(), tmp_path / "runs")
    with pytest.raises(InputError, match="n_robots"):
        launcher.start({**FIELDS, "n_robots": -1}, pace=1.0, protocols=("paper", "flock"))
    assert not launcher.library.runs and not (tmp_path / "runs").exists()


def test_no_more_runs_than_the_machine_bears(tmp_path: Path) -> None:
    launcher = Launcher(Library(), tmp_path)
    flights = [launcher.start({**FIELDS, "seed": k}, pace=0.1)[0] for k in range(MAX_RUNS - 1)]
    with pytest.raises(InputError, match=f"'2 more than {MAX_RUNS - 1}'.*end some of them"):
        launcher.start(FIELDS, pace=1.0, protocols=("paper", "flock"))
    assert len(launcher.runs) == MAX_RUNS - 1, "not one of the pair"
    flights += launcher.start(FIELDS, pace=0.1)
    with pytest.raises(InputError, match="end some of them"):
        launcher.start(FIELDS, pace=1.0)
    for flight in flights:
        flight.end()
    until(lambda: all(flight.over for flight in flights))
