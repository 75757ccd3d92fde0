"""The cost of a sweep: many simulated trials, and many trials that wait for one server."""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path

from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.sweep import fly_sweep
from llm_flock_lab._experiments.sweep_file import load_sweep

SIMULATED = Path(__file__).parents[1] / "experiments" / "simulated.toml"

TWENTY = """
[sweep]
name = "twenty"
seeds = {seeds}
[grid]
team = ["circle/10"]
protocol = ["flock"]
"""


def whole() -> None:
    """The 1,200 trials of experiments/simulated.toml in a pool of two processes."""
    sweep, began = load_sweep(SIMULATED), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        status = fly_sweep(sweep, Path(folder), jobs=2)
        took = time.perf_counter() - began
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    mib = (2 * children.ru_maxrss + resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024
    print(f"{status.finished} of {status.trials} simulated trials, two processes")
    print(
        f"  {took:.0f} s (processor {children.ru_utime + children.ru_stime:.0f} s)   bar 360;   "
        f"{mib:.0f} MiB   bar 2048",
        flush=True,
    )


def twenty() -> None:
    """Twenty trials at once, and the longest of them alone, with a server that answers after one second."""
    from integration.fault_server import running

    def fly(folder: Path, seeds: str, url: str) -> float:
        folder.mkdir()
        (folder / "file.toml").write_text(TWENTY.format(seeds=seeds), encoding="utf-8")
        sweep, began = (
            load_sweep(folder / "file.toml", model="openai-compatible:test", base_url=url),
            time.perf_counter(),
        )
        fly_sweep(sweep, folder / "out", executor="one")
        return time.perf_counter() - began

    with running(latency=1.0) as server, tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fly(folder / "warm", "[100]", server.base_url)
        busy = time.process_time()
        together = fly(folder / "together", "20", server.base_url)
        busy = time.process_time() - busy
        longest = tables.read_trials(folder / "together" / "out").sort("wall_s")["seed"][-1]
        alone = fly(folder / "alone", f"[{longest}]", server.base_url)
    print("twenty circles of ten at once, one process, 1 s latency")
    print(f"  {together:.1f} s (processor {busy:.1f} s), the longest alone {alone:.1f} s", flush=True)
    print(f"  {together / alone:.2f} times   bar 1.3", flush=True)
