"""Sends each drone its newest accepted pose, at a bounded rate."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from llm_flock.robots import Pose, PoseFrame, PoseSource, RobotError
from llm_flock_flight._positions.gate import PoseGate


@runtime_checkable
class TellsSenders(Protocol):
    """A source that follows one sender, and hears when there is another one."""

    def senders(self, now: float) -> tuple[str, ...]:
        """The senders of the last second as text: the one that is followed first, then the others."""
        ...


@runtime_checkable
class TakesPoses(Protocol):
    """A robot whose estimator takes poses from outside."""

    async def take_pose(self, pose: Pose) -> None:
        """Send a pose to the robot, which confirms nothing, or raise RobotError."""
        ...


class PoseFeed:
    """Runs as long as its context lasts: before the preflight until the last drone is down.

    Each drone gets at most `rate_hz` poses a second that the gate let through: of several only the newest is sent.
    """

    def __init__(
        self,
        source: PoseSource,
        gate: PoseGate,
        robots: Mapping[str, TakesPoses],
        rate_hz: float,
        *,
        attitude: bool = False,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self.gate = gate
        self._source = source
        self._robots = robots
        self._period_s = 1.0 / rate_hz
        self._attitude = attitude
        self._clock = clock or time.monotonic
        self._newest: dict[str, tuple[Pose, float]] = {}
        self._sent: dict[str, tuple[Pose, float]] = {}
        self._came = {name: asyncio.Event() for name in robots}
        self._tasks: list[asyncio.Task[None]] = []
        self._open = False
        self._opened_s = 0.0

    def listened_s(self, now: float) -> float:
        """Time since the source was opened [s]."""
        return now - self._opened_s

    def senders(self, now: float) -> tuple[str, ...]:
        """The senders of poses now as text, the one that is followed first; empty if the source does not know them."""
        return self._source.senders(now) if isinstance(self._source, TellsSenders) else ()

    @property
    def refused(self) -> dict[str, int]:
        """Everything that was dropped, by `drone: reason`, or by the reason alone."""
        found: Counter[str] = Counter(self._source.refused)
        for (name, why), count in self.gate.refused.items():
            found[f"{name}: {why}" if name else why] += count
        return dict(sorted(found.items()))

    def newest(self, name: str) -> tuple[Pose, float] | None:
        """The pose that was last sent to a drone, and its arrival here [s]; None before the first."""
        return self._sent.get(name)

    def age_s(self, name: str, now: float) -> float | None:
        """Time since the arrival of the pose that was last sent to a drone [s]; None before the first."""
        sent = self._sent.get(name)
        return None if sent is None else now - sent[1]

    async def __aenter__(self) -> Self:
        """Begin; raises InputError if the source cannot be opened."""
        await self._source.open(self._take)
        self._open, self._opened_s = True, self._clock()
        self._tasks = [asyncio.create_task(self._send(name, robot)) for name, robot in self._robots.items()]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._source.close()

    def _take(self, frame: PoseFrame) -> None:
        now = self._clock()
        for name, pose in self.gate.take(frame, now).items():
            self._newest[name] = (pose if self._attitude else Pose(pose.position)), now
            self._came[name].set()

    async def _send(self, name: str, robot: TakesPoses) -> None:
        """Send what comes for one drone, until the end.

        A cancellation does not suffice: a driver with `asyncio.wait_for` of Python 3.11 drops one that comes just as a
        pose has been sent.
        """
        came = self._came[name]
        while self._open:
            await came.wait()
            came.clear()
            pose, now = self._newest[name]
            due = self._clock() + self._period_s
            with suppress(RobotError):  # out of reach, or not connected yet: the flight's own monitors see to that
                await robot.take_pose(pose)
                self._sent[name] = pose, now
            await asyncio.sleep(max(0.0, due - self._clock()))
