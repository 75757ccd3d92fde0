"""Twelve orders to random robots, one every five rounds: is the whole team on the last one, and how soon?

    python -m benchmarks.orders [--seeds N] [--orders N] [--jobs J] [--write]

Shapes and centres are drawn by the seed. Models are *simulated* and ideal. The judge of `benchmarks.minds` looks at
positions: the team is on the last order when it stands in that shape about that centre. `--write` writes
docs/data/orders.csv.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from benchmarks import figures
from benchmarks.minds import judge, separation

import llm_flock
from llm_flock.mission import Mission

EVERY, ROBOTS, ROUNDS = 5, 10, 400
SHAPES = ("circle", "line", "wedge", "grid", "polygon:5", "star")


@dataclass(frozen=True, kw_only=True)
class Followed:
    """Rounds from the last order to its shape, None if the team did not form it; the smallest separation [units]."""

    rounds: int | None
    separation: float


def fly(orders: int, seed: int) -> Followed:
    rng = np.random.default_rng([45, seed])
    changes: list[dict[str, Any]] = []
    for k in range(orders):
        wish = {"shape": str(rng.choice(SHAPES)), "center": rng.uniform(40.0, 60.0, 2).round(1).tolist()}
        changes.append({"round": EVERY * (k + 1), "robot": int(rng.integers(ROBOTS)), "set": wish})
    last = changes[-1]
    arena = ((-20.0, -20.0), (120.0, 120.0))
    mission = Mission(shape="circle", n_robots=ROBOTS, arena=arena)
    after = Mission(n_robots=ROBOTS, arena=arena, **last["set"])
    area = ((0.0, 0.0), (100.0, 100.0))
    flown = llm_flock.run(mission, seed=seed, rounds=ROUNDS, changes=changes, start_area=area, trace=False)
    return Followed(
        rounds=judge(flown.positions[last["round"] :], np.array(after.ideal), after.spacing),
        separation=separation(flown.positions),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--orders", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--write", action="store_true", help="write docs/data/orders.csv")
    given = parser.parse_args(arguments)
    with ProcessPoolExecutor(given.jobs) as pool:
        flown = list(pool.map(partial(fly, given.orders), range(given.seeds)))
    rounds = sorted(one.rounds for one in flown if one.rounds is not None)
    lost = [seed for seed, one in enumerate(flown) if one.rounds is None]
    titles = "Orders", "On the last one", "Rounds to it, median", "Most rounds", "Smallest separation"
    nearest = f"{min(one.separation for one in flown):.4f}"
    row = given.orders, f"{len(rounds)} of {given.seeds}", rounds[len(rounds) // 2], rounds[-1], nearest
    print(
        *(f"{title}: {figure}" for title, figure in zip(titles, row, strict=True)), f"not: {lost or 'none'}", sep="\n"
    )
    if given.write:
        figures.write("orders.csv", [titles, row])


if __name__ == "__main__":
    main()
