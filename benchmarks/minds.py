"""Models that wait, wander or lag: does the team form all the same? Judged from positions alone.

    python -m benchmarks.minds [--seeds N] [--few N] [--jobs J] [--mind M,...] [--team T,...] [--share S,...] [--write]

Each *simulated* mind answers one, half, all but one or all of a team, and good models the rest. A judge of its own
looks at the flown positions: the distances between all robots have to be those of the ideal shape, about its centre,
for three rounds. Calls are compared with those of good models on the same seeds: those of the whole run, and those of
the rounds after the first circuit breaker of the run has opened. With `--write`, docs/data/minds.csv gets a row for
each mind.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from benchmarks import figures

import llm_flock
from llm_flock.arrays import Point, Points
from llm_flock.llm._port import Call
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.llm._simulated.prompt_reader import STEP_MARK, StepPrompt, read_step, read_task
from llm_flock.record._schema import State

ROUNDS = 300
NEAR = 4.5  # a wary mind waits if a robot is as near to its step [units]

MINDS = {
    "still": "always its own position",
    "wary": f"its own position whenever a robot is within {NEAR} of its step",
    "collapse": "the middle of the robots that it sees",
    "away": "a full step away from its goal",
    "alternating": "to its goal and back in turns",
    "sideways": "a full step across its way",
    "creeping": "a twentieth of a step towards its goal",
    "stale": "the answer to its question of three questions ago",
    "fourth": "right every fourth time, else its own position",
}

TEAMS: dict[str, dict[str, Any]] = {
    "circle 10": {"shape": "circle", "n_robots": 10},
    "clump 10": {"shape": "circle", "n_robots": 10, "start_area": ((43.0, 43.0), (57.0, 57.0))},
    "square 8": {"shape": "square", "n_robots": 8},
    "line 7": {"shape": "line", "n_robots": 7},
    "corner 2": {"shape": "line", "n_robots": 2, "start_area": ((5.0, 5.0), (11.2, 11.2))},
    "clump 3": {"shape": "triangle", "n_robots": 3, "start_area": ((5.0, 5.0), (12.0, 12.0))},
    "clump 4": {"shape": "square", "n_robots": 4, "start_area": ((5.0, 5.0), (13.0, 13.0))},
    "clump 5": {"shape": "cross", "n_robots": 5, "start_area": ((5.0, 5.0), (14.0, 14.0))},
    "clump 6": {"shape": "circle", "n_robots": 6, "start_area": ((5.0, 5.0), (15.0, 15.0))},
}
MAIN = ("circle 10", "clump 10")

SHARES = ("one", "half", "all but one", "all")


class Mind:
    """A *simulated* model with a bad habit in steps; its plans are good."""

    simulated = True

    def __init__(self, kind: str, seed: int) -> None:
        profile = "collapse" if kind == "collapse" else "ideal"
        self._good = SimulatedModel(parse_profile(profile), np.random.default_rng(seed))
        self._kind = kind
        self._asked: list[StepPrompt] = []
        self.rounds: list[int] = []  # of all calls

    async def ask(self, call: Call) -> str:
        self.rounds.append(call.round)
        conversation = [(message.role, message.text) for message in call.messages]
        text = next((text for role, text in reversed(conversation) if role == "user" and STEP_MARK in text), None)
        if text is None or self._kind in ("collapse", "good"):
            return self._good.answer(conversation)
        prompt = read_step(text, read_task(conversation[0][1]))
        self._asked.append(prompt)
        return prompt.stated([prompt.rounded(self._choose(prompt))])

    def _choose(self, prompt: StepPrompt) -> Point:
        here, right = prompt.position, _right(prompt)
        match self._kind:
            case "wary":
                near = min((_from_step(other, here, right) for other in prompt.seen()), default=math.inf)
                return here if near < NEAR else right
            case "away":
                return _beside(here, right, -1.0, 0.0)
            case "alternating":
                return right if len(self._asked) % 2 else _beside(here, right, -1.0, 0.0)
            case "sideways":
                return _beside(here, right, 0.0, 1.0)
            case "creeping":
                return _beside(here, right, 0.05, 0.0)
            case "stale":
                return _right(self._asked[max(0, len(self._asked) - 4)])
            case "fourth":
                return here if len(self._asked) % 4 else right
            case "still":
                return here
            case _:
                return right


def _right(prompt: StepPrompt) -> Point:
    return prompt.goal if math.dist(prompt.position, prompt.goal) <= prompt.reach else prompt.towards(prompt.goal)


def _from_step(point: Point, here: Point, there: Point) -> float:
    """The distance of a point from the step from here to there [units]."""
    a, b, x = np.array(here), np.array(there), np.array(point)
    share = np.clip((x - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-18), 0.0, 1.0)
    return float(np.linalg.norm(x - a - share * (b - a)))


def _beside(here: Point, right: Point, along: float, across: float) -> Point:
    x, y = (b - a for a, b in zip(here, right, strict=True))
    return here[0] + along * x - across * y, here[1] + along * y + across * x


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What the judge saw of a run; `calls` are those of the whole team, `later` those after the first open breaker."""

    formed: int | None
    separation: float
    calls: int
    later: int
    says: bool


