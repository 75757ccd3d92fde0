"""A simulated robot with the interface of `llm_flock.robots._base`, for tests and trial flights."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace

from llm_flock.robots._base import Commanded, Equipment, MotionLimits, Position, RobotError, RobotState
from llm_flock.robots._point_mass import PointMass
from llm_flock.robots._segment import HOLD_S, Segment, stopping_point


class SimulatedRobot:
    """One point mass in this process. `clock` returns the time [s]. Tests that simulate failures give its `body`."""

    def __init__(
        self,
        name: str,
        home: Position,
        *,
        limits: MotionLimits | None = None,
        clock: Callable[[], float] | None = None,
        body: PointMass | None = None,
        equipment: Equipment | None = None,
    ) -> None:
        self.body = body or PointMass(home=home, ground_m=min(0.0, home[2]))
        self.name = name
        self._limits = limits or MotionLimits()
        self._clock = clock or time.monotonic
        self._equipment = equipment or Equipment()
        self._set_point = home
        self._segment: Segment | None = None
        self._last_state: RobotState | None = None
        self._open = self._lost = False

    async def connect(self, timeout_s: float) -> None:
        """Open the link: at once, unless `lose_link` was called."""
        if self._lost:
            await asyncio.sleep(timeout_s)
            raise RobotError(self.name, f"no answer within {timeout_s:g} s")
        self._open = True
        self._set_point = self.body.estimate(self._clock())
        self._read_state()

    def state(self) -> RobotState:
        """The newest state; with a lost link, the last one that arrived."""
        if self._last_state is None:
            raise RobotError(self.name, "was never connected")
        if self._open and not self._lost:
            return self._read_state()
        return self._last_state

    def _read_state(self) -> RobotState:
        now = self._clock()
        self._last_state = RobotState(
            position=self.body.estimate(now),
            stamp_s=now,
            battery_v=self.body.battery_v,
            link=1.0,
            armed=self.body.armed,
            flying=self.body.flying,
            settled=self.body.variance(now) < 0.001,
            fault="locked" if self.body.locked else None,
            equipment=self._equipment,
        )
        return self._last_state

    async def arm(self) -> None:
        self._need_link()
        if not self.body.arm(True):
            raise RobotError(self.name, "cannot be armed: it is locked, or flies")

    async def take_off(self, height_m: float, duration_s: float) -> Commanded:
        self._need_link()
        now = self._clock()
        start = self.body.estimate(now)
        sent = self._limits.clip(start, (start[0], start[1], height_m), duration_s)
        self._need_success(self.body.take_off(sent.target[2], duration_s, now), "take-off")
        return self._fly(start, sent, now)

    async def go_to(self, target: Position, duration_s: float) -> Commanded:
        """Fly the straight segment from the last set-point."""
        self._need_link()
        if not self.body.flying:
            raise RobotError(self.name, "is not in the air")
        now = self._clock()
        sent = self._limits.clip(self._set_point, target, duration_s)
        self._need_success(self.body.go_to(sent.target, duration_s, now), "a way-point")
        return self._fly(self._set_point, sent, now)

    async def hold(self) -> None:
        self._need_link()
        if self._segment is None or not self.body.flying:
            return
        now = self._clock()
        stop = stopping_point(self._segment, now, HOLD_S)
        if stop is not None:
            self._need_success(self.body.go_to(stop, HOLD_S, now), "a stop")
            self._segment, self._set_point = None, stop

    async def land(self, height_m: float, duration_s: float) -> None:
        """Land straight down; on the ground, do nothing."""
        self._need_link()
        if self.body.flying:
            self._need_success(self.body.land(height_m, duration_s, self._clock()), "landing")
            self._segment = None

    async def stop_motors(self) -> bool:
        """Cut the motors; confirmed at once, unless the link is lost."""
        if not self._open or self._lost:
            return False
        self.body.emergency_stop(self._clock())
        return True

    async def close(self) -> None:
        """Close the link; the body flies on."""
        self._open = False

    def lose_link(self) -> None:
        """For tests: lose every packet from now on, in both directions."""
        if self._last_state is not None and not self._lost:
            self._last_state = replace(self._read_state(), link=0.0, link_lost=True)
        self._lost = True

    def _fly(self, start: Position, sent: Commanded, now: float) -> Commanded:
        self._segment = Segment(start=start, target=sent.target, duration_s=sent.duration_s, began_s=now)
        self._set_point = sent.target
        return sent

    def _need_link(self) -> None:
        if not self._open:
            raise RobotError(self.name, "is not connected")
        if self._lost:
            raise RobotError(self.name, "the link is lost")

    def _need_success(self, answer: int, what: str) -> None:
        if answer:
            raise RobotError(self.name, f"refused {what} (answer {answer})")
