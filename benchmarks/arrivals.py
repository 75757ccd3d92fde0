"""The same starts and bodies flown with several methods: who arrives, how soon, how far, and how near to each other.

    python -m benchmarks arrivals [--seeds N] [--case NAME] [--jobs J]     20 seeds of each case, one process

The whole protocol flies first, with *simulated* language models. The other methods fly from the same starts to the
places that its robots agreed on, and know all positions at all times. All have the same limits, tolerance and number of
rounds. docs/explanation/comparison.md has the conditions and the table.
"""

from __future__ import annotations

import argparse
import math
import random
import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, TypeAlias
from unittest import mock

import numpy as np
from benchmarks.orca import orca_velocities, to_complex
from benchmarks.scenes import CASES, FIXED, Scene, places_of, scene_of
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import llm_flock
from llm_flock import metrics, shield
from llm_flock.arrays import Point, Points
from llm_flock.message import Course
from llm_flock.metrics import ROUNDING
from llm_flock.mission import Mission
from llm_flock.protocol._motion.leg import leg_to
from llm_flock.protocol._motion.projection import static_half_spaces
from llm_flock.protocol._motion.right_of_way import RightOfWay
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.protocol._parts import Observation
from llm_flock.protocol._verification.steps import towards
from llm_flock_lab._experiments.statistics import wilson


@dataclass(frozen=True, kw_only=True)
class Flight:
    """Positions of shape (k * rounds + 1, n, 2) [units], k for each round; the goals reached; the places to choose."""

    track: Points
    goals: Points
    places: Points
    per_round: int = 1


Method: TypeAlias = Callable[[Scene], Flight | None]
"""Flies a scene; None where its conditions do not hold."""

Advance: TypeAlias = Callable[[Points], Sequence[Points]]
"""Positions during a round, the last ones at its end, from those before it."""


LONG = 20
"""Rounds over the bound after which a flight to fixed goals counts as failed."""


def bound_rounds(mission: Mission, start: Points, places: Points, fixed: bool) -> int:
    """Smallest number of rounds, at least 1, with nobody in the way."""
    within = metrics.AT_GOAL * mission.spacing
    if fixed:
        own = np.diagonal(mission.shortest_ways(start, places))
        return max(1, math.ceil((float(own.max()) - within) / mission.max_step))
    ways = mission.shortest_ways
    return max(1, metrics.lower_bound_rounds(start, places, mission.max_step, within=within, ways=ways))


def arrival(flight: Flight, within: float) -> int | None:
    """First of three rounds in a row in which every robot is this near to its goal [units]; None if there is none."""
    ends = flight.track[:: flight.per_round]
    there = (np.linalg.norm(ends - flight.goals, axis=2) <= within).all(axis=1)
    held = range(len(ends) - metrics.HELD_ROUNDS + 1)
    return next((k for k in held if there[k : k + metrics.HELD_ROUNDS].all()), None)


def fly(scene: Scene, goals: Points, advance: Advance, per_round: int = 1) -> Flight:
    """Fly until all robots have arrived, or as long as the protocol would; with fixed goals for longer."""
    mission, track, held = scene.mission, [scene.start], 0
    bound = bound_rounds(mission, scene.start, scene.places, scene.fixed)
    rounds = LONG * bound if scene.fixed else metrics.deadline(bound)
    for _ in range(rounds + metrics.HELD_ROUNDS - 1):
        track.extend(advance(track[-1]))
        apart = float(np.linalg.norm(track[-1] - goals, axis=1).max())
        held = held + 1 if apart <= metrics.AT_GOAL * mission.spacing else 0
        if held == metrics.HELD_ROUNDS:
            break
    return Flight(track=np.array(track), goals=goals, places=scene.places, per_round=per_round)


def _rows(positions: Points) -> list[Point]:
    return [tuple(row) for row in positions.tolist()]


def _wish(mission: Mission, position: Point, stop: Point) -> Point:
    """One step straight to a point."""
    return towards(position, stop, mission.max_step)


def ours(switch: Callable[[], AbstractContextManager[Any]] = nullcontext, **changes: Any) -> Method:
    """The whole protocol with simulated models, or its motion alone where goals are fixed.

    To leave a mechanism out, give fields of the configuration that switch it off, or a context in which it is off, such
    as `lambda: unittest.mock.patch.object(module, "NAME", value)`. The context holds for the motion alone too. That has
    no configuration, so with other fields it is not flown.
    """

    def method(scene: Scene) -> Flight | None:
        with switch():
            if scene.fixed:
                return None if changes else motion_alone(scene)
            same = switch is nullcontext and not changes and scene.result is not None
            result = scene.result if same else llm_flock.run(**scene.options, **changes)
            assert result is not None
            places = places_of(result)
            # A robot without a place has not arrived: its goal is nowhere.
            goals = [
                (math.inf, math.inf) if plan is None or slot is None else plan.points[slot]
                for plan, slot in zip(result.plans, result.slots, strict=True)
            ]
            return Flight(track=result.positions, goals=np.array(goals), places=places)

    return method


