"""How time, memory and traffic grow with the team: grids of 30, 300 and 1,000 robots.

    python -m benchmarks scale [N ...] [--write]

A grid 6 apart, starts drawn in all of an arena of the same density for each size (280 x 280 for 1,000), never nearer
than 3; instant simulated models, record off. Each team is flown in a process of its own, so that the peak of memory is
its own. Time is the processor's, which other processes on the machine disturb least. Exponents are those between the
smallest and the largest team. With `--write`, docs/data/scale.csv gets a row for each size.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import resource
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

from benchmarks import figures

import llm_flock

SIZES = (30, 300, 1000)
SIDE, OF = 280, 1000
"""Side of the arena [units] of a team of this size."""


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one mission took: rounds flown, processor time [s], peak of memory [MiB], bytes per robot-round."""

    rounds: int
    busy_s: float
    peak_mib: float
    sent: float


def grid(n: int) -> llm_flock.Mission:
    """A grid of n in an arena of the density of the largest."""
    side = math.ceil(SIDE * math.sqrt(n / OF))
    return llm_flock.Mission(
        shape="grid", n_robots=n, spacing=6, center=(side / 2, side / 2), arena=((0, 0), (side, side))
    )


def fly(n: int) -> Cost:
    """One whole mission of seed 0; it has to be formed, at distinct places and without a violation."""
    llm_flock.run(grid(4), trace=False)  # imports what a run needs
    before = resource.getrusage(resource.RUSAGE_SELF)
    summary = llm_flock.run(grid(n), rounds=60, seed=0, trace=False).summary
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert summary.formed and summary.distinct_goals == n and (summary.min_separation or 0.0) >= 3 - 1e-6
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    sent = summary.bytes_per_robot_round
    cost = Cost(rounds=summary.rounds, busy_s=busy, peak_mib=after.ru_maxrss / 1024, sent=sent)
    print(f"grid of {n}, load {os.getloadavg()[0]:.1f} (other processes included): {cost}", flush=True)
    return cost


def main(arguments: Sequence[str] = ()) -> None:
    """Fly each size in its own process, then print how costs grow."""
    parser = argparse.ArgumentParser("python -m benchmarks scale", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("sizes", type=int, nargs="*", metavar="N", help="team sizes [30 300 1000]")
    parser.add_argument("--write", action="store_true", help="write docs/data/scale.csv")
    given = parser.parse_args(arguments)
    sizes = sorted(given.sizes) or list(SIZES)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:
        costs = list(pool.map(fly, sizes))
    if len(sizes) > 1:
        first, last, span = costs[0], costs[-1], math.log(sizes[-1] / sizes[0])
        sent = math.log(last.sent / first.sent) / span
        busy = math.log(last.busy_s * first.rounds / (first.busy_s * last.rounds)) / span - 1
        print(f"From {sizes[0]} to {sizes[-1]} robots bytes per robot-round grow as N^{sent:.2f} (bar 0.7),", end=" ")
        print(f"processor time per robot-round as N^{busy:.2f} (bar 0.5)")
    if given.write:
        titles = ["Robots", "Rounds", "Processor time [s]", "Time per robot-round [ms]", "Memory [MiB]"]
        figures.write("scale.csv", [[*titles, "Bytes per robot-round"], *map(_row, sizes, costs)])


def _row(n: int, cost: Cost) -> list[str]:
    each = 1000 * cost.busy_s / cost.rounds / n
    return [f"{n:,}", str(cost.rounds), f"{cost.busy_s:.1f}", f"{each:.2f}", f"{cost.peak_mib:.0f}", f"{cost.sent:.0f}"]
