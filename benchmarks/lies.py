"""Members with valid keys that lie, alone and together: who of the honest is hurt, and who still forms.

    python -m benchmarks lies [--runs N]            every lie of tests/lies.py in the simulator, 1 and 2 liars among 10
    python -m benchmarks lies-curve [--runs N]      teams of 10, 20 and 40 with 0 .. N/3 liars that collude
    python -m benchmarks lies-swarm [--runs N]      every lie against a keyed swarm of processes

An honest robot counts as formed if all the honest are within 5 % of the spacing of different places of one plan, for
three rounds. Planners are geometry in the simulator; no language model is asked.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Point
from llm_flock.experiments.statistics import wilson
from llm_flock.mission import Mission
from llm_flock.robots.simulated import start_positions

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

ROUNDS = 80
COMM_ROUNDS = 5
CURVE = ((10, (0, 1, 2, 3)), (20, (0, 1, 2, 4, 6)), (40, (0, 1, 4, 8, 13)))


@dataclass(frozen=True)
class Outcome:
    """One team under one lie."""

    formed: int | None  # round in which the honest had formed; None if they did not
    separation: float  # smallest distance of two honest bodies [units]
    ended: int  # honest robots that an exception ended


def mission_of(n: int) -> Mission:
    """A circle of n in an arena that fits it."""
    side = max(100.0, 4.5 * n)
    return Mission(shape="circle", n_robots=n, center=(side / 2, side / 2), arena=((0.0, 0.0), (side, side)))


def fly(lie: str, n: int, liars: int, seed: int, rounds: int = ROUNDS) -> Outcome:
    """A team of n, the last of which lie together, in lockstep; their bodies fly off and stay away."""
    from lies import Gang
    from signed_team import SignedTeam
    from toy_keys import ToyKeys

    rng = np.random.default_rng([seed, n, liars])
    mission = mission_of(n)
    places: list[Point] = [tuple(row) for row in start_positions(mission, None, "connected", rng).tolist()]
    team = SignedTeam(mission, places, seed=seed, liars=liars)
    gang = Gang({j: ToyKeys(j) for j in range(n - liars, n)}, mission, seed)
    held = 0
    for number in range(1, rounds + 1):
        try:
            team.begin()
            said: list[bytes] = []
            for _ in range(COMM_ROUNDS):
                for payload in said:
                    gang.hear(payload)
                said = team.comm_round(said_by=gang.says(lie))
            team.end(moves={j: away(mission, j, team.positions[j]) for j in gang.members})
        except Exception as error:  # noqa: BLE001 - what is counted here
            print(f"{lie}, {n} robots, {liars} liars, seed {seed}: {error!r}", file=sys.stderr)
            return Outcome(None, team.smallest, 1)
        held = held + 1 if in_place(team) else 0
        if held == metrics.HELD_ROUNDS:
            return Outcome(number - held + 1, team.smallest, 0)
    return Outcome(None, team.smallest, 0)


def away(mission: Mission, robot: int, here: Point) -> Point:
    """A step towards the robot's own spot at the wall."""
    to = (4.0 * (mission.n_robots - robot), 1.0)
    distance = math.dist(here, to)
    share = min(1.0, mission.max_step / distance) if distance else 1.0
    return tuple(x + share * (y - x) for x, y in zip(here, to, strict=True))


def in_place(team: object) -> bool:
    """Whether the honest are at different places of one plan."""
    from signed_team import SignedTeam

    assert isinstance(team, SignedTeam)
    plans, slots = {agent.plan for agent in team.agents}, [agent.claim.slot for agent in team.agents]
    if len(plans) != 1 or None in plans or None in slots or len(set(slots)) != len(slots):
        return False
    near = metrics.AT_GOAL * team.mission.spacing
    goals = [agent.goal for agent in team.agents]
    return all(goal is not None and math.dist(goal, x) <= near for goal, x in zip(goals, team.positions, strict=False))


def line(name: str, n: int, liars: int, outcomes: Sequence[Outcome]) -> str:
    """One row of a table."""
    formed = [outcome.formed for outcome in outcomes if outcome.formed is not None]
    share = wilson(len(formed), len(outcomes))
    closest = min(outcome.separation for outcome in outcomes)
    violations = sum(outcome.separation < 3.0 - 1e-6 for outcome in outcomes)
    rounds = f"{sorted(formed)[len(formed) // 2]}" if formed else "-"
    return (
        f"{name:34} {n:3} robots {liars:2} liars  formed {share.value:6.1%} [{share.low:.1%}, {share.high:.1%}]  "
        f"rounds {rounds:>3}  separation {closest:.3f}  violations {violations}  ended {sum(o.ended for o in outcomes)}"
    )


def main(arguments: Sequence[str] = ()) -> None:
    """Every lie, one liar and two."""
    from lies import EVERYTHING, LIES

    runs = _runs(arguments, 20)
    for liars in (1, 2):
        for lie in (*LIES, EVERYTHING):
            print(line(lie, 10, liars, [fly(lie, 10, liars, seed) for seed in range(runs)]), flush=True)


def curve(arguments: Sequence[str] = ()) -> None:
    """The worst lies against ever more liars."""
    runs = _runs(arguments, 20)
    for n, counts in CURVE:
        for liars in counts:
            for lie in WORST if liars else ("silence",):
                print(line(lie, n, liars, [fly(lie, n, liars, seed) for seed in range(runs)]), flush=True)


WORST = ("frees every place and takes one", "frees every place all the time", "exchanges what others own")


def _runs(arguments: Sequence[str], default: int) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks lies")
    parser.add_argument("--runs", type=int, default=default)
    return parser.parse_args(arguments).runs
