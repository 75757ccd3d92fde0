"""The bridge to ROS 2: latency that it adds to poses, and what it costs. Bars: 3 ms in the median, 30 % of a core.

`python -m benchmarks ros2` shows `ROBOTS` robots at 10 Hz for `SECONDS` seconds. `llm-flock ros2` and a zenoh router
run in processes of their own. Another process stands in for the world and the robots: it sends made-up positions and
reports, and runs no protocol and no model. One more process hears every reading of the sensors twice, in the swarm
itself and as poses behind the router; the difference, pose by pose, is the latency added. Processor time is the
bridge's, as the system counts it, from its first pose to its last.
"""

from __future__ import annotations

import asyncio
import math
import multiprocessing
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from llm_flock.members import WORLD
from llm_flock.plan import Plan
from llm_flock_swarm._network.access import REPORT_S
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.swarm import free_port
from llm_flock_swarm._network.wire import Body, RobotReport, WorldState, pack, unpack
from llm_flock_swarm._ros2.types import POSE, from_cdr, type_hash
from llm_flock_swarm._ros2.wire import topic_key
from llm_flock_swarm._zenoh import ROOT, PlainSeal, open_session, settings

ROBOTS, SECONDS = (int(os.environ.get(name, default)) for name, default in (("ROBOTS", "50"), ("SECONDS", "30")))
LATENCY_MS, CORE = 3.0, 0.30
SIDE = 240.0
SWARM = "bench"


def config() -> SwarmConfig:
    """The team that the processes agree on."""
    corners = ((0.0, 0.0), (SIDE, SIDE))
    mission = {"shape": "circle", "n_robots": ROBOTS, "center": (SIDE / 2, SIDE / 2), "arena": corners}
    return SwarmConfig.model_validate({"mission": mission, "network": {"swarm": SWARM}})


def _places(phase: float, radius: float) -> list[tuple[float, ...]]:
    angles = [2 * math.pi * j / ROBOTS + phase for j in range(ROBOTS)]
    return [(SIDE / 2 + radius * math.cos(a), SIDE / 2 + radius * math.sin(a)) for a in angles]


