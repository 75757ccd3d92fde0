"""How slow this machine is now, compared with the one for which time limits were set."""

import time

REFERENCE_S = 0.017
"""Time of the loop below on the reference machine [s]. Where it takes 0.037 s, a trial takes 2.2 times as long."""


def slowness() -> float:
    """A factor for time limits, at least 1: the fastest of five loops, relative to the reference."""
    best = float("inf")
    for _ in range(5):
        began, total = time.perf_counter(), 0
        for k in range(1_000_000):
            total += k
        best = min(best, time.perf_counter() - began)
    return max(1.0, best / REFERENCE_S)
