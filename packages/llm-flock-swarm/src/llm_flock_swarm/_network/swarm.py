"""Launches a swarm on this machine: a world, N robots and a recorder, each as a process. It commands no robot."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from llm_flock.errors import FlockError
from llm_flock.llm import parse_model, parse_models
from llm_flock.members import WORLD
from llm_flock.record import Guarded, NullWriter, RecordSink
from llm_flock.runtime import TeamPlanners, TrialProgress, by_origin, finite, warn_of_mission, waypoint_shares
from llm_flock_swarm._network.config import SwarmConfig, check_models, warn_of_spacing
from llm_flock_swarm._network.connection import load_keys
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.watch import CHECK_S, observing

START_S = 60.0  # longest start of a process [s]
END_S = 3.0  # longest wait for processes to end after SIGTERM [s]


class SwarmError(FlockError):
    """A process of the swarm did not start, or ended unexpectedly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SwarmResult:
    """Outcome of a swarm."""

    stopped: str  # why: formed, time, ended (no robot is left), or no_plan: no robot has one, and no model gives one
    reason: str | None  # the commonest reason why plans were refused, where it ended by no_plan
    formed: bool | None  # whether the team formed, with a step's time in place of a round; None if nobody saw its end
    mission_s: float | None  # from the first robot's first round until it formed; None if it never did
    n_robots: int  # alive at the end
    simulated: bool  # whether any language model was a simulated stand-in
    min_separation: float  # smallest distance of two bodies, by their true positions, along segments too [units]
    model_calls: int
    calls_failed: int  # without an answer
    tokens: int  # in and out
    bytes_per_robot_s: float  # messages and beacons broadcast, each counted once [bytes/s]
    latency_p50_s: float | None  # one-way latency of a beacon, median
    latency_p99_s: float | None  # 99th percentile
    late_commands: int  # commands that bodies refused because they came too late
    waypoints: dict[str, int]  # flown, by origin
    waypoint_shares: dict[str, float]  # the same as shares of all
    plan_robot: int | None  # robot that proposed the plan in force at the end; None without one plan
    plan_by: str | None  # who made that plan: a model, by its name, or `geometry`
    breakers_opened: tuple[int, ...]  # robots whose circuit breaker was open at any time
    messages_rejected: dict[str, int]  # by reason
    shown_to_lie: dict[int, str]  # robots whose own signatures prove that they lie, and the reason
    gave_up: dict[str, str]  # parts of the launcher that ended by an error while the robots flew on: sink, display, ...
    ended: dict[str, int]  # processes that ended before the swarm did, and their exit codes; -9 for SIGKILL, and so on
    record: str | None  # its path; None without one

    @property
    def crashed(self) -> list[str]:
        """Processes that ended by a fault of their own, not by a signal."""
        return [name for name, code in self.ended.items() if code > 0]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def free_port() -> int:
    """A TCP port that is free now, below those that a system gives to connections before this one is used."""
    while True:
        port = random.SystemRandom().randrange(20_000, 32_000)
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port


def world_config(config: SwarmConfig) -> SwarmConfig:
    """The configuration of the world process: it listens where the others connect."""
    network = config.network.model_copy(update={"listen": config.network.connect, "connect": ""})
    return config.model_copy(update={"network": network})


