"""The stream of set-points to one autopilot: a segment's position and velocity, 20 times a second.

An autopilot has no trajectory from rest to rest of its own, so the driver flies along `llm_flock.robots._segment`. The
stream ends with the event loop: nothing keeps sending an old set-point on behalf of a program that hangs.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable

from llm_flock.robots import MotionLimits, Position, Segment
from llm_flock_flight._mavlink.conversation import Conversation
from llm_flock_flight._mavlink.frames import LocalFrame, ned_of

PERIOD_S = 0.05  # time between two set-points [s]

ASTRAY_M = 1.0
"""A vehicle with an estimate farther than this from its set-point is not led any more [m]: the estimate has jumped, and
the set-point means another place now; or the vehicle cannot follow."""

LOCAL_NED = 1  # the frame of the set-points (MAV_FRAME_LOCAL_NED)

WITHOUT_YAW, WITH_YAW = 0x0DC0, 0x09C0
"""Fields that the autopilot has to ignore: accelerations, the rate of yaw, and the yaw where it is not known."""


class SetPointStream:
    """Sends set-points while it runs, none outside the box of the `limits`; the first False of `allowed` ends it.

    It keeps the heading `yaw`, clockwise from north [rad]; None leaves it to the autopilot.
    """

    def __init__(
        self,
        conversation: Conversation,
        system_id: int,
        frame: LocalFrame,
        limits: MotionLimits,
        allowed: Callable[[], bool],
        yaw: float | None,
    ) -> None:
        self.segment: Segment | None = None
        self._conversation = conversation
        self._system_id = system_id
        self._frame = frame
        self._limits = limits
        self._allowed = allowed
        self.yaw = yaw
        self._clamp = True
        self._task: asyncio.Task[None] | None = None

    @property
    def running(self) -> bool:
        """Whether set-points are sent."""
        return self._task is not None and not self._task.done()

    def leads(self, position: Position) -> bool:
        """Whether set-points are sent to a vehicle that is near them; one that is not would fly aside to them."""
        if self.segment is None or not self.running:
            return False
        return math.dist(self.segment.at(time.monotonic())[0], position) <= ASTRAY_M

    def follow(self, segment: Segment, *, clamp: bool = True) -> None:
        """Follow a segment from now on; at its end, stay. `clamp` keeps set-points in the limits' box."""
        self.segment = segment
        self._clamp = clamp
        if not self.running:
            self._task = asyncio.create_task(self._run())

    def stop(self) -> None:
        """Send nothing any more."""
        if self._task is not None:
            self._task.cancel()
        self._task = self.segment = None

    async def _run(self) -> None:
        due = time.monotonic()
        while self._allowed():
            self._send(time.monotonic())
            due = max(due + PERIOD_S, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    def _send(self, now: float) -> None:
        assert self.segment is not None
        position, velocity, _ = self.segment.at(now)
        x, y, z = self._frame.to_ned(self._inside(position) if self._clamp else position)
        vx, vy, vz = ned_of(velocity)
        mask, yaw = (WITHOUT_YAW, 0.0) if self.yaw is None else (WITH_YAW, self.yaw)
        stamp_ms = int(now * 1000) & 0xFFFF_FFFF
        self._conversation.send(
            "set_position_target_local_ned",
            *(stamp_ms, self._system_id, 1, LOCAL_NED, mask, x, y, z, vx, vy, vz, 0.0, 0.0, 0.0, yaw, 0.0),
        )

    def _inside(self, position: Position) -> Position:
        low, high = self._limits.low, self._limits.high
        x, y, z = (min(max(v, a), b) for a, v, b in zip(low, position, high, strict=True))
        return (x, y, z)