def motion_alone(scene: Scene) -> Flight:
    """Safe steps in lockstep; each robot heads straight for its own goal, and hears those within radio range."""
    mission, goals = scene.mission, _rows(scene.goals)
    team = [ShieldedSafety(robot, mission, 0.0) for robot in range(mission.n_robots)]

    def advance(positions: Points) -> list[Points]:
        here = _rows(positions)
        said: dict[int, Course] = {j: one.course for j, one in enumerate(team) if one.course is not None}
        moves: list[Point] = []
        for robot, safety in enumerate(team):
            x = here[robot]
            seen = {j: y for j, y in enumerate(here) if j != robot and math.dist(x, y) <= mission.sensing}
            leg = leg_to(mission, x, goals[robot])
            wish = _wish(mission, x, leg.stop)
            heard = {
                j: course for j, course in said.items() if j in seen and math.dist(x, here[j]) <= mission.comm_range
            }
            observed = Observation(position=x, sensed=seen, courses=heard)
            step = safety.step(observed, wish, leg, metrics.AT_GOAL * mission.spacing)
            moves.append(step.waypoint)
        return [np.array(moves)]

    return fly(scene, scene.goals, advance)


def straight(scene: Scene) -> Flight:
    """Straight to the centrally assigned goals, or to the next corner of the way round obstacles, under the shield."""
    mission, goals = scene.mission, scene.goals
    aims = _rows(goals)

    def advance(positions: Points) -> list[Points]:
        here = _rows(positions)
        return [np.array([_shielded(mission, here, robot, aims[robot]) for robot in range(len(here))])]

    return fly(scene, goals, advance)


def _shielded(mission: Mission, here: Sequence[Point], robot: int, goal: Point) -> Point:
    x = here[robot]
    return shield.project(
        x,
        _wish(mission, x, leg_to(mission, x, goal).stop),
        [y for j, y in enumerate(here) if j != robot],
        safe_distance=mission.safe_distance,
        max_step=mission.max_step,
        also=lambda longest: static_half_spaces(x, mission, max_step=longest),
    )


def capt(scene: Scene) -> Flight | None:
    """Synchronised straight trajectories to goals that minimise the sum of squared distances.

    Turpin, Michael, Kumar: CAPT: Concurrent assignment and planning of trajectories for multiple robots (IJRR 2014).
    None without its conditions: goals may be interchanged, no obstacles, and starts and goals are each at least
    2 sqrt(2) R apart; R is half the safe distance.
    """
    mission, start, places = scene.mission, scene.start, scene.places
    apart = min(metrics.min_separation(start), metrics.min_separation(places))
    if scene.fixed or mission.obstacles or apart < math.sqrt(2.0) * mission.safe_distance:
        return None
    distances = cdist(start, places)
    goals = places[linear_sum_assignment(distances**2)[1]]
    rounds = float(np.linalg.norm(goals - start, axis=1).max()) / mission.max_step
    shares = np.minimum(1.0, np.arange(math.ceil(rounds) + metrics.HELD_ROUNDS) / rounds)
    return Flight(track=start + shares[:, None, None] * (goals - start), goals=goals, places=places)


SUBSTEPS = 10
"""Velocities that an ORCA robot chooses in a round."""

STRAY_RAD = 0.1
"""Standard deviation by which wanted directions are off: robots on perfectly symmetric ways would wait for ever."""


def orca(scene: Scene, horizon: float, *, shielded: bool = False) -> Flight | None:
    """ORCA with centrally assigned goals, and velocities that are safe for a `horizon` [rounds].

    None with obstacles, and in space.

    Every robot knows the positions and velocities of all, and chooses a velocity `SUBSTEPS` times a round. Under the
    shield, robots fly straight to where ORCA would lead them within the round, as far as that is safe.
    """
    if scene.mission.obstacles or scene.mission.dim != 2:
        return None
    mission, goals, rng = scene.mission, scene.goals, random.Random(0)
    aims, period, speeds = to_complex(goals), 1.0 / SUBSTEPS, [0j] * len(goals)

    def advance(positions: Points) -> list[Points]:
        track, here = [], to_complex(positions)
        for _ in range(SUBSTEPS):
            stray = (complex(1.0, rng.gauss(0.0, STRAY_RAD)) for _ in here)
            wishes = [(aim - x) / period * turn for aim, x, turn in zip(aims, here, stray, strict=True)]
            limits = {"diameter": mission.safe_distance, "longest": mission.max_step}
            speeds[:] = orca_velocities(here, speeds, wishes, **limits, horizon=horizon, period=period)
            here = [x + period * v for x, v in zip(here, speeds, strict=True)]
            track.append(np.array([(x.real, x.imag) for x in here]))
        if not shielded:
            return track
        rows, ends = _rows(positions), _rows(track[-1])
        flown = [_shielded(mission, rows, robot, ends[robot]) for robot in range(len(rows))]
        speeds[:] = [complex(*to) - complex(*x) for x, to in zip(rows, flown, strict=True)]
        return [np.array(flown)]

    return fly(scene, goals, advance, 1 if shielded else SUBSTEPS)