class Swarm:
    """The running processes of a swarm, and an observer that follows them. Made by `launched`."""

    def __init__(self, config: SwarmConfig, forkserver: asyncio.subprocess.Process) -> None:
        self.config = config
        self.pids: dict[str, int] = {}  # by name: `world`, `recorder`, `robot-3`
        self.ended: dict[str, int] = {}  # exit codes
        self.observer: Observer
        self.told: Path  # file with the result, from when it is known
        self.ready: set[str] = set()
        self._forkserver = forkserver
        self._unheard = False  # whether nothing tells of starts and ends any more
        self._news = asyncio.Condition()

    async def listen(self) -> None:
        """Take note of every start and end that the fork server writes; ends with it."""
        out = self._forkserver.stdout
        assert out is not None
        while line := await out.readline():
            event = json.loads(line)
            async with self._news:
                if "pid" in event:
                    self.pids[event["name"]] = event["pid"]
                    self.ended.pop(event["name"], None)
                elif "ended" in event:
                    self.ended[event["name"]] = event["ended"]
                else:
                    self.ready.add(event["ready"])
                self._news.notify_all()
        self._unheard = True

    async def wait_until(self, condition: Callable[[], bool], longest_s: float = START_S) -> None:
        """Wait until starts or ends of processes make a condition true; `TimeoutError` if that takes too long."""
        async with asyncio.timeout(longest_s), self._news:
            await self._news.wait_for(condition)

    async def start(self, name: str, kind: str, **more: Any) -> None:
        line = self._forkserver.stdin
        assert line is not None
        config = world_config(self.config) if kind == "world" else self.config
        self.pids.pop(name, None)
        order = {"name": name, "kind": kind, "config": config.model_dump(mode="json"), **more}
        order["base_url"] = config.model.typed_url  # which its dump does not tell from a file's
        line.write(json.dumps(order).encode() + b"\n")
        await line.drain()
        await self.wait_until(lambda: name in self.pids)

    async def start_robot(self, robot: int) -> None:
        """Start one robot, for the first time or again."""
        await self.start(f"robot-{robot}", "robot", id=robot)

    async def start_world(self) -> None:
        """Start the world, and wait until others can connect to it; `SwarmError` if it does not start."""
        await self.start("world", "world")
        with contextlib.suppress(TimeoutError):
            await self.wait_until(lambda: "world" in self.ready or "world" in self.ended)
        if "world" not in self.ready:
            raise SwarmError("the world did not start")

    async def end(self) -> None:
        """Tell every process to end, and wait a little for that."""
        for name, pid in self.pids.items():
            if name not in self.ended:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGTERM)
        with contextlib.suppress(TimeoutError):
            await self.wait_until(lambda: self.pids.keys() <= self.ended.keys(), END_S)

    async def run(self, until: Callable[[Observer], bool] = lambda observer: observer.formed_s is not None) -> str:
        """Watch until `formed` (or `until`), `time` is over, no model gives a plan (`no_plan`), or all `ended`."""
        deadline = time.monotonic() + self.config.network.max_s
        reasons: list[str] = []

        def look() -> None:
            self.observer.check()
            reasons.extend(["formed"] if until(self.observer) else ["no_plan"] if self.observer.hopeless else [])

        watching = Guarded("observer", look, self.observer.ended)
        while time.monotonic() < deadline:
            watching()
            if reasons:
                return reasons[0]
            if "world" in self.ended or self._unheard:
                raise SwarmError("the fork server has ended" if self._unheard else "the world has ended")
            robots = {name for name in self.pids if name.startswith("robot-")}
            if robots and robots <= self.ended.keys():
                return "ended"
            await asyncio.sleep(CHECK_S)
        return "time"

    def tell(self, result: SwarmResult) -> None:
        """Let the record end with this result: its recorder sees the end from elsewhere, a little earlier or later."""
        told = result.to_dict() | {"min_separation": finite(result.min_separation)}
        self.told.write_text(json.dumps(told), encoding="utf-8")

    def result(self, stopped: str) -> SwarmResult:
        observer, reports, began = self.observer, self.observer.reports.values(), self.observer.began_s
        seconds = sum(max(0.0, heard - (began or heard)) for heard in observer.heard_s.values())
        ages = sorted(observer.said.latencies_s)
        waypoints = by_origin(sum((Counter(report.waypoints) for report in reports), Counter[str]()))
        supplier = observer.supplier

        def percentile(share: float) -> float | None:
            return ages[min(len(ages) - 1, int(share * len(ages)))] if ages else None

        return SwarmResult(
            stopped=stopped,
            reason=observer.hopeless if stopped == "no_plan" else None,
            formed=None
            if "observer" in observer.ended and observer.formed_s is None
            else observer.formed_s is not None,
            mission_s=observer.mission_s,
            n_robots=len(observer.robots),
            simulated=self.config.simulated,
            min_separation=observer.min_separation,
            model_calls=observer.said.calls,
            calls_failed=observer.said.calls_failed,
            tokens=observer.said.tokens,
            bytes_per_robot_s=sum(report.bytes for report in reports) / seconds if seconds else 0.0,
            latency_p50_s=percentile(0.5),
            latency_p99_s=percentile(0.99),
            late_commands=observer.late_commands,
            waypoints=waypoints,
            waypoint_shares=waypoint_shares(waypoints),
            plan_robot=None if supplier is None else supplier[0],
            plan_by=None if supplier is None else supplier[1],
            breakers_opened=tuple(sorted(observer.said.breakers_opened)),
            messages_rejected=dict(observer.rejected),
            shown_to_lie=dict(observer.shown_to_lie),
            gave_up={name: repr(error) for name, error in observer.ended.items()},
            ended=dict(self.ended),
            record=None if self.config.record is None else str(self.config.record),
        )


