"""Swarms of processes: whether they form, how fast against lockstep, and the cost of a robot.

`python -m benchmarks swarm` flies `RUNS` missions of ten processes with simulated models that take a moment
(log-normal, median 0.3 s, sigma 0.6), and the same missions in lockstep with the same models. A lockstep round lasts as
long as its slowest model, and the flight of one step after that; the time of either begins with the first question.
With `KEYS=1` the processes sign what they say, and talk over TLS. A robot's processor time is that of its mission: its
start is left out.
`python -m benchmarks swarm-faults` does it with every fault, five runs each; `swarm-thirty` starts thirty processes.
`python -m benchmarks swarm-flood` has one of six members flood the others for `FLOOD_S` seconds.
"""

from __future__ import annotations

import asyncio
import math
import multiprocessing
import os
import signal
import statistics
import tempfile
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import llm_flock
from llm_flock.message import Message, MissionStamp, encode
from llm_flock.simulate import start_positions
from llm_flock_swarm._network.config import NetworkConfig, SwarmConfig
from llm_flock_swarm._network.connection import open_link
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.swarm import Swarm, SwarmResult, launch_swarm
from llm_flock_swarm._network.wire import Beacon, BeaconedMessage, pack
from llm_flock_swarm._signed.certificates import Proofs, wrap
from llm_flock_swarm._trust.keys import make_keys

RUNS, FAULT_RUNS, THIRTY_RUNS = (int(os.environ.get("RUNS", default)) for default in ("20", "5", "3"))
SAFE = 3.0 - 1e-6
LATENCY_MS = 25.0
DOWN = "0-8=simulated:brisk,9=openai-compatible:down"
Meanwhile = Callable[[Swarm], Awaitable[None]]


def config_of(robots: int, seed: int, **options: Any) -> SwarmConfig:
    base = {"shape": "circle", "n_robots": robots, "model": "simulated:brisk", "start": "connected", "seed": seed}
    return SwarmConfig.build({}, **{**base, "connect": "", "max_s": 120.0, **options})


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """One mission, processor time of a robot and of the world per second, and a robot's memory [MiB]."""

    result: SwarmResult
    cpu: float
    world_cpu: float
    memory_mib: float


async def _nothing(swarm: Swarm) -> None:
    return


def fly(
    config: SwarmConfig,
    meanwhile: Meanwhile = _nothing,
    *,
    lasts_s: float = 0.0,
    absent: int = 0,
    wanted: int | None = None,
) -> Flight:
    """One mission; `meanwhile` begins with the robots; it lasts `lasts_s`, and until `wanted` robots have formed."""
    n = config.mission.n_robots

    async def whole() -> Flight:
        async with launch_swarm(config, absent=frozenset(range(n - absent, n))) as swarm:
            used: dict[str, float] = {}
            task = asyncio.create_task(_when_begun(swarm, meanwhile, used))

            def done(observer: Observer) -> bool:
                began = observer.began_s
                formed = observer.formed_s is not None and wanted in (None, len(observer.robots))
                return task.done() and formed and time.time() > (began or 0.0) + lasts_s

            stopped = await swarm.run(done)
            await task
            pids = {name: pid for name, pid in swarm.pids.items() if name in used and name not in swarm.ended}
            seconds = time.time() - (swarm.observer.began_s or time.time())
            shares = {name: (_cpu_s(pid) - used[name]) / max(seconds, 1.0) for name, pid in pids.items()}
            robots = [name for name in pids if name.startswith("robot")]
            return Flight(
                result=swarm.result(stopped),
                cpu=statistics.mean(shares[name] for name in robots),
                world_cpu=shares["world"],
                memory_mib=statistics.mean(_memory_mib(pids[name]) for name in robots),
            )

    return asyncio.run(whole())


async def _when_begun(swarm: Swarm, meanwhile: Meanwhile, used: dict[str, float]) -> None:
    while swarm.observer.began_s is None:  # noqa: ASYNC110 - nobody sets an event
        await asyncio.sleep(0.05)
    used.update((name, _cpu_s(pid)) for name, pid in swarm.pids.items() if name not in swarm.ended)
    await meanwhile(swarm)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mib(pid: int) -> float:
    """Private memory, and its share of shared memory."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def lockstep_s(config: SwarmConfig) -> float:
    """Time until the same mission has formed in lockstep: the models' time in each round, and a flight for each."""
    times: list[float] = []
    began = time.perf_counter()
    result = llm_flock.run(
        config.mission,
        model=config.model.model,
        seed=config.trial.seed,
        start=config.trial.start,
        on_round=lambda _: times.append(time.perf_counter() - began),
    )
    rounds = result.summary.rounds_to_formed
    assert rounds is not None
    return times[rounds - 1] + rounds * config.network.step_s


