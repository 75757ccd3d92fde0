"""The trials of `benchmarks.arrivals`: what the robots have to do, and from where."""

from __future__ import annotations

import math
import tomllib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import llm_flock
from llm_flock.arrays import Points
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.runtime._result import RunResult
from llm_flock_lab._rivals import smallest_longest_way

HARD = Path(__file__).parents[1] / "experiments" / "hard.toml"


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One trial: the mission, starts and places, both of shape (n, d) [units].

    With `fixed` goals, robot i has place i, and there was nothing to agree on. Otherwise the places are those of the
    protocol's flight, `result`, which had these `options`.
    """

    mission: Mission
    start: Points
    places: Points
    fixed: bool = False
    result: RunResult | None = None
    options: dict[str, Any]

    @property
    def goals(self) -> Points:
        """The goal of each robot by the central assignment."""
        if self.fixed:
            return self.places
        ways = self.mission.shortest_ways(self.start, self.places)
        return self.places[smallest_longest_way(ways)]


def places_of(result: RunResult) -> Points:
    """The places of the plan that most robots follow; those of the reference shape if none does."""
    plans: Counter[Plan] = Counter(plan for plan in result.plans if plan is not None)
    return plans.most_common(1)[0][0].array if plans else result.mission.placed(*next(result.mission.placements()))


def _hard(name: str) -> dict[str, Any]:
    """A case of the sweep of hard cases."""
    cases: list[dict[str, Any]] = tomllib.loads(HARD.read_text())["grid"]["case"]
    return next({k: v for k, v in case.items() if k != "name"} for case in cases if case["name"] == name)


CASES: dict[str, Callable[[], dict[str, Any]]] = {
    "circle 10": lambda: {"shape": "circle", "n_robots": 10},
    "square 8": lambda: {"shape": "square", "n_robots": 8},
    "line 7": lambda: {"shape": "line", "n_robots": 7},
    "spacing 1.05, grid 16": partial(_hard, "spacing 1.05, grid 16"),
    "circle 20": lambda: {"shape": "circle", "n_robots": 20},
    "grid 25 from a clump": partial(_hard, "grid 25 from a clump"),
    "gap": partial(_hard, "gap"),
    "40 discs 0": partial(_hard, "40 discs 0"),
}
"""Fields of the configuration by the name of the case."""

RADIUS = 40.0
"""Radius of the circle of mirrored robots [units]."""


def scene_of(case: str, seed: int) -> Scene:
    """The trial of a case with this seed."""
    if case in FIXED:
        return FIXED[case](np.random.default_rng(seed))
    options = {**CASES[case](), "protocol": "flock", "model": "simulated:ideal", "seed": seed}
    result = llm_flock.run(**options)
    start, places = result.positions[0], places_of(result)
    return Scene(mission=result.mission, start=start, places=places, result=result, options=options)


def mirrored(n: int, rng: np.random.Generator) -> Scene:
    """Robots evenly on a circle, in random order and turned at random, each with its goal opposite."""
    angles = rng.uniform(0.0, 2.0 * math.pi) + 2.0 * math.pi * rng.permutation(n) / n
    offsets = RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    mission = Mission(n_robots=n)
    center = np.array(mission.center)
    return Scene(mission=mission, start=center + offsets, places=center - offsets, fixed=True, options={})


def corridor(each: int, rng: np.random.Generator) -> Scene:
    """Robots in two rooms that change rooms, through a corridor one robot wide with one bay."""
    walls = [(30, -5, 70, 48), (30, 52, 46, 105), (54, 52, 70, 105), (46, 57, 54, 105)]
    obstacles = tuple(Obstacle(polygon=((a, b), (c, b), (c, d), (a, d))) for a, b, c, d in walls)
    mission = Mission(shape="text:two rooms", n_robots=2 * each, obstacles=obstacles)
    rows = 50.0 + 6.0 * (np.arange(each) - (each - 1) / 2)
    left = np.column_stack([20.0 + rng.uniform(-3.0, 3.0, each), rows])
    right = np.column_stack([80.0 + rng.uniform(-3.0, 3.0, each), rows])
    start = np.array([*left, *right])
    return Scene(mission=mission, start=start, places=start[::-1].copy(), fixed=True, options={})


def layers(rng: np.random.Generator) -> Scene:
    """Two layers of nine, one above the other, that change places in space."""
    flat = np.array([[44.0 + 6.0 * i, 44.0 + 6.0 * j] for i in range(3) for j in range(3)])
    low = np.column_stack([flat, np.full(9, 40.0)]) + rng.uniform(-0.5, 0.5, (9, 3))
    high = np.column_stack([flat, np.full(9, 46.0)]) + rng.uniform(-0.5, 0.5, (9, 3))
    block = ((0.0, 0.0, 0.0), (100.0, 100.0, 100.0))
    mission = Mission(shape="text:two layers", n_robots=18, center=(50.0, 50.0, 50.0), arena=block)
    start, places = np.array([*low, *high]), np.array([*high, *low])
    return Scene(mission=mission, start=start, places=places, fixed=True, options={})


def permuted(rng: np.random.Generator) -> Scene:
    """A grid of 25, two safe distances apart, in which every robot goes to the place of another."""
    grid = np.array([[38.0 + 6.0 * i, 38.0 + 6.0 * j] for i in range(5) for j in range(5)])
    mission = Mission(shape="text:a grid", n_robots=25)
    return Scene(mission=mission, start=grid, places=grid[rng.permutation(25)], fixed=True, options={})


FIXED: dict[str, Callable[[np.random.Generator], Scene]] = {
    "mirrored 20": partial(mirrored, 20),
    "corridor with a bay, 1 and 1": partial(corridor, 1),
    "corridor with a bay, 3 and 3": partial(corridor, 3),
    "two layers change places": layers,
    "grid 25 changes places": permuted,
}
"""Cases with fixed goals; there is nothing to agree on."""
