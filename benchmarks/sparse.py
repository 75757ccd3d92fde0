"""What missing information costs teams that start out of radio range of each other: rounds over the lower bound.

    python -m benchmarks.sparse [--seeds N] [--jobs J]

The same starts are flown by *simulated* models that turn their plans at random, by models that all name the plan in
its reference orientation, and with a radio that reaches everybody. The yardstick is computed, not flown: a station at
the centre knows every start and the plan. Each robot flies towards it until it is in contact, over any number of
hops, then straight to its place in the best assignment, through whatever is in its way.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import scipy
from benchmarks import figures

import llm_flock
from llm_flock.arrays import Points

CASES = {"line 7": ("line", 7), "line 9": ("line", 9), "wedge 13": ("wedge", 13), "cross 17": ("cross", 17)}
CASES |= {"circle 20": ("circle", 20)}
CANONICAL = "simulated:ideal,canonical"
WAYS: dict[str, dict[str, Any]] = {
    "plans turned at random": {},
    "one orientation": {"model": CANONICAL},
    "plans turned, range 300": {"comm_range": 300.0},
    "one orientation, range 300": {"comm_range": 300.0, "model": CANONICAL},
}
YARDSTICK = "told by a station (computed)"


def fly(case: str, way: str, seed: int) -> tuple[float, float]:
    """Rounds over the bound as flown, infinite if the team did not form, and by the yardstick for the same plan."""
    shape, n = CASES[case]
    flown = llm_flock.run(shape=shape, n_robots=n, seed=seed, trace=False, **WAYS[way])
    bound, mission = flown.summary.lower_bound_rounds or 1, flown.mission
    plan = np.array(flown.plans[0].points) if flown.plans and flown.plans[0] is not None else np.array(mission.ideal)
    rounds = flown.summary.rounds_to_formed
    told = told_rounds(flown.positions[0], plan, np.array(mission.center), mission.comm_range, mission.max_step)
    return math.inf if rounds is None else rounds / bound, told / bound


def told_rounds(starts: Points, places: Points, station: Points, reach: float, step: float) -> int:
    """Rounds until all are at their places, if each is told its own as soon as it is in contact with the station."""
    goals = places[_best_slots(np.ceil(scipy.spatial.distance.cdist(starts, places) / step))]
    here, told, rounds = starts.copy(), np.zeros(len(starts), dtype=bool), 0
    while not told.all() or np.linalg.norm(here - goals, axis=1).max() > 1e-9:
        near = scipy.spatial.distance.cdist(here, here) <= reach
        told |= np.linalg.norm(here - station, axis=1) <= reach
        while (told | near[told].any(axis=0)).sum() > told.sum():
            told |= near[told].any(axis=0)
        way = np.where(told[:, None], goals, station) - here
        away = np.linalg.norm(way, axis=1, keepdims=True)
        here, rounds = here + way * np.minimum(1.0, step / np.maximum(away, 1e-12)), rounds + 1
    return rounds


def _best_slots(rounds: Points) -> list[int]:
    """The slot of each robot, so that the last one arrives as early as possible, and then the sum is smallest."""
    slots = np.arange(len(rounds))
    for longest in np.unique(rounds):
        allowed = np.where(rounds <= longest, rounds, 1e6)
        rows, slots = scipy.optimize.linear_sum_assignment(allowed)
        if allowed[rows, slots].max() <= longest:
            break
    return slots.tolist()


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args(arguments)
    rows = [["Case", *WAYS, YARDSTICK]]
    with ProcessPoolExecutor(given.jobs) as pool:
        for case in CASES:
            ratios = {way: list(pool.map(partial(fly, case, way), range(given.seeds))) for way in WAYS}
            told = [yardstick for _, yardstick in ratios["plans turned at random"]]
            columns = [*([flown for flown, _ in one] for one in ratios.values()), told]
            rows.append([case, *map(spread, columns)])
            print(*rows[-1], sep=" | ", flush=True)
    figures.write("sparse.csv", rows)


def spread(ratios: Sequence[float]) -> str:
    """Median, 90 % quantile and largest."""
    return ", ".join(f"{x:.2f}" for x in (*np.quantile(ratios, (0.5, 0.9), method="higher"), max(ratios)))


if __name__ == "__main__":
    main()
