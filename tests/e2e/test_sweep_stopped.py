"""A sweep that is killed or interrupted: what is finished is kept, and the same command goes on."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sweeps import small, small_file

from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.store import read_trial, trial_files
from llm_flock_lab._experiments.sweep import fly_sweep
from llm_flock_lab._experiments.trial import TrialResult

SEEDS = 12
TRIALS = 2 * SEEDS  # each seed with both protocols


@contextlib.contextmanager
def started_sweep(folder: Path, out: Path, *flags: str, trials: int = 5) -> Iterator[subprocess.Popen[str]]:
    """A sweep in its own process group that has finished some trials. If it still runs at the end, it is killed."""
    file = small_file(folder, seeds=SEEDS)
    command = [sys.executable, "-m", "llm_flock", "sweep", str(file), "--out", str(out), "-q", "--jobs", "2", *flags]
    process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        deadline = time.monotonic() + 120
        while finished(out) < trials:
            assert time.monotonic() < deadline and process.poll() is None, "the sweep did not get that far"
            time.sleep(0.01)
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def finished(out: Path) -> int:
    """Number of trials in a directory of results, which may not be there yet."""
    try:
        return len(list(trial_files(out)))
    except OSError:
        return 0


@pytest.mark.parametrize("executor", ["one", "pool"])
def test_killed_sweep_keeps_finished_trials_and_resumes(tmp_path: Path, executor: str) -> None:
    out = tmp_path / "out"
    with started_sweep(tmp_path, out, "--executor", executor):
        pass
    kept = {path.name: path.stat().st_mtime_ns for path in trial_files(out)}
    assert 5 <= len(kept) < TRIALS
    assert all(isinstance(read_trial(out / "trials" / name), TrialResult) for name in kept)
    assert fly_sweep(small(tmp_path, seeds=SEEDS), out, executor="one").complete
    assert {path.name: path.stat().st_mtime_ns for path in trial_files(out) if path.name in kept} == kept


def test_interrupted_sweep_keeps_finished_trials_in_its_tables(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with started_sweep(tmp_path, out) as process:
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "the same command goes on" in errors
    assert (out / "trials.parquet").exists() and 5 <= tables.read_trials(out).height < TRIALS
