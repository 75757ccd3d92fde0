"""How time, memory and traffic grow with the team: grids of 30, 300 and 1,000 robots.

    python -m benchmarks scale [N ...]

A grid 6 apart, starts drawn in all of an arena of the same density for each size (280 x 280 for 1,000), never nearer
than 3; instant simulated models, record off. Each team is flown in a process of its own, so that the peak of memory is
its own. Time is the processor's, which other processes on the machine disturb least. The exponent is that of the bytes
that a robot broadcasts in a round, between the smallest and the largest team.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import resource
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor

import llm_flock

SIZES = (30, 300, 1000)
SIDE, OF = 280, 1000
"""Side of the arena [units] of a team of this size."""

BARS = {300: " (bar 25)", 1000: " (bar 120)"}


def grid(n: int) -> llm_flock.Mission:
    """A grid of n in an arena of the density of the largest."""
    side = math.ceil(SIDE * math.sqrt(n / OF))
    return llm_flock.Mission(
        shape="grid", n_robots=n, spacing=6, center=(side / 2, side / 2), arena=((0, 0), (side, side))
    )


def fly(n: int) -> float:
    """One whole mission of seed 0; prints its figures and returns the bytes that a robot broadcasts in a round."""
    before = resource.getrusage(resource.RUSAGE_SELF)
    summary = llm_flock.run(grid(n), rounds=60, seed=0, trace=False).summary
    after = resource.getrusage(resource.RUSAGE_SELF)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    peak_mib = after.ru_maxrss / 1024
    print(f"grid of {n}, load {os.getloadavg()[0]:.1f} (other processes included)")
    print(f"  formed {summary.formed} in round {summary.rounds_to_formed}, {summary.rounds} rounds flown,", end=" ")
    print(f"{summary.distinct_goals} distinct goals, smallest separation {summary.min_separation:.6f}")
    print(f"  processor {busy:.0f} s{BARS.get(n, '')}, {peak_mib:.0f} MiB{' (bar 1536)' if n == OF else ''},", end=" ")
    print(f"{summary.bytes_per_robot_round:.0f} bytes per robot-round", flush=True)
    return summary.bytes_per_robot_round


def main(arguments: Sequence[str] = ()) -> None:
    """Fly each size in its own process, then print the exponent of the traffic."""
    parser = argparse.ArgumentParser("python -m benchmarks scale", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("sizes", type=int, nargs="*", metavar="N", help="team sizes [30 300 1000]")
    sizes = sorted(parser.parse_args(arguments).sizes) or list(SIZES)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:
        sent = list(pool.map(fly, sizes))
    if len(sizes) > 1:
        exponent = math.log(sent[-1] / sent[0]) / math.log(sizes[-1] / sizes[0])
        print(f"bytes per robot-round grow as N^{exponent:.2f} from {sizes[0]} to {sizes[-1]} robots   bar 0.7")