def swarm() -> None:
    """Ten processes, and lockstep."""
    with tempfile.TemporaryDirectory() as folder:
        keys = Path(folder) / "team" if os.environ.get("KEYS") else None
        if keys is not None:
            make_keys(keys, 10)
        _against_lockstep({} if keys is None else {"keys": str(keys)})


def _against_lockstep(options: dict[str, Any]) -> None:
    flights: list[Flight] = []
    ratios: list[float] = []
    for seed in range(RUNS):
        config = config_of(10, seed, **options)
        flight = fly(config)
        flights.append(flight)
        together = lockstep_s(config)
        took = flight.result.mission_s
        if took is not None:
            ratios.append(took / together)
        print(f"seed {seed}: {took} s, lockstep {together:.2f} s; {_line(flight)}", flush=True)
    _summary("ten processes", flights)
    middle, mean = statistics.median(ratios), statistics.mean(ratios)
    print(f"  mission time / lockstep: median {middle:.2f}, mean {mean:.2f}, bar 0.7")


SLOWER = 4.0
"""Thirty processes share two cores: all periods are longer and bodies slower by this factor. The lease too: a link that
is silent for a quarter of it carries signs of life, and 30 robots have 435 links."""


def thirty() -> None:
    """Thirty processes."""
    default = NetworkConfig()
    periods = {
        name: SLOWER * getattr(default, name)
        for name in ("gossip_s", "beacon_s", "control_s", "frame_s", "step_s", "lag_s", "lease_s")
    }
    arena = ((0.0, 0.0), (160.0, 160.0))
    flights: list[Flight] = []
    for seed in range(THIRTY_RUNS):
        flights.append(
            fly(config_of(30, seed, arena=arena, center=(80.0, 80.0), max_s=300.0, gather_s=60.0, **periods))
        )
        print(f"seed {seed}: {flights[-1].result.mission_s} s; {_line(flights[-1])}", flush=True)
    _summary("thirty processes", flights)


async def _kill(swarm: Swarm) -> None:
    await asyncio.sleep(3.0)
    os.kill(swarm.pids["robot-2"], signal.SIGKILL)
    await asyncio.sleep(0.5)


async def _kill_recorder(swarm: Swarm) -> None:
    await asyncio.sleep(3.0)
    os.kill(swarm.pids["recorder"], signal.SIGKILL)


async def _stop(swarm: Swarm) -> None:
    await asyncio.sleep(3.0)
    os.kill(swarm.pids["robot-2"], signal.SIGSTOP)
    await asyncio.sleep(3.0)
    os.kill(swarm.pids["robot-2"], signal.SIGCONT)
    await asyncio.sleep(2.5)


async def _come(swarm: Swarm) -> None:
    await asyncio.sleep(5.0)
    await swarm.start_robot(9)
    await asyncio.sleep(1.0)


FAULTS: dict[str, tuple[int, dict[str, Any], dict[str, Any]]] = {
    "kill -9 of a robot": (9, {}, {"meanwhile": _kill}),
    "kill -9 of the recorder": (10, {}, {"meanwhile": _kill_recorder, "recorded": True}),
    "SIGSTOP for 3 s": (10, {}, {"meanwhile": _stop}),
    "30 % loss, 200 ms jitter": (10, {"loss": 0.3, "delay": 2}, {}),
    "a robot joins late": (10, {"gather_s": 1.0}, {"meanwhile": _come, "absent": 1}),
    "two halves apart for 10 s": (10, {"partition": "1-11"}, {"lasts_s": 13.0}),
    "a model's endpoint is down": (
        10,
        {"model": DOWN, "base_url": "http://127.0.0.1:9/v1", "fallback": "geometry", "max_tries": 1},
        {},
    ),
}


def faults() -> None:
    """Every fault, five runs each."""
    for name, (robots, options, happens) in FAULTS.items():
        flights = [_fly_with(seed, options, wanted=robots, **happens) for seed in range(FAULT_RUNS)]
        for seed, flight in enumerate(flights):
            print(f"  seed {seed}: {flight.result.mission_s} s; {_line(flight)}", flush=True)
        assert all(flight.result.n_robots == robots for flight in flights)
        _summary(name, flights)


FLOOD_S = float(os.environ.get("FLOOD_S", "90"))
FLOODS = {"a quiet member": 0.0, "1,000 messages/s": 1000.0, "as many as it can": math.inf}


