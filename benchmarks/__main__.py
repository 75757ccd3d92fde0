"""What the framework itself costs, apart from the models: `make bench`.

    python -m benchmarks [overhead] [trials] [http] [late] [sweep] [twenty]

`overhead`  an instant simulated model, record on, one core: milliseconds per robot and round at N = 10 and N = 100
`trials`    whole trials, circle of ten, record off, one core: processor time of one
`http`      a zero-latency OpenAI-compatible server in a process of its own: milliseconds per robot and round
`late`      50 robots and a server that takes 1 s to answer: seconds per round, the first (plan and step) left out
`scale`     whole missions of grids of 30, 300 and 1,000 robots, record off: time, memory and bytes; see
            benchmarks/scale.py (only when named, it takes minutes)
`sweep`     experiments/simulated.toml from scratch, two processes: time and memory (only when named)
`twenty`    twenty trials of a circle of ten in one process on a server that takes 1 s, beside the longest of them alone
            (only when named)
`links`     ten stand-ins for Crazyflies connected and told to move, through cflib (only when named)
`radio`     twenty stand-ins on one, two and four modelled radios, through cflib (only when named)
`physics`   flights of drones with real dynamics, and how fast that is; see benchmarks/physics.py (only when named)
`swarm`     twenty missions of ten processes, and the same in lockstep; `swarm-faults`, `swarm-thirty`,
            `swarm-flood`: see benchmarks/swarm.py (only when named)
`ros2`      50 robots shown in ROS 2: latency added and processor time; see benchmarks/ros2.py (only when named)
`local`     missions with a model on board; `local-ten`, `local-table`, `local-letters`, `local-wishes`:
            see benchmarks/local.py (only when named)
`lessons`   examples for the adapter of the model on board; see benchmarks/lessons.py
`same`      hashes of whole runs, to show that a change does not change behaviour; see benchmarks/same.py
`containment`  teams with models that are always bad, `containment-http` over HTTP; see benchmarks/containment.py
`arrivals`  the same starts flown with several methods, ORCA and CAPT among them; see benchmarks/arrivals.py
`drawn`     letters placed on 30 robots and read by a stranger, and bodies in space flown; see benchmarks/drawn.py
`missions`  missions in words of the kinds that others publish, judged by code; see benchmarks/missions.py
`lies`      members with valid keys that lie; `lies-curve`, `lies-swarm`: see benchmarks/lies.py
`starts`    how long each command takes to its help or to an error (only when named)
`flight`    the paper's flights on stand-ins through cflib, `flight --help` for its options; `flight-cases`: all that
            may go wrong in one; see benchmarks/flight.py and benchmarks/flight_cases.py (only when named)
`autopilots`  the shipped example for MAVLink on stand-ins that lift late, and `autopilot-faults`: see
            benchmarks/autopilots.py and benchmarks/autopilot_faults.py (only when named)

Each figure is the smallest and the median of several runs; the bar stands beside it. First comes how long a loop and a
large table take in plain Python: machines differ, and a shared one differs by a factor of three from day to day.
"""

from __future__ import annotations

import os
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks import (
    arrivals,
    autopilot_faults,
    autopilots,
    containment,
    drawn,
    flight,
    flight_cases,
    lessons,
    lies,
    links,
    local,
    missions,
    outcomes,
    physics,
    radio,
    ros2,
    same,
    scale,
    starts,
    swarm,
    sweeps,
)

import llm_flock

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

ROUNDS = 30


def circle(n: int) -> llm_flock.Mission:
    """A circle of n in an arena that fits it."""
    side = max(100.0, 4.5 * n)
    return llm_flock.Mission(shape="circle", n_robots=n, center=(side / 2, side / 2), arena=((0, 0), (side, side)))


def per_robot_round_ms(n: int, rounds: int, **options: Any) -> float:
    """One run with the record on; planning and all else included [ms]."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        result = llm_flock.run(
            circle(n), rounds=rounds, stop_when_formed=False, out=folder, seed=1, trace=False, **options
        )
        took = time.perf_counter() - began
    assert result.summary.rounds == rounds and result.summary.calls_failed == 0
    return 1000 * took / (n * rounds)


def report(name: str, bar: float, unit: str, measure: Callable[[], float], runs: int) -> None:
    """Print one line: smallest and median of several runs, and the bar."""
    measure()
    values = [measure() for _ in range(runs)]
    print(f"{name:58} min {min(values):6.3f}  median {statistics.median(values):6.3f} {unit}   bar {bar:g}", flush=True)


def yardstick() -> None:
    """How fast the machine is at the moment: its processor by a loop, its memory by a large table read at random."""
    order = random.Random(0).sample(range(300_000), 300_000)
    table = {key: (key,) for key in range(len(order))}

    def loop() -> None:
        total = 0
        for i in range(2_000_000):
            total += i * i

    def look_up() -> None:
        for key in order:
            table[key]

    def fastest_s(work: Callable[[], None]) -> float:
        times = []
        for _ in range(5):
            began = time.process_time()
            work()
            times.append(time.process_time() - began)
        return min(times)

    print(f"this machine: two million squares summed in {fastest_s(loop):.3f} s,", end=" ")
    print(f"300,000 entries read at random in {fastest_s(look_up):.3f} s")


def overhead() -> None:
    """The instant simulated model, on one core."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        report("instant model, N = 10", 0.7, "ms/robot-round", lambda: per_robot_round_ms(10, ROUNDS), 5)
        report("instant model, N = 100", 1.5, "ms/robot-round", lambda: per_robot_round_ms(100, 15), 3)
    finally:
        os.sched_setaffinity(0, cores)


