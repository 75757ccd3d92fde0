"""What late and wrong sensors and moving obstacles cost, judged from true positions: writes docs/data/sensing.csv.

    python -m benchmarks.sensing [--seeds N] [--jobs J] [--case WORD] [--no-write]

Models are *simulated* and ideal. A judge of its own looks at the true positions of every run: when the team was in its
shape, and how near two robots, or a robot and an obstacle, came to each other on the way. Obstacles cross the circle
in which the team stands, from random directions, and leave the arena; rounds count from when the last of them is
farther from all places than two of its own moves and two of a robot's.
"""

from __future__ import annotations

import argparse
import csv
import math
import statistics
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from benchmarks.figures import ROOT, stamp
from benchmarks.minds import judge, separation

import llm_flock
from llm_flock.arrays import Points
from llm_flock.obstacles import MovingObstacle

TABLE = ROOT / "docs" / "data" / "sensing.csv"
CENTER, BEGIN, END = np.array([50.0, 50.0]), 42.0, 75.0  # how far from the centre obstacles begin, and end [units]
FORMED_BY = 25  # round after which obstacles set out where the team is to stand in its shape by then

TEAMS: dict[str, dict[str, Any]] = {
    "circle 10": {"shape": "circle", "n_robots": 10},
    "square 8": {"shape": "square", "n_robots": 8},
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """Options of a run, and its obstacles: their number, and ranges of radius [units] and speed [units per round]."""

    options: dict[str, Any] = field(default_factory=dict)
    obstacles: int = 0
    radius: tuple[float, float] = (1.5, 3.0)
    speed: tuple[float, float] = (1.5, 3.0)
    since: int = FORMED_BY


CASES = {
    "exact": Case(),
    "noise 0.5": Case(options={"noise": 0.5}),
    "drift 0.5": Case(options={"drift": 0.5}),
    "0.1 rounds late, range 20": Case(options={"sensing_delay": 0.1, "sense_range": 20}),
    "0.1 rounds late, range 20, noise 0.2, drift 0.2": Case(
        options={"sensing_delay": 0.1, "sense_range": 20, "noise": 0.2, "drift": 0.2}
    ),
    "half a round late": Case(options={"sensing_delay": 0.5}),
    "a round late": Case(options={"sensing_delay": 1}),
    "two rounds late, noise 0.2, drift 0.2": Case(options={"sensing_delay": 2, "noise": 0.2, "drift": 0.2}),
    "3 obstacles": Case(obstacles=3),
    "3 obstacles while it forms": Case(obstacles=3, since=0),
    "3 large ones, radius 5 to 8": Case(obstacles=3, radius=(5.0, 8.0)),
    "3 as fast as robots, 3 to 6": Case(obstacles=3, speed=(3.0, 6.0)),
    "3 faster than robots, 6 to 7.5": Case(obstacles=3, speed=(6.0, 7.5)),
    "3, seen a round late, noise 0.2, drift 0.2": Case(
        options={"sensing_delay": 1, "noise": 0.2, "drift": 0.2}, obstacles=3, speed=(1.0, 2.0)
    ),
}


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What the judge saw; `rounds` until the team was in shape, None if it never was."""

    rounds: int | None
    apart: float
    read: float | None
    clear: float
    hits: int


def crossing(case: Case, seed: int) -> list[MovingObstacle]:
    """Obstacles that cross the middle of the arena on straight lines."""
    rng, found = np.random.default_rng(seed), list[MovingObstacle]()
    for _ in range(case.obstacles):
        angle, beside = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-16.0, 16.0)
        along = np.array([math.cos(angle), math.sin(angle)])
        middle = CENTER + beside * np.array([-along[1], along[0]])
        found.append(
            MovingObstacle(
                center=tuple((middle - BEGIN * along).tolist()),
                radius=rng.uniform(*case.radius),
                speed=rng.uniform(*case.speed),
                path=(tuple((middle + END * along).tolist()),),
                since=case.since,
            )
        )
    return found


def gaps(positions: Points, one: MovingObstacle) -> Points:
    """The smallest distance of each robot from the surface of an obstacle in each round, shape (rounds, n) [units]."""
    places = np.array([one.at(number) for number in range(len(positions))])
    offset = positions - places[:, None]
    gap, move = offset[:-1], offset[1:] - offset[:-1]
    share = np.clip(-(gap * move).sum(axis=2) / np.maximum((move * move).sum(axis=2), 1e-18), 0.0, 1.0)
    return np.linalg.norm(gap + share[..., None] * move, axis=2) - one.radius


def left(moving: Sequence[MovingObstacle], places: Points, step: float) -> int:
    """The first round from which no obstacle is near the places any more, shape (n, d) [units]."""
    number = math.ceil(max((one.end for one in moving), default=0.0))
    while number and all(
        np.linalg.norm(places - one.at(number - 1), axis=1).min() > one.radius + 2.0 * (one.speed + step)
        for one in moving
    ):
        number -= 1
    return number


def fly(team: str, case: Case, seed: int) -> Seen:
    moving = crossing(case, seed)
    decide: Any = "on-event" if moving else "every-round"  # these runs are long
    options = {"moving_obstacles": moving, "decide": decide} | TEAMS[team] | case.options
    result = llm_flock.run(seed=seed, trace=False, **options)
    mission, ideal = result.mission, np.array(result.mission.ideal)
    near = [gaps(result.positions, one) for one in moving]
    return Seen(
        rounds=judge(result.positions[left(moving, ideal, mission.max_step) :], ideal, mission.spacing),
        apart=separation(result.positions),
        read=result.summary.nearest_read,
        clear=min((float(one.min()) for one in near), default=math.inf),
        hits=sum(int((one < mission.body_radius - 1e-6).sum()) for one in near),
    )


def figures(name: str, team: str, seen: Sequence[Seen]) -> dict[str, str]:
    """A line of the table."""
    rounds = [one.rounds for one in seen if one.rounds is not None]
    read, clear = [one.read for one in seen if one.read is not None], min(one.clear for one in seen)
    return {
        "Case": name,
        "Team": team,
        "Formed": f"{len(rounds)} of {len(seen)}",
        "Rounds, median (most)": f"{statistics.median(rounds):g} ({max(rounds)})" if rounds else "-",
        "Nearest robots, in truth": f"{min(one.apart for one in seen):.3f}",
        "as sensed": f"{min(read):.3f}" if read else "the same",
        "Nearest obstacle": f"{clear:.3f}" if clear < math.inf else "-",
        "Hits": str(sum(one.hits for one in seen)) if clear < math.inf else "-",
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--case", default="", help="only cases whose name contains this; other lines stay")
    parser.add_argument("--no-write", action="store_true", help="print the lines only")
    given = parser.parse_args(arguments)
    lines = kept()
    with ProcessPoolExecutor(given.jobs) as pool:
        for name, case in CASES.items():
            for team in TEAMS if given.case in name else ():
                seen = list(pool.map(partial(fly, team, case), range(given.seeds)))
                lines[name, team] = figures(name, team, seen)
                print(*lines[name, team].values(), sep=" | ", flush=True)
                if not given.no_write:
                    write([lines[key] for key in product(CASES, TEAMS) if key in lines])


def kept() -> dict[tuple[str, str], dict[str, str]]:
    """The lines of the table as it is, by case and team."""
    if not TABLE.is_file():
        return {}
    with TABLE.open(encoding="utf-8", newline="") as file:
        return {(row["Case"], row["Team"]): row for row in csv.DictReader(file)}


def write(lines: Sequence[dict[str, str]]) -> None:
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, lines[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)
    stamp(TABLE.name)


if __name__ == "__main__":
    main()
