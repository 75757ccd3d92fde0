"""How much slower than the machine for which time limits were set this one is at the moment."""

import time

REFERENCE_S = 0.017
"""What the loop below takes there: 0.037 s where one and the same trial took 2.2 times as long as there."""


def slowness() -> float:
    """A factor for time limits, at least 1: the quickest of five loops, as a share of the reference."""
    best = float("inf")
    for _ in range(5):
        began, total = time.perf_counter(), 0
        for k in range(1_000_000):
            total += k
        best = min(best, time.perf_counter() - began)
    return max(1.0, best / REFERENCE_S)
