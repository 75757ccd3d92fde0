"""Members with valid keys that lie, alone and together: who of the honest is hurt, and who still forms.

    python -m benchmarks lies [--runs N]            every lie of tests/lies.py in the simulator, 1 and 2 liars among 10
    python -m benchmarks lies-curve [--runs N]      teams of 10, 20 and 40 (--robots) with 0 .. N/3 liars that collude
    python -m benchmarks lies-swarm [--runs N]      every lie against a keyed swarm of processes; with --hard, 20 % of
                                                    messages are lost, and obstacles are in the way

An honest robot counts as formed if all the honest are within 5 % of the spacing of different places of one plan, for
three rounds. Planners are geometry in the simulator; no language model is asked.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import random
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Point
from llm_flock.links import LinkFaults
from llm_flock.message import Message
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.shield import project
from llm_flock.simulate import start_positions
from llm_flock.transport._radio import Radio
from llm_flock_lab._experiments.statistics import wilson
from llm_flock_swarm._network.body_control import BodyControl
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.wire import Command, WorldState
from llm_flock_swarm._trust.keys import make_keys

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

COMM_ROUNDS = 5
INSIDE = 0.75, 0.35
"""Where liars that ask for ways are, as shares from the centre to between two places: there they block nobody."""
CURVE = ((10, (0, 1, 2, 3)), (20, (0, 2, 4, 6)), (40, (0, 4, 8, 13)))


@dataclass(frozen=True)
class Outcome:
    """One team under one lie."""

    formed: int | None  # round in which the honest had formed; None if they did not
    separation: float  # smallest distance of two honest bodies [units]
    ended: int  # honest robots that an exception ended
    clearance: float = math.inf  # smallest distance of a body from an obstacle [units]


def mission_of(n: int) -> Mission:
    """A circle of n in an arena that fits it."""
    side = max(100.0, 4.5 * n)
    return Mission(shape="circle", n_robots=n, center=(side / 2, side / 2), arena=((0.0, 0.0), (side, side)))


def rounds_to_form(n: int, liars: int = 0) -> int:
    """How long a team has: rounds in the simulator, as many periods of a motion round against processes.

    Each liar can change the team's plan twice, which takes a large team about 13 rounds each time.
    """
    return 60 + 6 * n + 30 * liars


def fly(lie: str, n: int, liars: int, seed: int, told: int | None = None) -> Outcome:
    """A team of n, the last of which lie together, in lockstep; their bodies fly off, unless they ask for ways.

    The team reckons with as many liars unless it was told another number.
    """
    from gang import Gang
    from lies import round_of_lies
    from signed_team import SignedTeam
    from toy_keys import ToyKeys

    rng = np.random.default_rng([seed, n, liars])
    mission = mission_of(n)
    places: list[Point] = [tuple(row) for row in start_positions(mission, None, "connected", rng).tolist()]
    team = SignedTeam(mission, places, seed=seed, liars=liars, tolerated=max(1, liars) if told is None else told)
    gang = Gang({j: ToyKeys(j) for j in range(n - liars, n)}, mission, seed)
    held = 0
    for number in range(1, rounds_to_form(n, liars) + 1):
        try:
            team.begin()
            said: list[bytes] = []
            for _ in range(COMM_ROUNDS):
                for payload in said:
                    gang.hear(payload)
                said = team.comm_round(said_by=round_of_lies(gang, lie))
            team.end(
                moves={
                    j: goes(mission, team.positions, spot_of(lie, gang.known, gang.members.index(j), number), j)
                    for j in gang.members
                }
            )
        except Exception as error:  # noqa: BLE001 - what is counted here
            print(f"{lie}, {n} robots, {liars} liars, seed {seed}: {error!r}", file=sys.stderr)
            return Outcome(None, team.smallest, 1)
        held = held + 1 if in_place(team) else 0
        if held == metrics.HELD_ROUNDS:
            return Outcome(number - held + 1, team.smallest, 0)
    return Outcome(None, team.smallest, 0)


def spot_of(lie: str, known: Message | None, liar: int, number: int) -> Point | None:
    """Where a liar's body goes in a round: inside the formation if it asks for ways; None if anywhere."""
    from lies import LIES, asks_for_ways, nearest_first

    if known is None or known.plan is None or LIES.get(lie) is not asks_for_ways:
        return None
    share = INSIDE[number % 2 if lie == "asks for ways to and fro" else 0]
    first, second = nearest_first(known.plan.points, liar)[:2]
    center = np.mean(known.plan.points, axis=0)
    return tuple((center + share * (np.add(first, second) / 2.0 - center)).tolist())