async def check_robots(config: SwarmConfig) -> None:
    """Refuse with an `InputError` what would otherwise end the process of each robot after its start."""
    check_models(config)
    config.protocol.rules()
    load_keys(config, WORLD)
    await TeamPlanners(config).close()


@asynccontextmanager
async def launch_swarm(
    config: SwarmConfig,
    *,
    on_row: Callable[[TrialProgress], None] | None = None,
    absent: frozenset[int] = frozenset(),
    sink: RecordSink | None = None,
    on_launch: Callable[[], object] = lambda: None,
) -> AsyncGenerator[Swarm]:
    """A swarm whose processes are running, all but `absent` robots; all have ended when the context is left.

    With `out`, a recorder writes `run.mcap` there. An empty `connect` takes a free port. `on_row` is called once per
    step time; a `sink` takes what the launcher observes. `on_launch` is called before the first process starts.
    """
    await check_robots(config)
    warn_of_mission(config.mission)
    warn_of_spacing(config)
    if not config.network.connect:
        network = config.network.model_copy(update={"connect": f"tcp/127.0.0.1:{free_port()}"})
        config = config.model_copy(update={"network": network})
    on_launch()
    forkserver = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "llm_flock_swarm._network.forkserver",
        *_shared_by(config),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for the launcher only, and the whole group can be ended at once
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    with contextlib.ExitStack() as watching:
        swarm = Swarm(config, forkserver)
        news = asyncio.create_task(swarm.listen())
        try:
            await swarm.wait_until(lambda: "forkserver" in swarm.ready)
            await swarm.start_world()
            swarm.observer = watching.enter_context(observing(config, sink or NullWriter(), on_row))
            swarm.told = Path(watching.enter_context(tempfile.TemporaryDirectory())) / "result.json"
            if config.record is not None:
                await swarm.start("recorder", "watch", record=str(config.record), told=str(swarm.told))
            for robot in range(config.mission.n_robots):
                if robot not in absent:
                    await swarm.start_robot(robot)
            yield swarm
        finally:
            await swarm.end()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(forkserver.pid, signal.SIGKILL)
            watching.close()
            await forkserver.wait()
            news.cancel()
            await asyncio.gather(news, return_exceptions=True)


def _shared_by(config: SwarmConfig) -> Sequence[str]:
    """Modules that robots would otherwise import one by one, at their first question to a provider."""
    models = parse_models(config.model.model, config.mission.n_robots)
    hosted = any(parse_model(model).kind == "provider" for model in models)
    return ("genai_prices", "llm_flock.llm._client", "llm_flock.llm._hosted") if hosted else ()


async def run_swarm(
    config: SwarmConfig,
    on_row: Callable[[TrialProgress], None] | None = None,
    sink: RecordSink | None = None,
    on_start: Callable[[Swarm], None] = lambda _: None,
    on_launch: Callable[[], object] = lambda: None,
) -> SwarmResult:
    """Fly one mission with a swarm of processes on this machine; `SwarmError` if one of them fails.

    `on_launch` is called before the first process starts, `on_start` gets the swarm once all of them run. A swarm that
    takes missions from ROS does not end when it has formed, nor does one that is told to fly on (`stop_when_formed`).
    """
    async with launch_swarm(config, on_row=on_row, sink=sink, on_launch=on_launch) as swarm:
        on_start(swarm)
        flies_on = config.ros2.ros_missions or not config.trial.stop_when_formed
        result = swarm.result(await (swarm.run(lambda _: False) if flies_on else swarm.run()))
        swarm.tell(result)
        return result
