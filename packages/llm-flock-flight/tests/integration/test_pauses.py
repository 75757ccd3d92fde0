"""Pauses of the flight process, and of the whole computer: whole flights of stand-ins, in a process of their own."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cflib")

from flights import STARTS, STOCK, flight_config

from llm_flock.record._reader import read_record
from llm_flock_flight._crazyflie import CrazyflieRobot
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._pauses import own_pauses
from llm_flock_flight._testing.crtp import StandIns
from llm_flock_flight._testing.mavlink import AutopilotStandIns

ROOT = Path(__file__).parents[4]
TABLES = Path(tempfile.gettempdir()) / "llm-flock-test-tables"
STALL_S = 0.2
"""Longest stall of the machine, beside the pause under test, that a flight has to fly on after [s]."""
LANDED_S = 120.0
"""Longest wait for a landing, however slow the machine is [s]."""
HOMES = [(x / 2, y / 2, 0.0) for x, y in STARTS]
CODE = """
import asyncio, json, sys
from flights import yes
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight
config = FlightConfig.model_validate_json(sys.stdin.read())
flight = Flight(config, build_fleet(config), on_stage=lambda stage: print(stage, flush=True))
print(json.dumps(asyncio.run(flight.run(yes)).result.summary.to_dict()), flush=True)
"""
CALM: dict[str, Any] = {**STOCK, "reach_s": 6.0, "robot": "crazyflie", "cache": str(TABLES), "deadman": True}


def config_of(stand_ins: StandIns | AutopilotStandIns, out: Path) -> FlightConfig:
    drones = [{"name": f"d{k}", "uri": uri, "start": HOMES[k][:2]} for k, uri in enumerate(stand_ins.uris)]
    if isinstance(stand_ins, StandIns):
        return flight_config(**CALM, drones=drones, out=str(out))
    drones = [{**drone, "system_id": k + 1} for k, drone in enumerate(drones)]
    own = {"robot": "mavlink", "tracking_m": 0.12, "min_separation_m": 0.05, "low_battery_v": 13.0, "settle_s": 2.0}
    return flight_config(**{**CALM, **own, "ready_battery_v": 14.0}, drones=drones, out=str(out))


def highest(stand_ins: StandIns | AutopilotStandIns) -> float:
    return max(stand_ins[k].position[2] for k in range(len(stand_ins)))


def children(pid: int) -> list[int]:
    """The deadman."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()]


def flown(
    tmp_path: Path, stand_ins: StandIns | AutopilotStandIns, pause_s: float | None, *, together: bool
) -> tuple[dict[str, Any], str]:
    """Stop a flight in its first round, with its deadman or without; its summary, and what was said.

    It is stopped for a while, or, with None, until all drones are down.
    """
    env = {**os.environ, "PYTHONPATH": "tests"}
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", CODE], stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=env, cwd=ROOT
    ) as process:
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        try:
            process.stdin.write(config_of(stand_ins, tmp_path).model_dump_json(exclude_none=True))
            process.stdin.close()
            while process.stdout.readline().strip() not in ("flying", ""):
                pass
            time.sleep(0.6)
            stopped = [process.pid, *(children(process.pid) if together else [])]
            for pid in stopped:
                os.kill(pid, signal.SIGSTOP)
            ends_s = time.monotonic() + (LANDED_S if pause_s is None else pause_s)
            while time.monotonic() < ends_s and (pause_s is not None or highest(stand_ins) >= 0.05):
                time.sleep(0.05)
            height = highest(stand_ins)
            for pid in stopped:
                os.kill(pid, signal.SIGCONT)
            *_, last = process.stdout.read().splitlines()
            said = process.stderr.read()
            assert process.wait(20.0) == 0, said
        finally:
            process.kill()
        return {**json.loads(last), "height": height}, said


@contextmanager
def stalls() -> Iterator[list[float]]:
    """By how much this process, which nobody stops, was woken too late meanwhile [s]."""
    late, done = [0.0], threading.Event()

    def watch() -> None:
        due = time.monotonic() + 0.02
        while not done.wait(0.02):
            late.append(time.monotonic() - due)
            due = time.monotonic() + 0.02

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield late
    finally:
        done.set()
        watcher.join()


@pytest.mark.parametrize(("pause_s", "together"), [(2.0, True), (1.05, False)])
def test_a_pause_of_the_computer_ends_no_flight(tmp_path: Path, pause_s: float, together: bool) -> None:
    """The drones fly on by themselves: nobody blames them, or the flight, for the silence."""
    with StandIns(HOMES) as stand_ins, stalls() as late:
        summary, said = flown(tmp_path, stand_ins, pause_s, together=together)
    if max(late) > STALL_S:  # the machine paused the stand-ins as well
        assert summary["flight"]["safe"], (summary["flight"], said)
        pytest.skip(f"the machine itself stalled for {max(late):.2f} s: only a safe end was checked")
    assert summary["flight"]["ended"] == "mission", (summary["flight"], said)
    assert "deadman" not in said and summary["formed"]


@pytest.mark.parametrize("radio", ["crazyflie", "mavlink"])
def test_a_flight_that_stays_away_is_landed_and_reports_it(tmp_path: Path, radio: str) -> None:
    pytest.importorskip("cflib" if radio == "crazyflie" else "pymavlink")
    made = StandIns(HOMES) if radio == "crazyflie" else AutopilotStandIns(HOMES, listening=True)
    with made as stand_ins:
        summary, said = flown(tmp_path, stand_ins, None, together=False)
    flight = summary["flight"]
    assert summary["height"] < 0.05, "all were down before the flight went on"
    assert flight["ended"] == "hung" and flight["safe"] and set(flight["ends"].values()) == {"landed"}, (flight, said)
    assert "has given no sign of life for 1.5 s; leaving it alive, and calling d0, d1, d2, d3 beside it" in said
    record = read_record(tmp_path / "run.mcap")
    assert record.result is not None and record.result["flight"]["ended"] == "hung"
    assert [event.kind for event in record.flight].count("landed_by_deadman") == 4


@pytest.mark.parametrize("paused", [False, True])
def test_link_is_not_lost_before_a_pause_is_caught_up_with(paused: bool) -> None:
    """Nothing has been read for 2 s. If this process stood still meanwhile, the drone has half a second to be heard."""

    async def act(stand_ins: StandIns) -> None:
        robot = CrazyflieRobot("d0", stand_ins.uris[0], cache=TABLES)
        await robot.connect(8.0)
        stand_ins[0].lose_link()
        await asyncio.sleep(0.6)  # it has caught up with a pause while connecting, if there was one
        robot._link._heard_s = time.monotonic() - 2.0
        if paused:
            own_pauses()._looked_s -= 2.0
        assert robot.state().link_lost is not paused
        await asyncio.sleep(0.7)
        assert robot.state().link_lost
        await robot.close()

    with StandIns(HOMES[:1]) as stand_ins:
        asyncio.run(act(stand_ins))