def goes(mission: Mission, bodies: Sequence[Point], spot: Point | None, robot: int) -> Point:
    """A step towards a spot, past others as the shield allows; towards the robot's own one at the wall if None."""
    here, to = bodies[robot], (4.0 * (mission.n_robots - robot), 1.0) if spot is None else spot
    distance = math.dist(here, to)
    share = min(1.0, mission.max_step / distance) if distance else 1.0
    step = tuple(x + share * (y - x) for x, y in zip(here, to, strict=True))
    if spot is None:
        return step
    others = [*bodies[:robot], *bodies[robot + 1 :]]
    return project(here, step, others, safe_distance=mission.safe_distance, max_step=mission.max_step)


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


SWARM = {1: 6, 2: 7}
"""Size of the team, by the number of liars; the team is told that number."""
LONGER = 32
"""Periods that a team has on top among obstacles, and beside those that ask for ways: all give them for so long."""
OF_THE_WIRE = ("beacons elsewhere", "beacons that are no numbers", "reports of its own", "a flood")


HARD: dict[str, Any] = {
    "loss": 0.2,
    "obstacles": [
        {"center": (50.0, 50.0), "radius": 4.0},
        {"center": (30.0, 45.0), "radius": 5.0},
        {"center": (66.0, 66.0), "radius": 5.0},
        {"polygon": [(52.0, 20.0), (62.0, 32.0), (54.0, 34.0)]},
    ],
}
"""Lost messages, and obstacles inside the formation and around it."""


async def fly_swarm(lie: str, liars: int, seed: int, keys: Path, hard: bool) -> Outcome:
    """A keyed swarm of processes; the last members are spoken for from here.

    Their bodies stand in a corner, or inside the formation if they ask for ways.
    """
    from gang import Gang
    from lies import LIES, asks_for_ways, round_of_lies
    from swarms import swarm_config

    from llm_flock_swarm._network.connection import load_keys, open_link
    from llm_flock_swarm._network.swarm import launch_swarm
    from llm_flock_swarm._network.wire import Beacon, BeaconedMessage, pack, unpack

    n = SWARM[liars]
    members = range(n - liars, n)
    rng = random.Random(seed)
    more = HARD if hard else {}
    honest = Mission(shape="circle", n_robots=n - liars, obstacles=more.get("obstacles", ()))
    starts = start_positions(honest, None, "connected", np.random.default_rng(seed)).tolist()
    corners = [[4.0 + 5.0 * k, 4.0] for k in range(liars)]
    options = {"keys": str(keys), "liars": liars, "gather_s": 1.0, "start_positions": [*starts, *corners]}
    config = swarm_config(n, seed=seed, **options, **more)
    closest = math.inf
    async with launch_swarm(config, absent=frozenset(members)) as swarm:
        found = {j: load_keys(swarm.config, j) for j in members}
        gang = Gang({j: key for j, key in found.items() if key is not None}, config.mission, seed)
        links = {j: open_link(swarm.config, j, listen="tcp/127.0.0.1:0") for j in members}
        places: dict[int, Point] = {}
        bodies = {j: LiarBody(swarm.config, j) for j in members}

        def see(_: int, payload: bytes) -> None:
            nonlocal closest
            state = unpack(WorldState, payload)
            places.update(enumerate(body.position for body in state.bodies))
            closest = min(closest, *(clearance(x, config.mission.obstacles) for x in places.values()))
            for body in bodies.values():
                body.see(state)

        def hear(sender: int, payload: bytes) -> None:
            if sender not in members:
                gang.hear(unpack(BeaconedMessage, payload).message)

        links[members[0]].listen("frame", None, see)
        links[members[0]].listen("say", None, hear)
        began, held, formed = time.monotonic(), 0, None
        periods = rounds_to_form(n) + (LONGER if hard or LIES.get(lie) is asks_for_ways else 0)
        try:
            while time.monotonic() - began < periods * config.network.step_s and formed is None:
                await asyncio.sleep(config.network.gossip_s)
                for index, j in enumerate(members if places else ()):
                    number = int((time.monotonic() - began) / config.network.step_s)
                    command = bodies[j].fly_to(spot_of(lie, gang.known, index, number))
                    if command is not None:
                        links[j].publish("command", j, pack(command))
                    for kind, payload in wire_lies(lie, j, places[j], rng):
                        links[j].publish(kind, j, payload)
                for j, payload, _ in round_of_lies(gang, lie) if places and lie not in OF_THE_WIRE else ():
                    # Their bodies are far away; heard is who seems near.
                    beacon = Beacon(stamp=time.time(), position=config.mission.center)
                    links[j].publish("say", j, pack(BeaconedMessage(beacon=beacon, message=payload)))
                swarm.observer.check()
                held = held + 1 if reported_in_place(swarm.observer, gang.honest, places) else 0
                if held * config.network.gossip_s >= metrics.HELD_ROUNDS * config.network.step_s:
                    formed = round((time.monotonic() - began) / config.network.step_s)
            return Outcome(formed, swarm.observer.min_separation, len(swarm.ended), closest)
        finally:
            for link in links.values():
                link.close()