METHODS: dict[str, Method] = {
    "ours": ours(),
    "ours without right of way": ours(lambda: mock.patch.object(RightOfWay, "ways", return_value=[])),
    "ORCA, horizon 2": partial(orca, horizon=2.0),
    "ORCA, horizon 0.5": partial(orca, horizon=0.5),
    "central, straight": straight,
    "CAPT": capt,
}
"""What is compared, in the order of the table. A variant of ours is one line: `"ours without X": ours(...)`."""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """One flight: round of arrival, None without one; the same over the lower bound; distance over the optimum."""

    arrived: int | None
    ratio: float
    detour: float
    separation: float
    violated: bool


def measure(scene: Scene, flight: Flight) -> Figures:
    """The figures of a flight; ratio and detour are meaningless where not all robots arrived."""
    mission, track = scene.mission, flight.track
    arrived = arrival(flight, metrics.AT_GOAL * mission.spacing)
    bound = bound_rounds(mission, scene.start, flight.places, scene.fixed)
    flown = track[: (arrived or 0) * flight.per_round + 1]
    distance = float(np.linalg.norm(np.diff(flown, axis=0), axis=2).sum())
    if scene.fixed:
        shortest = float(np.diagonal(mission.shortest_ways(scene.start, scene.places)).sum())
    else:
        ways = mission.shortest_ways(scene.start, flight.places)
        shortest = float(ways[linear_sum_assignment(ways)].sum())
    separation = min(metrics.segment_separation(before, after) for before, after in pairwise(track))
    return Figures(
        arrived=arrived,
        ratio=(arrived or 0) / bound,
        detour=distance / shortest,
        separation=separation,
        violated=separation < mission.safe_distance - ROUNDING,
    )


def trial(case: str, seed: int) -> dict[str, Figures | None]:
    """The figures of each method in one trial; None where its conditions do not hold."""
    scene = scene_of(case, seed)
    flights = {name: method(scene) for name, method in METHODS.items()}
    return {name: None if flight is None else measure(scene, flight) for name, flight in flights.items()}


def row(case: str, method: str, trials: Sequence[Figures | None]) -> str:
    """A row of the table; medians are those of the trials in which all robots arrived."""
    flown = [figures for figures in trials if figures is not None]
    if not flown:
        return f"| {case} | {method} |{' - |' * 6}"
    good = [figures for figures in flown if figures.arrived is not None]
    share = wilson(len(good), len(flown))
    cells = [case, method, f"{len(good)} of {len(flown)} [{100 * (share.low or 0):.0f}, {100 * (share.high or 0):.0f}]"]
    if good:
        ratios = [figures.ratio for figures in good]
        cells.append(f"{statistics.median(figures.arrived or 0 for figures in good):g}")
        cells.append(f"{statistics.median(ratios):.2f}, {max(ratios):.2f}")
        cells.append(f"{statistics.median(figures.detour for figures in good):.2f}")
    else:
        cells.extend("---")
    cells.append(f"{min(figures.separation for figures in flown):.6f}")
    cells.append(str(sum(figures.violated for figures in flown)))
    return f"| {' | '.join(cells)} |"


HEAD = (
    "\n| Case | Method | Arrivals [95 %] | Rounds | Over the bound: median, largest | Distance over the optimum "
    "| Smallest separation | Violations |\n|---|---|---|---|---|---|---|---|"
)


def main(arguments: Sequence[str] = ()) -> None:
    """The table, a few rows at a time."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks arrivals")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--case", choices=(*CASES, *FIXED), action="append", help="this case only; may be repeated")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)
    print(f"{options.seeds} seeds each, simulated language models", flush=True)
    print(HEAD)
    with ProcessPoolExecutor(options.jobs) if options.jobs > 1 else nullcontext() as pool:
        for case in options.case or (*CASES, *FIXED):
            seeds, fly_one = range(options.seeds), partial(trial, case)
            trials = list(map(fly_one, seeds) if pool is None else pool.map(fly_one, seeds))
            for method in METHODS:
                name = f"{method} (motion alone)" if case in FIXED and method.startswith("ours") else method
                print(row(case, name, [figures[method] for figures in trials]), flush=True)
