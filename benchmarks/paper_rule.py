"""How often does the paper's rule, taken literally, end on one plan and on distinct goals?

    python benchmarks/paper_rule.py [--trials 1000] [--rounds 25]

Every robot runs the package's own agent with `influence` consensus, literal `nearest` assignment and no shield. The
models are ideal: each proposes the exact shape, randomly turned about the centre and rounded to two decimals, and
every step goes straight to the goal. What the paper leaves open is a column: where the robots start (uniform in the
arena; the same but never nearer than the safe distance; uniform in the middle 40 x 40 units), which index a model
names for itself, how many exchanges there are in a round, and who wins among equally influential neighbours.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.stats import beta

from llm_flock import shapes as formations
from llm_flock.agent import Agent
from llm_flock.algorithm1 import nearest_available
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    MoveTo,
    Planned,
    Received,
    RoundBegan,
)
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer, StepAnswer
from llm_flock.protocol._agreement.assignment import NearestAssignment
from llm_flock.protocol._agreement.consensus import InfluenceConsensus, TieBreak
from llm_flock.protocol._parts import Parts
from llm_flock.simulate import Readings, draw_start

Index: TypeAlias = Literal["id", "first", "random", "nearest"]
Start: TypeAlias = Literal["uniform", "separated", "middle"]

MIDDLE = (30.0, 70.0)

CASES = (("triangle", 3), ("triangle", 6), ("square", 8), ("circle", 10))


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One way to read what the paper leaves open."""

    shape: str
    n: int
    start: Start
    index: Index
    comm_rounds: int
    tie: TieBreak


def trial(reading: Reading, rounds: int, seed: int) -> tuple[bool, bool]:
    """One run; returns (all on one plan, and on distinct goals too)."""
    mission = Mission(shape=reading.shape, n_robots=reading.n)
    rng = np.random.default_rng([seed, reading.n])
    if reading.start == "middle":
        start = rng.uniform(*MIDDLE, (reading.n, 2))
    else:
        start = draw_start(mission, reading.start, rng)
    bodies = Readings(mission, start, 0.0, rng)
    agents = [
        Agent(i, mission, parts=Parts(consensus=InfluenceConsensus(tie=reading.tie), assignment=NearestAssignment()))
        for i in range(reading.n)
    ]
    for number in range(1, rounds + 1):
        for i, agent in enumerate(agents):
            seen = bodies.sense(i)
            began = RoundBegan(
                round=number,
                position=seen.position,
                degree=len(bodies.in_radio_range[i]),
                sensed=seen.sensed,
                observed=(),
            )
            for effect in agent.handle(began):
                if isinstance(effect, AskPlan):
                    agent.handle(Planned(propose(mission, reading.index, i, seen.position, rng)))
        for _ in range(reading.comm_rounds):
            exchange(agents, bodies.in_radio_range)
        waypoints = [settle(agent, mission.max_step) for agent in agents]
        bodies.move(np.array(waypoints) - bodies.places)
    one_plan = len({a.plan for a in agents}) == 1
    return one_plan, one_plan and len({a.claim.slot for a in agents}) == reading.n


def exchange(agents: Sequence[Agent], in_range: Sequence[tuple[int, ...]]) -> None:
    """All broadcast, all receive, all decide on the same snapshot."""
    payloads = [e.payload for a in agents for e in a.handle(CommRoundBegan()) if isinstance(e, Broadcast)]
    for agent, near in zip(agents, in_range, strict=True):
        for j in near:
            agent.handle(Received(payloads[j]))
    for agent in agents:
        agent.handle(CommRoundEnded())


def propose(
    mission: Mission, index: Index, robot: int, position: tuple[float, ...], rng: np.random.Generator
) -> PlanAnswer:
    """An ideal model's plan, at a random orientation."""
    turned = formations.rotated(np.array(mission.ideal), mission.center, float(rng.uniform(0, 2 * math.pi)))
    plan = Plan.of(turned.round(2).tolist())
    if index in ("id", "first"):
        return PlanAnswer(plan=plan, slot=robot if index == "id" else 0)
    slot = int(rng.integers(0, len(plan))) if index == "random" else nearest_available(position, plan.points)
    return PlanAnswer(plan=plan, slot=slot)


def settle(agent: Agent, max_step: float) -> tuple[float, ...]:
    """The straight step to the goal."""
    (ask,) = agent.handle(AgreementEnded())
    assert isinstance(ask, AskStep)
    here, goal = ask.question.position, ask.question.goal
    share = min(1.0, max_step / max(math.dist(here, goal), 1e-12))
    step = tuple(a + share * (b - a) for a, b in zip(here, goal, strict=True))
    moves = [e for e in agent.handle(Decided(StepAnswer(waypoint=step))) if isinstance(e, MoveTo)]
    agent.handle(Arrived())
    return moves[0].waypoint


def count(reading: Reading, trials: int, rounds: int) -> tuple[Reading, int, int]:
    """All trials of one reading; seeds are 0 .. trials - 1."""
    ends = [trial(reading, rounds, seed) for seed in range(trials)]
    return reading, sum(a for a, _ in ends), sum(b for _, b in ends)


def interval(successes: int, trials: int, level: float = 0.99) -> tuple[float, float]:
    """Clopper-Pearson interval of a share."""
    tail = (1 - level) / 2
    low = 0.0 if successes == 0 else float(beta.ppf(tail, successes, trials - successes + 1))
    high = 1.0 if successes == trials else float(beta.ppf(1 - tail, successes + 1, trials - successes))
    return low, high


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args(arguments)
    starts: tuple[Start, ...] = ("uniform", "separated", "middle")
    indices: tuple[Index, ...] = ("id", "first", "random", "nearest")
    ties: tuple[TieBreak, ...] = ("lowest", "highest")
    readings = [
        Reading(shape=shape, n=n, start=start, index=index, comm_rounds=comm_rounds, tie=tie)
        for (shape, n), start, index, comm_rounds, tie in itertools.product(CASES, starts, indices, (1, 5), ties)
    ]
    print(f"{given.trials} trials a row, {given.rounds} rounds, share in % with 99 % interval (Clopper-Pearson)\n")
    print("| N | shape | start | first index | exchanges | tie | one plan | one plan and distinct goals |")
    print("|---|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(given.workers) as pool:
        jobs = [pool.submit(count, reading, given.trials, given.rounds) for reading in readings]
        for job in jobs:
            r, one, distinct = job.result()
            print(
                f"| {r.n} | {r.shape} | {r.start} | {r.index} | {r.comm_rounds} | {r.tie} | {share(one, given.trials)} "
                f"| {share(distinct, given.trials)} |",
                flush=True,
            )


def share(successes: int, trials: int) -> str:
    """A share and its interval, in per cent."""
    low, high = interval(successes, trials)
    return f"{100 * successes / trials:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


if __name__ == "__main__":
    main()