class LiarBody:
    """The body of one that lies to processes. It keeps its distance: what is tried here are words."""

    def __init__(self, config: SwarmConfig, robot: int) -> None:
        network = config.network
        self._control = BodyControl(config)
        self._robot = robot
        self._radio = Radio(
            robot,
            config.mission,
            faults=LinkFaults(),
            rng=np.random.default_rng(robot),
            beacon_s=network.beacon_s,
            delay_s=network.gossip_s,
            clock_error_s=network.clock_error_s,
            speed=config.speed,
        )

    def see(self, state: WorldState) -> None:
        """Take a reading of the sensors."""
        self._radio.frame(state.stamp, [body.position for body in state.bodies])
        self._control.update(state.bodies[self._robot])

    def fly_to(self, spot: Point | None) -> Command | None:
        """The next command on the way to a spot; None stays where it is."""
        if spot is None:
            return None
        now = time.time()
        self._control.fly_to(spot)
        return self._control.control(now, self._radio.sightings(now), self._radio.unseen_s(now))


def wire_lies(lie: str, member: int, here: Point, rng: random.Random) -> list[tuple[str, bytes]]:
    """What a member sends besides messages of the protocol: (kind, payload)."""
    import msgspec
    from reports import told

    from llm_flock_swarm._network.wire import WIRE_VERSION, Beacon, pack

    now = time.time()
    match lie:
        case "beacons elsewhere":
            return [("beacon", pack(Beacon(stamp=now, position=(rng.uniform(30, 70), rng.uniform(30, 70)))))]
        case "beacons that are no numbers":
            bad = rng.choice((math.nan, math.inf, -math.inf, 1e300))
            raw = msgspec.msgpack.encode([rng.choice((now, bad)), [here[0], bad], [bad, bad]])
            short = msgspec.msgpack.encode([now, [here[0], bad]])
            return [("beacon", bytes([WIRE_VERSION]) + one) for one in (raw, short)]
        case "reports of its own":  # a mission, a position in space, others as blocked; or what another says
            other = told(0, mission=(2**40, "0" * 16), waypoint=(1.0, 2.0, 3.0), blocked=tuple(range(9)))
            return [("report", pack(one)) for one in (other, told(0), told(0, blocked=tuple(range(9))))]
        case "a flood":
            return [("say", bytes([WIRE_VERSION]) + rng.randbytes(900)) for _ in range(400)]
        case _:
            return []