def trials() -> None:
    """Trials as `llm-flock compare` flies them, one after the other."""
    seeds = iter(range(10_000))

    def trial_s() -> float:
        began = time.process_time()
        for _ in range(20):
            llm_flock.run(circle(10), seed=next(seeds), trace=False)
        return (time.process_time() - began) / 20

    report("a trial, circle of 10, record off", 1 / 8, "s", trial_s, 5)


def http() -> None:
    """Over HTTP to a server without latency."""
    from integration.fault_server import running

    with running() as server:
        options = {"model": "openai-compatible:test", "base_url": server.base_url}
        report("HTTP, no latency, N = 10", 4.0, "ms/robot-round", lambda: per_robot_round_ms(10, ROUNDS, **options), 5)


def late() -> None:
    """50 robots and a server that answers after one second: duration of a round in which nothing is sent back."""
    from integration.fault_server import running

    def slowest_round(**options: Any) -> float:
        times: list[float] = [time.perf_counter()]
        llm_flock.run(
            circle(50),
            rounds=4,
            stop_when_formed=False,
            seed=1,
            model="openai-compatible:test",
            base_url=server.base_url,
            on_round=lambda _: times.append(time.perf_counter()),
            **options,
        )
        # The first round is left out: it asks twice, for a plan and for a step.
        return max(b - a for a, b in pairwise(times[1:]))

    with running(latency=1.0) as server:
        report("1 s latency, N = 50, slowest round", 1.25, "s", lambda: slowest_round(max_retries=0), 2)
        again = slowest_round()
        print(f"  with --max-retries 2, where an answer that verification rejects is asked for again: {again:.3f} s")


PARTS = {"overhead": overhead, "trials": trials, "http": http, "late": late}
LONG = {"sweep": sweeps.whole, "twenty": sweeps.twenty}
LONG |= {"flight": flight.paper_flights, "flight-cases": flight_cases.safety_cases}
LONG |= {"autopilots": autopilots.flights, "autopilot-faults": autopilot_faults.faults}
LONG |= {"containment-http": containment.over_http}
LONG |= {"starts": starts.measure}
LONG |= {"links": links.links, "physics": physics.flights, "physics-speed": physics.speed}
LONG |= {"ros2": ros2.bridge, "radio": radio.radio}
LONG |= {"local": local.missions, "local-ten": local.ten, "local-table": local.table, "local-wishes": local.wishes}
LONG |= {"swarm": swarm.swarm, "swarm-faults": swarm.faults, "swarm-thirty": swarm.thirty, "swarm-flood": swarm.flood}

if __name__ == "__main__":
    commands = {
        "same": same.main,
        "outcomes": outcomes.main,
        "flight": flight.main,
        "flight-cases": flight_cases.main,
        "autopilots": autopilots.main,
        "autopilot-faults": autopilot_faults.main,
        "physics": physics.main,
        "scale": scale.main,
        "arrivals": arrivals.main,
        "drawn": drawn.main,
        "missions": missions.main,
        "containment": containment.main,
        "lies": lies.main,
        "lies-curve": lies.curve,
        "lies-swarm": lies.swarm,
        "local-letters": local.letters,
        "local-exam": local.exam,
        "local-held": local.held,
        "lessons": lessons.main,
    }
    if sys.argv[1:2] and sys.argv[1] in commands:
        commands[sys.argv[1]](sys.argv[2:])
        raise SystemExit
    parts = sys.argv[1:] or list(PARTS)
    if unknown := [part for part in parts if part not in PARTS | LONG]:
        raise SystemExit(f"part {unknown[0]!r}: allowed are {', '.join(PARTS | LONG | commands)}\n\n{__doc__}")
    yardstick()
    for part in parts:
        (PARTS | LONG)[part]()
