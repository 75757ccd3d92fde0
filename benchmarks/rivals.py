"""Rivals of the project, and what its language models add: docs/explanation/comparison.md.

    python -m benchmarks.rivals [--trials N] [--jobs J] [--out FILE]     100 trials of each row, one process

All fly from the same separated starts, on the same bodies, with the same radio and number of rounds; rivals with the
shield and without it. Language models are *simulated*. Means are those of the trials that formed.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from benchmarks import figures
from benchmarks.arrivals import measure, orca
from benchmarks.readings import text, write
from benchmarks.scenes import Scene
from scipy.optimize import linear_sum_assignment

import llm_flock
from llm_flock import metrics
from llm_flock.mission import Mission
from llm_flock.runtime import RunResult
from llm_flock_lab import RIVALS, Rival, fly_rival
from llm_flock_lab._experiments.statistics import mean_interval, wilson

OUT = Path(__file__).parents[1] / "docs" / "data" / "rivals.csv"
TEAMS = (("circle", 10), ("square", 8))

OURS: Mapping[str, Mapping[str, Any]] = {
    "flock, ideal models": {},
    "flock, one model for the team": {"model": "simulated:canonical"},
    "flock, geometry alone": {"model": "geometry"},
    "flock, random answers": {"model": "simulated:random"},
    "flock, random answers, no breaker": {"model": "simulated:random", "fallback": "hold"},
    "flock, random answers, geometry plans": {"model": "simulated:random", "fallback": "geometry"},
    "flock, one good model, random answers": {"model": "0=simulated:ideal,1-{last}=simulated:random"},
    "flock, all hear all": {"comm_range": 150.0, "sense_range": 15.0},
    "the paper's rules (text)": {"protocol": "paper"},
    "the authors' program (rules)": {"protocol": "released"},
    "no consensus (baseline)": {"protocol": "baseline"},
}
"""Fields of the configuration; the last robot has the id {last}. The default protocol flies with its shield only."""


@dataclass(frozen=True, kw_only=True)
class Flown:
    """One trial: rounds over the lower bound, and distance over the optimum, if it formed; bytes and messages a robot.

    Lengths in units; calls and tokens of the whole team.
    """

    formed: bool
    ratio: float
    detour: float
    separation: float
    messages: float
    bytes: float
    calls: int
    tokens: int


Method: TypeAlias = Callable[[Mission, bool, int], Flown | None]
"""Flies a mission with the shield or without it, from the starts of a seed; None where its conditions do not hold."""


def figures_of(result: RunResult, messages: float, size: float) -> Flown:
    summary, plan = result.summary, result.plans[0]
    ratio = detour = math.nan
    if summary.formed and plan is not None:
        flown = np.linalg.norm(np.diff(result.positions[: (summary.rounds_to_formed or 0) + 1], axis=0), axis=2).sum()
        ways = metrics.straight(result.positions[0], plan.array)
        shortest = ways[linear_sum_assignment(ways)].sum()
        ratio, detour = (summary.rounds_to_formed or 0) / max(1, summary.lower_bound_rounds or 0), flown / shortest
    return Flown(
        formed=summary.formed,
        ratio=ratio,
        detour=float(detour),
        separation=math.inf if summary.min_separation is None else summary.min_separation,
        messages=messages,
        bytes=size,
        calls=summary.model_calls,
        tokens=summary.tokens,
    )


def ours(options: Mapping[str, Any], mission: Mission, shield: bool, seed: int) -> Flown | None:
    """The whole protocol, which has a shield and flies with it; or another one, with the shield or without it."""
    if not shield and "protocol" not in options:
        return None
    if "protocol" in options:
        options = {**options, "shield": shield}
    last = mission.n_robots - 1
    filled: dict[str, Any] = {
        name: value.format(last=last) if isinstance(value, str) else value for name, value in options.items()
    }
    there = {name: value for name, value in filled.items() if name in Mission.model_fields}
    rest = {name: value for name, value in filled.items() if name not in there}
    result = llm_flock.run(mission.change(**there), seed=seed, trace=False, **rest)
    return figures_of(result, *Rival(source="", assumes="").traffic(result))


def rival(name: str, mission: Mission, shield: bool, seed: int) -> Flown | None:
    result = fly_rival(name, mission, seed=seed, shield=shield)
    return figures_of(result, *RIVALS[name].traffic(result))


def capt_by_its_conditions(mission: Mission, shield: bool, seed: int) -> Flown | None:
    """CAPT where starts and goals are 2 sqrt(2) R apart, of bodies whose radius R is half the safe distance."""
    result = fly_rival("CAPT", mission, seed=seed, shield=shield)
    plan = result.plans[0]
    assert plan is not None
    near = min(metrics.min_separation(result.positions[0]), metrics.min_separation(plan.array))
    return (
        None if near < math.sqrt(2.0) * mission.safe_distance else figures_of(result, *RIVALS["CAPT"].traffic(result))
    )


def by_orca(horizon: float, mission: Mission, shield: bool, seed: int) -> Flown:
    """ORCA, sent by a station to the places of the bottleneck assignment."""
    name = "central, bottleneck"
    sent = fly_rival(name, mission, seed=seed, shield=False)
    assert sent.plans[0] is not None
    scene = Scene(mission=mission, start=sent.positions[0], places=sent.plans[0].array, options={})
    flight = orca(scene, horizon, shielded=shield)
    assert flight is not None
    found, (messages, size) = measure(scene, flight), RIVALS[name].traffic(sent)
    return Flown(
        formed=found.arrived is not None,
        ratio=found.ratio,
        detour=found.detour,
        separation=found.separation,
        messages=messages,
        bytes=size,
        calls=0,
        tokens=0,
    )


METHODS: dict[str, Method] = {
    **{name: partial(ours, options) for name, options in OURS.items()},
    **{name: partial(rival, name) for name in RIVALS},
    "CAPT, by its conditions": capt_by_its_conditions,
    "ORCA, horizon 2": partial(by_orca, 2.0),
    "ORCA, horizon 0.5": partial(by_orca, 0.5),
}
"""What is compared, in the order of the tables."""


def fly(name: str, team: tuple[str, int], shield: bool, seed: int) -> Flown | None:
    return METHODS[name](Mission(shape=team[0], n_robots=team[1]), shield, seed)


FORMED, RATIO, DETOUR, NEAREST = (
    "formed (%)",
    "rounds/bound",
    "distance/optimum",
    "smallest separation",
)
WITHOUT = ", no shield"
COSTS = ("messages a robot", "bytes a robot", "model calls", "tokens")


def row(name: str, team: tuple[str, int], shield: bool, trials: Sequence[Flown]) -> dict[str, str | int]:
    """A row of the table; costs are means over all trials."""
    good = [one for one in trials if one.formed]
    near = Mission(shape=team[0], n_robots=team[1]).safe_distance - metrics.ROUNDING
    costs = {
        COSTS[0]: f"{np.mean([one.messages for one in trials]):.1f}",
        COSTS[1]: f"{np.mean([one.bytes for one in trials]):.0f}",
        COSTS[2]: f"{np.mean([one.calls for one in trials]):.1f}",
        COSTS[3]: f"{np.mean([one.tokens for one in trials]):.0f}",
    }
    return {
        "shape": team[0],
        "robots": team[1],
        "method": name,
        "shield": "yes" if shield else "no",
        "trials": len(trials),
        FORMED: text(wilson(len(good), len(trials)), 100, 0),
        RATIO: text(mean_interval([one.ratio for one in good]), digits=2) if good else "",
        DETOUR: text(mean_interval([one.detour for one in good]), digits=2) if good else "",
        NEAREST: f"{min(one.separation for one in trials):.3f}",
        "trials below the safe distance": sum(one.separation < near for one in trials),
        **costs,
    }


def rows(trials: int, jobs: int) -> list[dict[str, str | int]]:
    """A row for each team, method and shield, in this order."""
    table: list[dict[str, str | int]] = []
    with ProcessPoolExecutor(jobs) if jobs > 1 else nullcontext() as pool:
        for team in TEAMS:
            for name in METHODS:
                for shield in (True, False):
                    trial, seeds = partial(fly, name, team, shield), range(trials)
                    found = map(trial, seeds) if pool is None else pool.map(trial, seeds, chunksize=5)
                    if flown := [one for one in found if one is not None]:
                        table.append(row(name, team, shield, flown))
                        print(*table[-1].values(), sep=" | ", flush=True)
    return table


def side_by_side(table: Sequence[dict[str, str | int]], team: tuple[str, int]) -> list[dict[str, str | int]]:
    """The rows of a team with the shield and without it beside each other: means without their intervals."""
    found: dict[str, dict[str, str | int]] = {}
    for given in table:
        if (given["shape"], given["robots"]) != team:
            continue
        name, shielded = str(given["method"]), given["shield"] == "yes"
        ends = ("", WITHOUT)
        empty: dict[str, str | int] = dict.fromkeys(
            [f"{figure}{end}" for figure in (FORMED, RATIO, DETOUR) for end in ends], ""
        )
        line = found.setdefault(name, {"method": name, **empty, f"{NEAREST}{WITHOUT}": ""})
        end = "" if shielded else WITHOUT
        line[f"{FORMED}{end}"] = given[FORMED]
        for figure in (RATIO, DETOUR):
            line[f"{figure}{end}"] = str(given[figure]).partition(" ")[0]
        if shielded:
            line.update({cost: given[cost] for cost in COSTS})
        else:
            line[f"{NEAREST}{end}"] = given[NEAREST]
    return list(found.values())


ORCA = {
    "method": "ORCA",
    "assumes": "places from a station; positions and velocities of all, ten times a round",
    "source": "van den Berg, Guy, Lin and Manocha: Reciprocal n-body collision avoidance. In: Robotics Research. "
    "Springer, 2011",
}


def sources() -> list[dict[str, str | int]]:
    """What each rival assumes beyond its own sensors and radio, and where it comes from."""
    return [*({"method": name, "assumes": one.assumes, "source": one.source} for name, one in RIVALS.items()), {**ORCA}]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args(arguments)
    table = rows(given.trials, given.jobs)
    write(given.out, table)
    write(given.out.with_stem(f"{given.out.stem}-sources"), sources())
    for team in TEAMS:
        write(given.out.with_stem(f"{given.out.stem}-{team[0]}"), side_by_side(table, team))
    if given.out == OUT:
        figures.stamp("rivals.csv", "rivals-sources.csv", *(f"rivals-{shape}.csv" for shape, _ in TEAMS))


if __name__ == "__main__":
    main()