def reported_in_place(observer: Observer, honest: Sequence[int], places: Mapping[int, Point]) -> bool:
    """Whether the honest are at different places of one plan: bodies by the sensors, places by their reports."""
    reports = [observer.reports[j] for j in honest if j in observer.reports]
    slots = [report.slot for report in reports]
    if len(reports) < len(honest) or len({report.plan_id for report in reports}) != 1 or len(set(slots)) != len(slots):
        return False
    near = metrics.AT_GOAL * observer.mission.spacing
    goals = [observer.goal_of(report) for report in reports]
    return all(goal is not None and math.dist(goal, places[j]) <= near for j, goal in zip(honest, goals, strict=True))


def one_swarm(lie: str, liars: int, hard: bool, seed: int) -> Outcome:
    """One swarm with keys of its own."""
    with tempfile.TemporaryDirectory() as folder:
        keys = Path(folder) / "team"
        make_keys(keys, SWARM[liars])
        return asyncio.run(fly_swarm(lie, liars, seed, keys, hard))


def swarm(arguments: Sequence[str] = ()) -> None:
    """Every lie against processes, one liar and two; several swarms at a time, if asked for."""
    from lies import EVERYTHING, LIES

    options = _options(arguments)
    with ProcessPoolExecutor(options.jobs) as pool:
        for liars in SWARM if options.liars is None else [options.liars]:
            for lie in (*OF_THE_WIRE, *LIES, EVERYTHING) if options.lie is None else [options.lie]:
                outcomes = list(pool.map(partial(one_swarm, lie, liars, options.hard), range(options.runs)))
                print(line(lie, SWARM[liars], liars, outcomes), flush=True)


def line(name: str, n: int, liars: int, outcomes: Sequence[Outcome]) -> str:
    """One row of a table."""
    formed = [outcome.formed for outcome in outcomes if outcome.formed is not None]
    share = wilson(len(formed), len(outcomes))
    closest = min(outcome.separation for outcome in outcomes)
    violations = sum(outcome.separation < 3.0 - 1e-6 for outcome in outcomes)
    rounds = f"{sorted(formed)[len(formed) // 2]}" if formed else "-"
    near = min(outcome.clearance for outcome in outcomes)
    ended = f"{sum(o.ended for o in outcomes)}" + ("" if math.isinf(near) else f"  clearance {near:.3f}")
    return (
        f"{name:34} {n:3} robots {liars:2} liars  formed {share.value:6.1%} [{share.low:.1%}, {share.high:.1%}]  "
        f"rounds {rounds:>3}  separation {closest:.3f}  violations {violations}  ended {ended}"
    )


def main(arguments: Sequence[str] = ()) -> None:
    """Every lie in the simulator, one liar and two."""
    from lies import EVERYTHING, LIES

    runs = _options(arguments).runs
    for liars in (1, 2):
        for lie in (*LIES, EVERYTHING):
            print(line(lie, 10, liars, [fly(lie, 10, liars, seed) for seed in range(runs)]), flush=True)


def curve(arguments: Sequence[str] = ()) -> None:
    """The worst lies against ever more liars."""
    options = _options(arguments)
    for n, counts in CURVE:
        if options.robots not in (None, n):
            continue
        for liars in counts:
            if options.liars not in (None, liars):
                continue
            worst = WORST if options.lie is None else (options.lie,)
            for lie in worst if liars else ("silence",):
                print(
                    line(lie, n, liars, [fly(lie, n, liars, seed, options.told) for seed in range(options.runs)]),
                    flush=True,
                )


WORST = (
    "moves on before others know",
    "frames one robot",
    "frees every place and takes one",
    "frees every place all the time",
    "exchanges what others own",
    "blocks every place",
    "plan after plan",
)


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks lies")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--robots", type=int, help="only teams of this size, for the curve")
    parser.add_argument("--liars", type=int, help="only this many liars, for curve and swarm")
    parser.add_argument("--lie", help="only this one, for curve and swarm")
    parser.add_argument("--jobs", type=int, default=1, help="swarms of processes at a time [1]")
    parser.add_argument("--hard", action="store_true", help="with loss and obstacles, for the swarm")
    parser.add_argument("--told", type=int, help="number of liars that the team reckons with, for the curve [as many]")
    return parser.parse_args(arguments)
