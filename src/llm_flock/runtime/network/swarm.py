"""Launches a swarm on this machine: a world, N robots and a recorder, each a process of its own.

The launcher commands nobody. It watches like any observer, and ends the processes when the team has formed, when the
time is over, or when it is told to end itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
import tempfile
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from llm_flock.errors import FlockError
from llm_flock.record.writer import NullWriter
from llm_flock.runtime.network.config import SwarmConfig, check_models
from llm_flock.runtime.network.observer import Observer
from llm_flock.runtime.network.watch import CHECK_S, attend, visit
from llm_flock.runtime.trial import TrialProgress
from llm_flock.transport.zenoh import Link

START_S = 60.0
"""So long a process may take to start [s]."""

END_S = 3.0
"""So long a process may take to end when it is told to [s]."""

RECORD_NAME = "run.mcap"


class SwarmError(FlockError):
    """A process of the swarm did not start, or ended on its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SwarmResult:
    """What came of a swarm.

    Attributes:
        stopped: why it ended: formed, time, or interrupted.
        formed: whether the team had formed, as for a run; the round there is the time of a step here.
        mission_s: from the first robot's first round until it had formed [s]; None if it never had.
        n_robots: robots alive at the end.
        simulated: whether any language model was a simulated stand-in.
        min_separation: smallest distance of two bodies, from the world's true positions, along segments [units].
        model_calls: calls of language models.
        calls_failed: those that gave no answer.
        tokens: in and out.
        bytes_per_robot_s: messages and beacons broadcast, each counted once [bytes/s].
        latency_p50_s: one-way latency of a beacon, median [s].
        latency_p99_s: 99th percentile [s].
        late_commands: commands that bodies refused because they came too late.
        waypoints: waypoints flown, by who made them.
        messages_rejected: messages refused, by reason.
        record: the record.
    """

    stopped: str
    formed: bool
    mission_s: float | None
    n_robots: int
    simulated: bool
    min_separation: float
    model_calls: int
    calls_failed: int
    tokens: int
    bytes_per_robot_s: float
    latency_p50_s: float | None
    latency_p99_s: float | None
    late_commands: int
    waypoints: dict[str, int]
    messages_rejected: dict[str, int]
    record: str | None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def free_port() -> int:
    """A TCP port that nobody listens on at the moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def world_config(config: SwarmConfig) -> SwarmConfig:
    """The configuration of the world's own process: it listens where the others connect to."""
    network = config.network.model_copy(update={"listen": config.network.connect, "connect": ""})
    return config.model_copy(update={"network": network})