def swarm(endpoint: str) -> None:
    """Send what a world and its robots send, until killed."""
    session: Any = open_session(settings(listen=[endpoint], connect=[], lease_s=2.0))
    mission = config().mission
    plan = Plan(tuple(_places(0.0, 80.0)))
    publishers = {
        topic: session.declare_publisher(f"{ROOT}/{SWARM}/{topic}", express=True)
        for topic in (f"frame/{WORLD}", *(f"report/{j}" for j in range(ROBOTS)))
    }
    kept = [session.liveliness().declare_token(f"{ROOT}/{SWARM}/alive/{j}") for j in (WORLD, *range(ROBOTS))]

    def report(robot: int, count: int, at: tuple[float, ...]) -> RobotReport:
        retold = count % 25 == 0
        return RobotReport(
            round=count,
            period=count,
            phase="flying",
            mission=(0, mission.digest),
            order=b"",
            plan_id=plan.digest,
            plan=plan if retold else None,
            proposer=0,
            slot=robot,
            blocked=(),
            waypoint=at,
            origin="model",
            neighbors=4,
            happened=(),
            calls=(),
            waypoints={"model": count},
            sent=count,
            bytes=100 * count,
            rejected={},
            breakers=(),
            hopeless=None,
            latencies_s=(0.001,) * 20,
            shape=mission.model_dump(mode="json") if retold else None,
        )

    period_s, began, ticks = 0.04, time.monotonic(), 0
    while kept:
        ticks += 1
        time.sleep(max(0.0, began + ticks * period_s - time.monotonic()))
        at, now = _places(0.01 * ticks, 90.0), time.time()
        state = WorldState(stamp=now, closest=5.0, bodies=tuple(Body(p, p, ticks) for p in at), late=0)
        publishers[f"frame/{WORLD}"].put(PlainSeal(WORLD).seal(pack(state), ""))
        per_report = round(REPORT_S / period_s)
        for robot in range(ticks % per_report, ROBOTS, per_report):  # spread over the time, as robots do
            said = pack(report(robot, ticks // per_report, at[robot]))
            publishers[f"report/{robot}"].put(PlainSeal(robot).seal(said, ""))


def _processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _hear(own: str, router: str, pid: int, out: Any) -> None:
    """Hear the swarm itself and the poses, and put what was measured into a queue."""
    import zenoh

    values = {"mode": "client", "connect/endpoints": [router], "scouting/multicast/enabled": False}
    inside: Any = open_session(settings(listen=["tcp/127.0.0.1:0"], connect=[own], lease_s=2.0))
    outside: Any = open_session(values)
    frames: list[tuple[float, bytes]] = []
    poses: list[tuple[float, bytes]] = []

    def noting(where: list[tuple[float, bytes]]) -> Any:
        def note(sample: Any) -> None:
            where.append((time.time(), sample.payload.to_bytes()))

        return zenoh.handlers.Callback(note, indirect=False)

    key = topic_key(0, f"/{SWARM}/*/pose", POSE, type_hash(POSE))
    kept = [
        inside.declare_subscriber(f"{ROOT}/{SWARM}/frame/*", noting(frames)),
        outside.declare_subscriber(key, noting(poses)),
    ]
    end = time.monotonic() + 60.0
    while len(poses) < 20 * ROBOTS and time.monotonic() < end:
        time.sleep(0.05)
    used, began = _processor_s(pid), time.monotonic()
    frames.clear()
    poses.clear()
    time.sleep(SECONDS)
    lasted = time.monotonic() - began
    share = (_processor_s(pid) - used) / lasted
    del kept
    first = {round(unpack(WorldState, data[2:]).stamp * 1e9): at for at, data in frames}
    added, total = [], []
    for at, data in poses:
        stamp = from_cdr(data, POSE).header.stamp
        ns = stamp.sec * 10**9 + stamp.nanosec
        if ns in first:
            added.append(1000 * (at - first[ns]))
            total.append(1000 * (at - ns / 1e9))
    out.put((added, total, share, len(poses) / (ROBOTS * lasted)))
    inside.close()
    outside.close()


ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config()
for path, value in {"mode": "router", "listen/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}.items():
    config.insert_json5(path, json.dumps(value))
session = zenoh.open(config)
time.sleep(3600)
"""


def _percentile(values: Sequence[float], share: float) -> float:
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def bridge() -> None:
    """Measure once, and print what was found beside the bars."""
    own, router = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    context = multiprocessing.get_context("spawn")
    queue: Any = context.Queue()
    started: list[Any] = [subprocess.Popen([sys.executable, "-c", ROUTER, router])]
    made: list[Any] = [context.Process(target=swarm, args=(own,), daemon=True)]
    made[0].start()
    try:
        asyncio.run(asyncio.sleep(3.0))
        arena = f"0,0,{SIDE:g},{SIDE:g}"
        flags = ["--robots", str(ROBOTS), "--center", f"{SIDE / 2:g},{SIDE / 2:g}", "--arena", arena]
        flags += ["--swarm", SWARM, "--connect", own, "--ros2", router, "--quiet"]
        started.append(subprocess.Popen([sys.executable, "-m", "llm_flock", "ros2", *flags]))
        made.append(context.Process(target=_hear, args=(own, router, started[1].pid, queue), daemon=True))
        made[1].start()
        added, total, share, rate = queue.get(timeout=SECONDS + 90.0)
    finally:
        for process in (*made, *started):
            process.terminate()
    assert added, "no pose came"
    print(f"{ROBOTS} robots, {rate:.1f} poses a second each, {SECONDS} s, {len(added)} poses")
    print(f"latency that the bridge and the router add, median {statistics.median(added):.2f} ms   bar {LATENCY_MS:g}")
    print(f"  99th percentile {_percentile(added, 0.99):.2f} ms; from the reading to the pose, with the way through")
    print(f"  the swarm: median {statistics.median(total):.2f} ms, 99th percentile {_percentile(total, 0.99):.2f} ms")
    print(f"processor of the bridge {100 * share:.1f} % of a core   bar {100 * CORE:g} %")
