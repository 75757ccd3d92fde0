"""A sweep on a Ray cluster of this machine, started and stopped here: the tables are those of one process."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from polars.testing import assert_frame_equal
from sweeps import results, small, small_file

from llm_flock_lab._experiments.sweep import fly_sweep

SOURCE = os.pathsep.join(map(str, Path(__file__).parents[2].glob("packages/*/src")))
ENV = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0", "PYTHONPATH": SOURCE, "NO_COLOR": "1", "TERM": "dumb"}


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a cluster with two processors, in a process group of its own that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:
        command = [
            sys.executable,
            "-m",
            "ray.scripts.scripts",
            "start",
            "--head",
            "--block",
            "--port=0",
            "--num-cpus=2",
        ]
        command += ["--node-ip-address=127.0.0.1", "--include-dashboard=false", "--object-store-memory=80000000"]
        with (Path(folder) / "log").open("wb") as log:
            process = subprocess.Popen(
                [*command, f"--temp-dir={folder}"], env=ENV, stdout=log, stderr=log, start_new_session=True
            )
        address = Path(folder) / "ray_current_cluster"
        try:
            deadline = time.monotonic() + 120
            while time.monotonic() < deadline and process.poll() is None and not address.exists():
                time.sleep(0.1)
            time.sleep(1)
            assert address.exists(), (Path(folder) / "log").read_text()
            yield address.read_text().strip()
        finally:
            stop(process)


def stop(process: subprocess.Popen[bytes]) -> None:
    """End the head, which ends what it started; then the rest of its group."""
    process.terminate()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(30)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def sweep(*arguments: str, cwd: Path) -> dict[str, object]:
    done = subprocess.run(
        [sys.executable, "-m", "llm_flock", "sweep", *arguments, "--json"],
        cwd=cwd,
        env=ENV,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode in (0, 1), done.stderr
    return json.loads(done.stdout)


def test_all_workers_share_one_budget_and_give_the_tables_of_one(tmp_path: Path, cluster: str) -> None:
    links = "[run.links]\nloss = 0.2"
    path = small_file(tmp_path, seeds=3, more=links)
    arguments = (str(path), "--out", "ray", "--cluster", cluster, "--keep-records", "failed")
    found = sweep(*arguments, "--budget-calls", "100", cwd=tmp_path)
    assert found["complete"] is False and "max_calls = 100" in str(found["reason"])
    assert results(tmp_path / "ray")[0]["model_calls"].sum() == 100
    found = sweep(*arguments, cwd=tmp_path)
    assert found["complete"] is True and found["formed"] == 3
    fly_sweep(small(tmp_path, seeds=3, more=links), tmp_path / "one", executor="one")
    ray, one = results(tmp_path / "ray"), results(tmp_path / "one")
    kept = ray[0]["record"].drop_nulls()
    assert len(kept) == 3 and all((tmp_path / "ray" / name).is_file() for name in kept)
    apart = ("earlier_tries", "earlier_cost_usd", "record")
    assert_frame_equal(ray[0].drop(apart), one[0].drop(apart), check_exact=True)
    assert_frame_equal(ray[1], one[1], check_exact=True)
