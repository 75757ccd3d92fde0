"""A sweep that is killed or interrupted: what is finished is kept, and the same command goes on."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sweeps import small, small_file

from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.store import read_trial, trial_files
from llm_flock_lab._experiments.sweep import fly_sweep
from llm_flock_lab._experiments.trial import TrialResult


@pytest.mark.parametrize("executor", ["one", "pool"])
def test_a_kill_loses_no_trial_that_is_finished_and_stops_nobody(tmp_path: Path, executor: str) -> None:
    path, out = small_file(tmp_path, seeds=6), tmp_path / "out"
    command = [sys.executable, "-m", "llm_flock", "sweep", str(path), "--out", str(out), "-q", "--executor", executor]
    process = subprocess.Popen([*command, "--jobs", "2"], cwd=tmp_path, start_new_session=True)
    try:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline and not (out / "trials").is_dir():
            time.sleep(0.02)
        while time.monotonic() < deadline and len(list(trial_files(out))) < 4:
            time.sleep(0.01)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    kept = {path.name: path.stat().st_mtime_ns for path in trial_files(out)}
    assert 4 <= len(kept) < 12
    assert all(isinstance(read_trial(out / "trials" / name), TrialResult) for name in kept)
    assert fly_sweep(small(tmp_path, seeds=6), out, executor="one").complete
    assert {path.name: path.stat().st_mtime_ns for path in trial_files(out) if path.name in kept} == kept


def test_an_interruption_keeps_what_is_finished_in_the_tables(tmp_path: Path) -> None:
    path, out = small_file(tmp_path, seeds=50), tmp_path / "out"
    command = [sys.executable, "-m", "llm_flock", "sweep", str(path), "--out", str(out), "-q", "--jobs", "2"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError):
            if len(list(trial_files(out))) >= 5:
                break
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and "the same command goes on" in said
    assert (out / "trials.parquet").exists() and 5 <= tables.read_trials(out).height < 100
