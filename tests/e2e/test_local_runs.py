"""Whole runs and sweeps with models on board and their real engine: seconds each, no network."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sweeps import small

from llm_flock.errors import InputError
from llm_flock.record._reader import read_record
from llm_flock.runtime._api import run
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.sweep import fly_sweep
from llm_flock_onboard._local import engine
from llm_flock_onboard._local.engine import ENGINES
from llm_flock_onboard._local.weights import find_weights

pytest.importorskip("xllamacpp")
pytestmark = pytest.mark.usefixtures("own_cache")

STOCK = "local:smollm2+none"
MISSION = {"shape": "line", "n_robots": 2, "center": [10, 10], "arena": [[0, 0], [20, 20]], "spacing": 6}


def test_all_trials_of_a_sweep_share_one_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[engine.Engine] = []

    class Counted(engine.Engine):
        def __init__(self, *args) -> None:
            super().__init__(*args)
            loaded.append(self)

    monkeypatch.setattr(engine, "Engine", Counted)
    overrides = {"model": STOCK, "rounds": 1, "max_retries": 0, "protocol": "flock"}
    sweep = small(tmp_path, **overrides)
    assert all(spec.waits for spec in sweep.trials)
    for options in ({"executor": "pool"}, {"cluster": "auto"}):
        with pytest.raises(InputError, match="with models on board"):
            fly_sweep(sweep, tmp_path / "refused", **options)  # pyright: ignore[reportArgumentType]
    assert fly_sweep(sweep, tmp_path / "out").complete
    assert len(loaded) == 1 and ENGINES.running == 0
    table = tables.read_trials(tmp_path / "out")
    assert table["calls_failed"].sum() == 0 and table["cost_usd"].sum() == 0 and not table["simulated"].any()


def test_a_run_records_which_files_it_used_and_is_not_simulated(tmp_path):
    result = run(**MISSION, model=STOCK, rounds=1, max_retries=0, out=str(tmp_path))
    summary = result.summary
    assert list(summary.models) == [STOCK]
    assert not summary.simulated and summary.cost_usd == 0.0 and summary.model_calls == 2 and summary.tokens > 100
    record = read_record(tmp_path / "run.mcap")
    files = find_weights(STOCK.partition(":")[2]).versions()
    assert len(files) == 2 and files.items() <= record.run.versions.items() and not record.run.simulated
    assert {entry.model for entry in record.llm} == {STOCK}
    assert ENGINES.running == 0


WITHOUT_NETWORK = """
import ctypes, os, re, socket, sys
from pathlib import Path
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
alone = ctypes.CDLL(None).unshare(CLONE_NEWUSER | CLONE_NEWNET) == 0 # no network from here on: not even loopback is up

def guard(event, args):
    if event in ("socket.connect", "socket.bind", "socket.sendto", "socket.getaddrinfo"):
        local = event != "socket.getaddrinfo" and args[0].family == socket.AF_UNIX
        host = args[1][0] if event != "socket.getaddrinfo" and not local else args[0]
        if not local and host not in ("127.0.0.1", "::1", "localhost"):
            print("REACHED OUT", event, args, flush=True)
            os._exit(3)
sys.addaudithook(guard)

def foreign_sockets():
    # Also those of the engine, which is not Python: open sockets of this process, and where they are.
    mine = {link[8:-1] for fd in Path("/proc/self/fd").iterdir()
            if (link := os.readlink(fd) if fd.is_symlink() else "").startswith("socket:[")}
    found = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/self/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in mine and not fields[1].startswith(("0100007F", "0" * 24 + "01000000")):
                found.append(line)
    return found

from llm_flock_onboard._local.engine import ENGINES
from llm_flock.runtime._api import run
seen = []
def look(now):
    seen.append(ENGINES.running)
    assert not foreign_sockets(), foreign_sockets()
result = run(shape="line", n_robots=2, center=[10, 10], arena=[[0, 0], [20, 20]], spacing=6, rounds=1,
             model=MODEL, max_retries=0, on_round=look)
assert seen == [1], seen
print("calls", result.summary.model_calls, "failed", result.summary.calls_failed, "alone", alone)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="sockets are looked up in /proc")
def test_a_mission_needs_no_network():
    """In a network of its own without any device where the system allows that, and under a watch anyway."""
    script = WITHOUT_NETWORK.replace("MODEL", repr("local:smollm2"))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "failed 0" in done.stdout
    assert "calls 0" not in done.stdout


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX") or os.name != "posix", reason="signals of POSIX systems")
def test_ctrl_c_stops_the_engine_with_the_run(tmp_path):
    command = [sys.executable, "-m", "llm_flock", "run", "--model", STOCK, "--robots", "10", "--quiet"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen([*command, "--no-record"], env=environment, stderr=subprocess.PIPE) as process:
        deadline = time.monotonic() + 60
        while not list(tmp_path.glob("llm-flock-*/engine.sock")):
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.1)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        try:
            assert process.wait(timeout=60) == 130
        finally:
            process.kill()
    assert not list(Path(tmp_path).glob("llm-flock-*"))
