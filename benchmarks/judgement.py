"""Whether a team's models choose what is right after an event, by the share of models that judge wrongly.

    python -m benchmarks.judgement [--worlds 24] [--kinds death,...] [--jobs 2] [--write]

A world is a team and one event: a robot that dies, a battery that gets weak, an obstacle that comes to rest in a
door or on a place, or an order in words to one robot: on the way, with a spare robot, or with an empty place. Its words
are a wish, or the name of an option and a colon, which is right then: stand-ins read no others. In each world every
option is flown from the same seed. The right one loses no robot; after that it is the best by what counts: fewest empty
places, fewest rounds or least flying, as flown and not as expected. Then models are asked: all are *simulated*; some,
drawn by the seed, choose another option than the right one by its figures, each on its own or all alike. `one` is the
share of worlds in which the vote that stands first in the order of plans would have been right: one robot that decides
for all.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from benchmarks import figures

import llm_flock
from llm_flock.errors import InputError
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.llm._simulated.prompt_reader import JUDGEMENT_MARK
from llm_flock.metrics import AT_GOAL, ROUNDING, ShapeTarget
from llm_flock.planner import AIMS
from llm_flock.runtime import Stream, stream

SHARES = {"unlike": (0, 30, 50, 70), "alike": (30, 50, 70)}
"""Shares of models that judge wrongly [%], each on its own or all alike."""

SHAPES = ("circle", "line", "wedge")
USUAL = {"death": "leave", "battery": "continue", "blocked": "wait", "order": "continue"}
"""What is done without a choice."""

VOTED = {"death": 20, "battery": 9, "blocked": 16, "order": 9}
"""Rounds after an event by which the team has chosen."""

AFTER = {"death": 28, "battery": 28, "blocked": 45, "order": 30}
"""Rounds that are flown after an event."""

MOVED = 0.2
"""A robot that moves by more than this in a round is still on its way [units]."""


@dataclass(frozen=True, kw_only=True)
class World:
    """A mission, the options of its run, and the round of its event."""

    kind: str
    mission: dict[str, Any]
    options: dict[str, Any]
    event: int
    lost: int  #: Robots that are lost whatever is chosen.

    @property
    def counts(self) -> str:
        """What counts: the order, or the wish."""
        return str(self.options["changes"][0]["words"] if self.kind == "order" else self.options["wish"])


@dataclass(frozen=True, kw_only=True)
class Flown:
    """The figures of one flight, what was agreed, and what the vote that stands first says."""

    lost: int
    gaps: int
    rounds: int
    distance: float
    near: bool
    one_choice: bool
    choice: str | None
    first: str | None
    offered: tuple[str, ...]

    def beats(self, other: Flown, aim: str) -> bool:
        """Whether this flight is clearly better: by the first figure in which the two differ by more than noise."""
        for name in ("lost", *AIMS[aim]):
            mine, theirs = float(getattr(self, name)), float(getattr(other, name))
            noise = {"rounds": 1.0, "distance": 0.05 * max(mine, theirs)}.get(name, 0.0)
            if abs(mine - theirs) > noise:
                return mine < theirs
        return False


class Fixed:
    """A *simulated* model that chooses one option, whatever its figures; its plans and steps are good."""

    simulated = True

    def __init__(self, choice: str, seed: int, robot: int) -> None:
        self._choice = choice
        self._good = SimulatedModel(parse_profile("ideal"), stream(seed, Stream.MODEL, robot))

    async def ask(self, call: Any) -> Any:
        asked = any(JUDGEMENT_MARK in message.text for message in call.messages)
        return f"Choice: {self._choice}" if asked else await self._good.ask(call)


class Events:
    """Keeps the events of a run."""

    def __init__(self) -> None:
        self.seen: list[Any] = []

    def write(self, entry: Any) -> None:
        if type(entry).__name__ == "ProtocolEvent":
            self.seen.append(entry)


def world_of(kind: str, seed: int) -> World:
    rng = np.random.default_rng([4, seed])
    shape, aim = str(rng.choice(SHAPES)), str(rng.choice([*AIMS]))
    n = int(rng.integers(6, 9))
    if kind == "blocked":
        return door_world(seed, aim, n, rng) if seed % 2 else place_world(seed, aim, n, rng)
    if kind == "order":
        return order_world(seed, shape, aim, n, rng)
    robot, event = int(rng.integers(n)), int(rng.integers(4, 8)) if kind == "death" else int(rng.integers(4, 7))
    mission = {"shape": shape, "n_robots": n, "comm_range": 60.0, "sense_range": 60.0}
    options = {"seed": seed, "judge": "models", "wish": aim, "rounds": event + AFTER[kind], "stop_when_formed": False}
    options |= {"decide": "on-event", "time_out": 5}
    if kind == "death":
        options["kill"] = f"{robot}@{event}"
        return World(kind=kind, mission=mission, options=options, event=event, lost=1)
    if rng.random() < 0.4:
        mission["places"] = n - 1
    whole = llm_flock.run(llm_flock.Mission(**mission), **options, battery=f"{robot}@{event}:1000")
    way = np.linalg.norm(np.diff(whole.positions[event - 1 :, robot], axis=0), axis=1).sum()
    options["battery"] = f"{robot}@{event}:{max(0.5, rng.uniform(0.3, 1.4) * way):.1f}"
    return World(kind=kind, mission=mission, options=options, event=event, lost=0)


def order_world(seed: int, shape: str, aim: str, n: int, rng: np.random.Generator) -> World:
    """One robot gets an order: on the way to its place, beside a spare robot, or beside the place of a late one."""
    robot, scene = int(rng.integers(n)), ("way", "spare", "gap")[seed % 3]
    event = int(rng.integers(3, 7)) if scene == "way" else 25
    mission = {"shape": shape, "n_robots": n, "comm_range": 60.0, "sense_range": 60.0}
    options: dict[str, Any] = {"seed": seed, "judge": "models", "rounds": event + AFTER["order"]}
    options |= {"stop_when_formed": False, "decide": "on-event", "time_out": 5}
    if scene == "spare":
        mission["places"] = n - 1
    if scene == "gap":
        options["join"] = f"{(robot + 1) % n}@{options['rounds']}"
    named = {"way": "wait: all of you", "spare": f"spare: robot {robot}", "gap": "replan: now"}[scene]
    words = str(rng.choice([aim, aim, named]))
    options |= {"wish": aim, "changes": [{"round": event, "robot": robot, "words": words}]}
    return World(kind="order", mission=mission, options=options, event=event, lost=int(scene == "gap"))


def blocked_world(seed: int, aim: str, mission: dict[str, Any], rest: Sequence[float], far: Sequence[float]) -> World:
    """A world in which an obstacle flies from a point `far` away to where it comes to `rest` [units]."""
    speed = 4.0
    flies = {"center": [*map(float, far)], "radius": 2.0, "speed": speed, "path": [[*map(float, rest)]]}
    event = int(np.ceil(np.linalg.norm(np.subtract(rest, far)) / speed))
    options = {
        "seed": seed,
        "judge": "models",
        "wish": aim,
        "rounds": event + AFTER["blocked"],
        "stop_when_formed": False,
    }
    options |= {"decide": "on-event", "time_out": 5, "moving_obstacles": [flies]}
    return World(kind="blocked", mission=mission, options=options, event=event, lost=0)


def door_world(seed: int, aim: str, n: int, rng: np.random.Generator) -> World:
    """A wall between start and places has two doors; in the nearer one an obstacle comes to rest."""
    far = float(rng.uniform(75, 92))
    gaps = [0.0, 40.0, 50.0, far - 5, far + 5, 100.0]
    walls = [
        {"polygon": [[50, a], [54, a], [54, b], [50, b]]} for a, b in zip(gaps[::2], gaps[1::2], strict=True) if a < b
    ]
    mission = {"shape": "line", "turn": 90, "n_robots": n, "center": [78, 45], "spacing": 8, "obstacles": walls}
    mission |= {"comm_range": 100.0, "sense_range": 100.0} | ({"places": n - 1} if rng.random() < 0.5 else {})
    return blocked_world(seed, aim, mission, (52, 45), (64, 45))


def place_world(seed: int, aim: str, n: int, rng: np.random.Generator) -> World:
    """An obstacle comes to rest on the outermost place that a team has chosen by then."""
    mission = {
        "shape": str(rng.choice(["line", "wedge", "grid"])),
        "n_robots": n,
        "comm_range": 60.0,
        "sense_range": 60.0,
    }
    flown = llm_flock.run(
        llm_flock.Mission(**mission), seed=seed, decide="on-event", time_out=5, judge="models", wish=aim
    )
    here = flown.positions[-1]
    out = here[np.linalg.norm(here - here.mean(axis=0), axis=1).argmax()]
    away = (out - here.mean(axis=0)) / np.linalg.norm(out - here.mean(axis=0))
    return blocked_world(seed, aim, mission, out, out + rng.uniform(30, 60) * away)


def fly(world: World, model: Any, **other: Any) -> Flown:
    events, options = Events(), {**world.options, **other}
    late = [int(options["join"].partition("@")[0])] if "join" in options else []
    if late:  # in the last round, which does not count
        options["join"] = f"{late[0]}@{options['rounds']}"
    flown = llm_flock.run(llm_flock.Mission(**world.mission), model=model, sink=events, **options)
    positions, mission = flown.positions[: -1 if late else None], flown.mission
    steps = np.linalg.norm(np.diff(positions[world.event - 1 :], axis=0), axis=2)
    killed = {one.robot for one in events.seen if one.kind == "killed"}
    placed = [j for j, slot in enumerate(flown.slots) if slot is not None and j not in {*killed, *late}]
    whole = mission.n_robots - world.lost if mission.places is None else mission.places
    here = positions[-1][placed]
    gaps = max(whole - len(placed), 0)
    try:
        ideal = np.array(mission.resized(len(placed)).ideal)
        error = ShapeTarget(ideal).error(here - here.mean(axis=0) + ideal.mean(axis=0)).mean
    except InputError:
        error = np.inf
    gaps = gaps or int(error > 2 * AT_GOAL * mission.spacing)
    seen = [one for one in events.seen if one.detail.get("about") == world.kind]
    seen = [one for one in seen if one.detail["robot"] == seen[0].detail["robot"]]  # others may be blocked later
    agreed = [one.detail["choice"] for one in seen if one.kind == "agreed"]
    votes = [one for one in seen if one.kind == "judged"]
    return Flown(
        lost=max(len(killed) - world.lost, 0),
        gaps=gaps,
        rounds=int(max(np.flatnonzero(steps.max(axis=1) > MOVED), default=-1)) + 1,
        distance=float(steps.sum()),
        near=bool(
            flown.summary.min_separation is not None and flown.summary.min_separation < mission.safe_distance - ROUNDING
        ),
        one_choice=len({*agreed}) <= 1,
        choice=agreed[-1] if agreed else None,
        first=max(votes, key=lambda one: one.robot).detail["choice"] if votes else None,
        offered=tuple(dict.fromkeys(x for one in seen if one.kind == "incident" for x in one.detail["options"])),
    )


class Mixed(Fixed):
    """A *simulated* model that judges by a profile; its plans and steps are those of a good one."""

    def __init__(self, profile: str, seed: int, robot: int) -> None:
        super().__init__("", seed, robot)
        rng = stream(seed + 1, Stream.MODEL, 0 if "alike" in profile else robot)
        self._judges = SimulatedModel(parse_profile(profile), rng)

    async def ask(self, call: Any) -> Any:
        return await (self._judges if call.kind == "judgement" else self._good).ask(call)


def models(world: World, seed: int, share: int, *, alike: bool) -> list[Mixed]:
    """The models of a team of which a share judges wrongly: each on its own, or all alike."""
    n = world.mission["n_robots"]
    wrong = {*np.random.default_rng([5, seed]).permutation(n)[: round(share * n / 100)].tolist()}
    name = "alike,misjudge" if alike else "misjudge"
    return [Mixed(name if j in wrong else "ideal", seed, j) for j in range(n)]


def study(kind: str, seed: int) -> dict[tuple[str, int], Any] | None:
    """One world: by case and share, the flight of the option that was chosen, and what is to be counted."""
    world = world_of(kind, seed)
    n, aim = world.mission["n_robots"], world.counts
    asked = fly(world, "simulated:ideal")
    flown = {
        choice: asked if choice == asked.choice else fly(world, [Fixed(choice, seed, j) for j in range(n)])
        for choice in asked.offered
    }
    if len(flown) < 2:
        return None  # there is nothing to choose
    right = {aim.partition(":")[0]} & flown.keys()
    right = right or {one for one in flown if not any(flown[other].beats(flown[one], aim) for other in flown)}
    if right == {*flown}:
        return None
    usual = USUAL[kind]
    found: dict[tuple[str, int], Any] = {("rule", 0): (flown[usual], usual in right, usual in right, True, False)}
    for case, shares in SHARES.items():
        for share in shares:
            rounds = world.event + VOTED[kind]
            team = asked if share == 0 else fly(world, models(world, seed, share, alike=case == "alike"), rounds=rounds)
            choice = team.choice or usual
            found[case, share] = (
                flown.get(choice),
                choice in right,
                team.first in right,
                team.one_choice,
                team.near,
            )
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--worlds", type=int, default=24, help="worlds of each kind, as seeds; some leave no choice")
    parser.add_argument("--kinds", default=",".join(USUAL), help="kinds of events; the rows of others stay as they are")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--write", action="store_true", help="write docs/data/judgement.csv")
    given = parser.parse_args(arguments)
    titles = ["Event", "Wrong models", "Wrong ones", "Worlds", "Right %", "One robot: right %", "One choice %"]
    rows = [[*titles, "Robots lost per world", "Rounds", "Flights below the safe distance"]]
    with (figures.TABLE.parent / "judgement.csv").open(encoding="utf-8", newline="") as file:
        kept = [*csv.reader(file)]
    with ProcessPoolExecutor(given.jobs) as pool:
        for kind in USUAL:
            if kind not in given.kinds.split(","):
                rows += [row for row in kept if row[0] == kind]
                continue
            worlds = [one for one in pool.map(partial(study, kind), range(given.worlds)) if one is not None]
            for case, share in worlds[0]:
                seen = [one[case, share] for one in worlds]
                flights = [flown for flown, *_ in seen if flown is not None]

                def percent(place: int, seen: Sequence[Any] = seen) -> str:
                    return f"{100 * sum(bool(one[place]) for one in seen) / len(seen):.0f}"

                near = sum(bool(one[4]) or (one[0] is not None and one[0].near) for one in seen)
                lost = f"{sum(flown.lost for flown in flights) / len(seen):.2f}"
                rounds = f"{np.median([flown.rounds for flown in flights]):.0f}"
                name = "no model is asked" if case == "rule" else f"{share} %"
                one = "" if case == "rule" else percent(2)
                wrong = "" if case == "rule" else case
                rows.append([kind, name, wrong, str(len(seen)), percent(1), one, percent(3), lost, rounds, str(near)])
                print(*rows[-1], sep=" | ", flush=True)
    if given.write:
        figures.write("judgement.csv", rows)


if __name__ == "__main__":
    main()