def flood() -> None:
    """Five robots with keys, and a member that floods them with faultless messages, of its own and signed, or not."""
    with tempfile.TemporaryDirectory() as folder:
        keys = Path(folder) / "team"
        make_keys(keys, 6)
        rng = np.random.default_rng(1)
        starts = start_positions(llm_flock.Mission(shape="circle", n_robots=5), None, "connected", rng).tolist()
        for name, rate in FLOODS.items():
            sent: list[int] = []

            async def meanwhile(swarm: Swarm, rate: float = rate, sent: list[int] = sent) -> None:
                with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
                    loop = asyncio.get_running_loop()
                    sent.append(await loop.run_in_executor(pool, _flood, swarm.config, rate, FLOOD_S))

            config = config_of(
                6, 1, keys=str(keys), gather_s=1.0, max_s=FLOOD_S + 60.0, start_positions=[*starts, CORNER]
            )
            flight = fly(config, meanwhile, absent=1)
            result = flight.result
            late = f"latency p50 {1000 * (result.latency_p50_s or 0):.1f} ms"
            print(
                f"{name}: {sent[0] / FLOOD_S:.0f} messages/s, formed after {result.mission_s:.1f} s, {late}, "
                f"{_line(flight)}, {result.messages_rejected.get('too_many', 0)} too many, ended {result.ended}",
                flush=True,
            )


CORNER = [4.0, 4.0]


def _flood(config: SwarmConfig, rate: float, lasts_s: float) -> int:
    """In a process of its own, repeat one message at a rate [1/s] for some time [s]; returns the number sent."""

    async def whole() -> int:
        os.nice(10)  # on a machine of its own, it would not take processor time from the others
        link = open_link(config, config.mission.n_robots - 1, listen="tcp/127.0.0.1:0")
        member, sent, began = config.mission.n_robots - 1, 0, time.monotonic()
        stamp = MissionStamp(0, config.mission.digest)
        said = wrap(encode(Message(sender=member, sequence=0, degree=1, stamp=stamp)), Proofs())
        await asyncio.sleep(1.0)
        while (now := time.monotonic()) - began < lasts_s:
            due = min(1000.0, rate * (now - began) - sent)
            for _ in range(int(due)):
                beacon = Beacon(stamp=time.time(), position=(CORNER[0], CORNER[1]))
                link.publish("say", member, pack(BeaconedMessage(beacon=beacon, message=said)))
                sent += 1
            await asyncio.sleep(0.0 if due >= 1.0 else 0.001)
        link.close()
        return sent

    return asyncio.run(whole())


def _fly_with(seed: int, options: dict[str, Any], *, recorded: bool = False, **happens: Any) -> Flight:
    with tempfile.TemporaryDirectory() as folder:
        return fly(config_of(10, seed, **options, **({"out": folder} if recorded else {})), **happens)


def _line(flight: Flight) -> str:
    result = flight.result
    return (
        f"separation {result.min_separation:.3f}, {result.bytes_per_robot_s:.0f} bytes/robot-s, "
        f"latency p99 {1000 * (result.latency_p99_s or 0):.1f} ms, "
        f"cpu {flight.cpu:.3f}, of the world {flight.world_cpu:.3f}, "
        f"memory {flight.memory_mib:.0f} MiB, {result.model_calls} calls, {result.late_commands} late commands"
    )


def _summary(name: str, flights: list[Flight]) -> None:
    results = [flight.result for flight in flights]
    formed = sum(bool(result.formed) for result in results)
    unsafe = sum(result.min_separation < SAFE for result in results)
    times = [result.mission_s for result in results if result.mission_s is not None]
    print(
        f"{name}: formed {formed} of {len(results)}, violations {unsafe}, "
        f"time {statistics.median(times) if times else float('nan'):.1f} s (median)"
    )
    latencies = [1000 * result.latency_p99_s for result in results if result.latency_p99_s is not None]
    under = sum(latency < LATENCY_MS for latency in latencies)
    print(
        f"  median, largest: latency p99 {_spread(latencies, 1)} ms ({under} under {LATENCY_MS:g}); "
        f"bytes/robot-s {_spread([result.bytes_per_robot_s for result in results], 0)}; "
        f"cpu of a robot {_spread([flight.cpu for flight in flights], 3)}; "
        f"memory {_spread([flight.memory_mib for flight in flights], 0)} MiB",
        flush=True,
    )


def _spread(values: list[float], decimals: int) -> str:
    if not values:
        return "none"
    return f"{statistics.median(values):.{decimals}f}, {max(values):.{decimals}f}"