class Swarm:
    """The running processes of a swarm, and what is seen of them. Made by `launched`.

    Attributes:
        pids: process ids by name: `world`, `recorder`, `robot-3`.
        ended: exit codes of those that have ended.
        observer: what the launcher sees.
    """

    def __init__(
        self, config: SwarmConfig, nursery: asyncio.subprocess.Process, folder: Path, link: Link | None
    ) -> None:
        self.config = config
        self.pids: dict[str, int] = {}
        self.ended: dict[str, int] = {}
        self.observer: Observer
        self.link = link
        self._nursery = nursery
        self._folder = folder
        self._news = asyncio.Condition()

    async def listen(self) -> None:
        """Take note of what the nursery tells."""
        out = self._nursery.stdout
        assert out is not None
        while line := await out.readline():
            told = json.loads(line)
            async with self._news:
                if "pid" in told:
                    self.pids[told["name"]] = told["pid"]
                    self.ended.pop(told["name"], None)
                elif "ended" in told:
                    self.ended[told["name"]] = told["ended"]
                else:
                    self.ended["nursery ready"] = 0
                self._news.notify_all()

    async def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait for news of the nursery that make a condition true."""
        async with asyncio.timeout(START_S), self._news:
            await self._news.wait_for(condition)

    async def start(self, name: str, kind: str, **more: Any) -> None:
        """Start a process."""
        line = self._nursery.stdin
        assert line is not None
        config = self.config
        if kind == "world":
            config = world_config(config)
        self.pids.pop(name, None)
        order = {"name": name, "kind": kind, "config": config.model_dump(mode="json"), **more}
        line.write(json.dumps(order).encode() + b"\n")
        await line.drain()
        await self.wait_until(lambda: name in self.pids)

    async def start_robot(self, robot: int) -> None:
        """Start one robot, or start it again."""
        await self.start(f"robot-{robot}", "robot", id=robot)

    async def start_world(self) -> None:
        """Start the world, and wait until others can connect to it.

        Raises:
            SwarmError: it did not come up.
        """
        ready = self._folder / "ready"
        await self.start("world", "world", ready=str(ready))
        deadline = time.monotonic() + START_S
        while not ready.exists():
            if "world" in self.ended or time.monotonic() > deadline:
                raise SwarmError("the world did not start")
            await asyncio.sleep(0.02)

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal to one process."""
        os.kill(self.pids[name], number)

    async def end(self) -> None:
        """End everybody: politely, then not."""
        for name, pid in self.pids.items():
            if name not in self.ended:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGTERM)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(END_S), self._news:
                await self._news.wait_for(lambda: self.pids.keys() <= self.ended.keys())

    async def run(self, until: Callable[[Observer], bool] | None = None) -> str:
        """Watch until the team has formed (or `until`), or the time is over; the reason.

        Raises:
            SwarmError: the world ended on its own.
        """
        done = until or _formed
        deadline = time.monotonic() + self.config.network.max_s
        while time.monotonic() < deadline:
            self.observer.check(time.time())
            if done(self.observer):
                return "formed"
            if "world" in self.ended:
                raise SwarmError("the world has ended")
            await asyncio.sleep(CHECK_S)
        return "time"

    def result(self, stopped: str, record: str | None) -> SwarmResult:
        """The figures so far."""
        observer, reports = self.observer, self.observer.reports
        figures, began = observer.figures, observer.began_s
        waypoints: dict[str, int] = {}
        rejected: dict[str, int] = {}
        for report in reports.values():
            for total, part in ((waypoints, report.waypoints), (rejected, report.rejected)):
                for key, count in part.items():
                    total[key] = total.get(key, 0) + count
        seconds = sum(max(0.0, report.stamp - (began or report.stamp)) for report in reports.values())
        ages = sorted(figures.latencies_s)

        def percentile(share: float) -> float | None:
            return ages[min(len(ages) - 1, int(share * len(ages)))] if ages else None

        return SwarmResult(
            stopped=stopped,
            formed=observer.formed_s is not None,
            mission_s=None if observer.formed_s is None or began is None else observer.formed_s - began,
            n_robots=len(observer.robots),
            simulated=self.config.simulated,
            min_separation=figures.min_separation,
            model_calls=figures.calls,
            calls_failed=figures.calls_failed,
            tokens=figures.tokens,
            bytes_per_robot_s=sum(report.bytes for report in reports.values()) / seconds if seconds else 0.0,
            latency_p50_s=percentile(0.5),
            latency_p99_s=percentile(0.99),
            late_commands=figures.late_commands,
            waypoints=waypoints,
            messages_rejected=rejected,
            record=record,
        )


@asynccontextmanager
async def launched(
    config: SwarmConfig,
    *,
    on_row: Callable[[TrialProgress], None] | None = None,
    absent: frozenset[int] = frozenset(),
) -> AsyncGenerator[Swarm]:
    """A swarm whose processes run, and have all ended when the context is left.

    Args:
        config: the swarm; with `out`, a recorder writes `run.mcap` there. With an empty `connect`, a free port is
            taken.
        on_row: told how it goes, once in the time of a step.
        absent: robots that are not started.

    Raises:
        SwarmError: a process did not start.
        InputError: the configuration does not work here.
    """
    check_models(config)
    if not config.network.connect:
        network = config.network.model_copy(update={"connect": f"tcp/127.0.0.1:{free_port()}"})
        config = config.model_copy(update={"network": network})
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    nursery = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "llm_flock.runtime.network.nursery",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for the launcher only, and the whole group can be ended at once
        env=environment,
    )
    with tempfile.TemporaryDirectory(prefix="llm-flock-") as folder:
        swarm = Swarm(config, nursery, Path(folder), None)
        news = asyncio.create_task(swarm.listen())
        try:
            await swarm.wait_until(lambda: "nursery ready" in swarm.ended)
            await swarm.start_world()
            swarm.link = visit(config)
            swarm.observer = Observer(config, NullWriter(), on_row)
            attend(swarm.link, swarm.observer)
            if config.trial.out is not None:
                await swarm.start("recorder", "watch", record=str(Path(config.trial.out) / RECORD_NAME))
            for robot in range(config.mission.n_robots):
                if robot not in absent:
                    await swarm.start_robot(robot)
            yield swarm
        finally:
            await swarm.end()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(nursery.pid, signal.SIGKILL)
            if swarm.link is not None:
                swarm.link.close()
            await nursery.wait()
            news.cancel()
            await asyncio.gather(news, return_exceptions=True)


def _formed(observer: Observer) -> bool:
    return observer.formed_s is not None


async def run_swarm(config: SwarmConfig, on_row: Callable[[TrialProgress], None] | None = None) -> SwarmResult:
    """Fly one mission with a swarm of processes on this machine.

    Raises:
        SwarmError: a process of it failed.
    """
    async with launched(config, on_row=on_row) as swarm:
        stopped = await swarm.run()
        out = config.trial.out
        return swarm.result(stopped, None if out is None else str(Path(out) / RECORD_NAME))