def judge(positions: Points, ideal: Points, spacing: float) -> int | None:
    """The first of three rounds in a row in which the robots are in the shape, None if there is none."""
    wanted, held = _apart(ideal), 0
    for number, places in enumerate(positions):
        right = np.abs(_apart(places) - wanted).max() <= 0.1 * spacing
        held = held + 1 if right and math.dist(places.mean(axis=0), ideal.mean(axis=0)) <= 0.1 * spacing else 0
        if held == 3:
            return number - 2
    return None


def _apart(places: Points) -> Points:
    """All distances between two places, in ascending order."""
    return np.sort(np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(len(places), 1)])


def separation(positions: Points) -> float:
    """The smallest distance between two robots along the segments that all fly at once."""
    before, after = positions[:-1], positions[1:]
    i, j = np.triu_indices(positions.shape[1], 1)
    gap, move = before[:, i] - before[:, j], (after - before)[:, i] - (after - before)[:, j]
    share = np.clip(-(gap * move).sum(axis=2) / np.maximum((move * move).sum(axis=2), 1e-18), 0.0, 1.0)
    return float(np.linalg.norm(gap + share[..., None] * move, axis=2).min())


@dataclass(frozen=True, kw_only=True)
class Cell:
    """What came of one mind in one share of one team; `calls` and `later` are over the calls of good models."""

    team: str
    mind: str
    share: str
    runs: int
    formed: int
    disputed: int  # runs about which the summary says another thing than the judge
    most: int
    separation: float
    calls: float
    later: float
    lost: list[int]

    @classmethod
    def of(cls, team: str, mind: str, share: str, seen: Sequence[Seen], good: Sequence[Seen]) -> Cell:
        lost, good_calls = [seed for seed, one in enumerate(seen) if one.formed is None], sum(one.calls for one in good)
        return cls(
            team=team,
            mind=mind,
            share=share,
            runs=len(seen),
            formed=len(seen) - len(lost),
            disputed=sum(one.says != (one.formed is not None) for one in seen),
            most=max((one.formed for one in seen if one.formed is not None), default=0),
            separation=min(one.separation for one in seen),
            calls=sum(one.calls for one in seen) / good_calls,
            later=sum(one.later for one in seen) / good_calls,
            lost=lost[:6],
        )


def fly(team: str, mind: str, share: str, seed: int) -> Seen:
    options: dict[str, Any] = {"start": "separated"} | TEAMS[team]
    n = int(options["n_robots"])
    bad = {"none": 0, "one": 1, "half": n // 2, "all but one": n - 1, "all": n}[share]
    models = [Mind(mind if k < bad else "good", 1000 * seed + k) for k in range(n)]
    result = llm_flock.run(model=models, seed=seed, rounds=ROUNDS, **options)
    states = (entry for entry in result.trace or () if isinstance(entry, State) and any(entry.open_breakers))
    opened = next((state.round for state in states), ROUNDS)
    ideal, spacing = np.array(result.mission.ideal), result.mission.spacing
    return Seen(
        formed=judge(result.positions, ideal, spacing),
        separation=separation(result.positions),
        calls=result.summary.model_calls,
        later=sum(when > opened for model in models for when in model.rounds),
        says=result.summary.formed,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=200, help=f"for {', '.join(MAIN)}")
    parser.add_argument("--few", type=int, default=30, help="for other teams")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    for name, known in (("mind", MINDS), ("team", TEAMS), ("share", SHARES)):
        parser.add_argument(f"--{name}", default=",".join(known))
    parser.add_argument("--write", action="store_true", help="write docs/data/minds.csv")
    given = parser.parse_args(arguments)
    cells = list[Cell]()
    with ProcessPoolExecutor(given.jobs) as pool:
        for team in given.team.split(","):
            seeds = range(given.seeds if team in MAIN else given.few)
            good = list(pool.map(partial(fly, team, "still", "none"), seeds))
            for mind, share in product(given.mind.split(","), given.share.split(",")):
                cell = Cell.of(team, mind, share, list(pool.map(partial(fly, team, mind, share), seeds)), good)
                cells.append(cell)
                print(cell, flush=True)
    if given.write:
        titles = [
            "Mind",
            *MAIN,
            "Other teams",
            "Most rounds",
            "Smallest separation",
            "Calls over good, most",
            "After a breaker",
        ]
        figures.write("minds.csv", [titles, *(_row(mind, cells) for mind in given.mind.split(","))])


def _row(mind: str, cells: Sequence[Cell]) -> list[str]:
    """The figures of a mind over all shares and teams."""
    mine = [cell for cell in cells if cell.mind == mind]
    others = [cell for cell in mine if cell.team not in MAIN]
    formed = [
        f"{sum(cell.formed for cell in some):,} of {sum(cell.runs for cell in some):,}"
        for some in (*([cell for cell in mine if cell.team == team] for team in MAIN), others)
    ]
    figures = max(cell.most for cell in mine), f"{min(cell.separation for cell in mine):.3f}"
    calls = f"{max(cell.calls for cell in mine):.2f}", f"{max(cell.later for cell in mine):.2f}"
    return [MINDS[mind], *formed, *map(str, figures), *calls]


if __name__ == "__main__":
    main()
