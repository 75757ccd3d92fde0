"""`llm-flock fly`: on paper, in the air, and ended by the operator."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_line import Done, flock

from llm_flock.record._reader import read_record

ROOT = Path(__file__).parents[2]
FLY = ["fly", "--config", str(ROOT / "examples" / "flight.toml"), "--no-record"]
COMMAND = [sys.executable, "-m", "llm_flock", *FLY]
BRISK = ["--take-off-group", "4", "--take-off-s", "0.5", "--land-s", "0.5", "--round-s", "0.8", "--max-speed-m-s", "5"]
LONG = ["--no-stop-when-formed", "--rounds", "60"]


def run(*arguments: str, text: str | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, input=text, timeout=60, check=False)


def on_paper(*arguments: str) -> Done:
    return flock(*FLY, "--dry-run", *arguments, cwd=ROOT, check=False)


def test_a_dry_run_prints_and_checks_every_set_point() -> None:
    done = on_paper()
    assert done.returncode == 0 and "0 faults" in done.stdout and "cf4" in done.stdout
    plan = json.loads(on_paper("--json").stdout)
    assert plan["formed"] and plan["faults"] == [] and len(plan["landing"]) == 1
    assert all(len(row["targets_m"]) == 4 and row["separation_m"] >= 0.3 for row in plan["rounds"])


def test_a_flight_that_cannot_be_safe_is_wrong_input() -> None:
    done = on_paper("--min-separation-m", "0.5")
    assert done.returncode == 2 and "safe_distance" in done.stderr
    assert flock(*FLY, "--geofence=-1,-1,0,1,1,2", cwd=ROOT, check=False).returncode == 2


def test_nothing_takes_off_without_the_operators_consent() -> None:
    done = run(*BRISK, text="no\n")
    assert done.returncode == 1 and "not confirmed" in done.stderr and "cf3" in done.stdout
    assert done.stderr.count("connected in") == 4 and "waiting for cf2, cf3, cf4" in done.stderr


def test_a_confirmed_flight_forms_and_lands() -> None:
    done = run(*BRISK, "--quiet", text="fly\n")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("landed") == 4


def test_a_preflight_that_fails_is_explained() -> None:
    done = run(*BRISK, "--ready-battery-v", "4.1", "--yes", "--json")
    assert done.returncode == 1
    found = json.loads(done.stdout)
    assert found["summary"] is None and "cf1: battery: 4.00 V, at least 4.10 V" in found["preflight"]["failed"]


@pytest.mark.parametrize(("presses", "end"), [(1, "landed"), (2, "motors cut")])
def test_ctrl_c_lands_and_twice_cuts(presses: int, end: str) -> None:
    with subprocess.Popen(
        [*COMMAND, *BRISK, *LONG, "--yes"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        for line in process.stderr:
            if line.startswith("round 1"):
                break
        for _ in range(presses):
            process.send_signal(signal.SIGINT)
            time.sleep(0.1)
        out = process.stdout.read()
        assert process.wait(10.0) == 1
    # The first trouble is what ended the flight; motors are cut in any case.
    assert re.search(r"ended by\W+abort", out) and out.count(end) >= 4


@pytest.mark.parametrize(("key", "end"), [(b"l", "landed"), (b"r", "landed"), (b"x", "motors cut")])
def test_keys_of_the_terminal(key: bytes, end: str) -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [*COMMAND, *BRISK, *LONG], stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        os.write(ours, b"fly\n")
        for line in process.stderr:
            if line.startswith("round 1"):
                break
        os.write(ours, key)
        out = process.stdout.read()
        assert process.wait(10.0) == 1
    assert out.count(end) >= 4 and (key != b"r" or re.search(r"ended by\W+return", out))
    os.close(ours)
    os.close(theirs)


def test_flight_continues_if_its_output_is_not_read() -> None:
    """As with `2>&1 | head`."""
    out, into = os.pipe()
    with subprocess.Popen([*COMMAND, *BRISK, "--yes"], stdout=subprocess.PIPE, stderr=into, text=True) as process:
        os.close(into)
        with os.fdopen(out) as said:
            assert any(line.startswith("round 1") for line in said)
        assert process.stdout is not None and process.stdout.read().count("landed") == 4
        assert process.wait(10.0) == 0


def test_a_terminal_that_is_closed_lands_all_and_cuts_nothing(tmp_path: Path) -> None:
    """The kernel tells it, and a shell may tell it again; keys are read no more, and nothing can be written."""
    ours, theirs = pty.openpty()
    flight = [part for part in COMMAND if part != "--no-record"]
    arguments = [*flight, *BRISK, *LONG, "--yes", "--out", str(tmp_path / "flight")]
    with subprocess.Popen(arguments, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True) as process:
        os.close(theirs)
        said = b""
        while b"flying" not in said:
            said += os.read(ours, 4096)
        os.close(ours)
        for _ in range(2):
            process.send_signal(signal.SIGHUP)
        process.wait(20.0)
    record = read_record(tmp_path / "flight" / "run.mcap")
    assert record.result is not None and record.result["flight"]["ended"] == "abort"
    assert set(record.result["flight"]["ends"].values()) == {"landed"}
