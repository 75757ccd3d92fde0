"""A Crazyflie with the interface of `llm_flock.robots.base`."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from llm_flock.errors import InputError
from llm_flock.robots.base import Commanded, MotionLimits, Position, RobotError, RobotState
from llm_flock.robots.crazyflie.link import SCHEMES, CrazyflieLink
from llm_flock.robots.segment import HOLD_S, Segment, stopping_point

TAKE_OFF, LAND, GO_TO, GO_TO_OLD = 7, 8, 12, 4
"""Commands of the high-level commander (firmware: `crtp_commander_high_level.c`)."""

GO_TO_VERSION = 8
"""First version of the protocol that knows `GO_TO`."""

ANSWER_S = 0.2
"""Wait for the answer to a command before it is resent [s]."""

ATTEMPTS = 8
"""Tries of a command: with a tenth of all packets lost, four fail once in 800 commands, eight once in 600,000."""

SHORTEST_S = 0.1
"""Least duration of a command that is resent [s]."""

ARM_S = 2.0
STOP_S = 1.0
"""Longest time to try arming, and an emergency stop [s]."""

REFUSED = 1
"""The firmware's answer to a take-off in flight, and to a second landing."""

POSITION_LOG: Mapping[str, str] = MappingProxyType(
    {
        "stateEstimate.x": "float",
        "stateEstimate.y": "float",
        "stateEstimate.z": "float",
        "stateEstimate.yaw": "FP16",
        "pm.vbat": "FP16",
        "supervisor.info": "uint16_t",
    }
)
"""Variables of the frequent log block, and their types in packets: 18 of the 26 bytes that a packet holds."""

VARIANCE_LOG: Mapping[str, str] = MappingProxyType(
    {"kalman.varPX": "float", "kalman.varPY": "float", "kalman.varPZ": "float"}
)
"""Variables of the log block for `settled`."""

POSITION_PERIOD_MS = 50
VARIANCE_PERIOD_MS = 100

SETTLED_SAMPLES = 10
SETTLED_RANGE = 0.001
"""The estimator has converged when the variance of no axis changed by more than this [m^2] over the last
`SETTLED_SAMPLES` samples (the measure of cflib's `Swarm.reset_estimators`, over one second instead of five)."""

CAN_ARM, ARMED, FLYING, TUMBLED, LOCKED, CRASHED = 0x01, 0x02, 0x10, 0x20, 0x40, 0x80
"""Bits of `supervisor.info` (firmware: `src/modules/src/supervisor.c`)."""

_NAMES = {
    CAN_ARM: "can be armed",
    ARMED: "armed",
    FLYING: "flying",
    TUMBLED: "tumbled",
    LOCKED: "locked: restart it",
    CRASHED: "crashed: recover it",
}


def says(info: int) -> str:
    """The supervisor's state, in words."""
    return ", ".join(name for bit, name in _NAMES.items() if info & bit) or "not ready"


class Telemetry:
    """The newest values that were logged. Written by one thread, read by any."""

    def __init__(self) -> None:
        self.position: Position | None = None
        self.stamp_s = 0.0
        self.yaw_deg = 0.0
        self.battery_v: float | None = None
        self.info = 0
        self._variances: deque[tuple[float, float, float]] = deque(maxlen=SETTLED_SAMPLES)
        self._variance_stamp_s = 0.0

    def take_position(self, data: Mapping[str, float], now: float) -> None:
        """Take a packet of `POSITION_LOG` that arrived at `now`."""
        self.battery_v = float(data["pm.vbat"])
        self.info = int(data["supervisor.info"])
        self.yaw_deg = float(data["stateEstimate.yaw"])
        self.position = (float(data["stateEstimate.x"]), float(data["stateEstimate.y"]), float(data["stateEstimate.z"]))
        self.stamp_s = now

    def take_variance(self, data: Mapping[str, float], now: float) -> None:
        """Take a packet of `VARIANCE_LOG` that arrived at `now`."""
        self._variances.append((data["kalman.varPX"], data["kalman.varPY"], data["kalman.varPZ"]))
        self._variance_stamp_s = now

    def settled(self, now: float) -> bool:
        """Whether the estimator has converged, by recent samples."""
        samples = list(self._variances)
        if len(samples) < SETTLED_SAMPLES or now - self._variance_stamp_s > SETTLED_SAMPLES * VARIANCE_PERIOD_MS / 1e3:
            return False
        return all(max(axis) - min(axis) < SETTLED_RANGE for axis in zip(*samples, strict=True))


class _Refused(RobotError):
    """The firmware refused a command."""


class CrazyflieRobot:
    """One Crazyflie. The firmware confirms each command; it is resent with the rest of its duration until then.

    Args:
        name: for reports and errors.
        uri: where it is: `radio://0/80/2M/E7E7E7E701`, `udp://127.0.0.1:19850`.
        limits: enforced by the driver.
        link_timeout_s: a link is lost after this silence [s].
        parameters: firmware parameters to set on connect, by `group.name`.
        cache: folder for the drones' tables: saves seconds at every connect but the first.
    """

    def __init__(
        self,
        name: str,
        uri: str,
        *,
        limits: MotionLimits | None = None,
        link_timeout_s: float = 1.0,
        parameters: Mapping[str, float] | None = None,
        cache: Path | None = None,
    ) -> None:
        if not uri.startswith(SCHEMES):
            raise InputError("uri", uri, f"one that begins with {', '.join(SCHEMES)}")
        self.uri = uri
        self.name = name
        self._limits = limits or MotionLimits()
        self._link_timeout_s = link_timeout_s
        self._parameters = dict(parameters or {})
        self._cache = cache
        self._link = CrazyflieLink(name, uri, cache)
        self._log = Telemetry()
        self._connected = self._lost = self._aloft = False
        self._set_point: Position | None = None
        self._segment: Segment | None = None
        self._yaw = 0.0

    async def connect(self, timeout_s: float) -> None:
        """Open the link and wait for the first estimate; reopens a lost link, also in flight.

        Raises:
            InputError: cflib is not installed, or a parameter cannot be set.
            RobotError: not done within `timeout_s`.
        """
        end = time.monotonic() + timeout_s
        await self._link.close()
        self._link, log = CrazyflieLink(self.name, self.uri, self._cache), Telemetry()
        self._set_point, self._segment = None, None
        await self._link.connect(timeout_s, self._parameters)
        try:
            await self._link.log("position", POSITION_PERIOD_MS, POSITION_LOG, log.take_position)
            await self._link.log("variance", VARIANCE_PERIOD_MS, VARIANCE_LOG, log.take_variance)
            while log.position is None:
                if time.monotonic() >= end:
                    raise RobotError(self.name, f"no position within {timeout_s:g} s")
                await asyncio.sleep(0.005)
        except BaseException:
            await self._link.close()
            raise
        self._log, self._connected, self._lost = log, True, False

    def state(self) -> RobotState:
        """The newest state that was logged."""
        log, now = self._log, time.monotonic()
        if not self._connected or log.position is None:
            raise RobotError(self.name, "was never connected")
        if self._link.lost is not None or self._link.silent_s(now) > self._link_timeout_s:
            self._lost = True
        return RobotState(
            position=log.position,
            stamp_s=log.stamp_s,
            battery_v=log.battery_v,
            link=0.0 if self._lost else self._link.quality,
            link_lost=self._lost,
            armed=bool(log.info & ARMED),
            flying=bool(log.info & FLYING),
            settled=log.settled(now),
        )

    async def close(self) -> None:
        """Close the link; a drone in the air hovers on until its battery is empty."""
        await self._link.close()

    def _ready(self) -> RobotState:
        """The state; raises RobotError if the link does not work."""
        if not self._connected or not self._link.open:
            raise RobotError(self.name, self._link.why_closed)
        state = self.state()
        if state.link_lost:
            raise RobotError(self.name, f"the link is lost: {self._link.lost or 'nothing comes any more'}")
        return state

    async def arm(self) -> None:
        """Arm the drone, and repeat until the supervisor confirms it."""
        end = time.monotonic() + ARM_S
        while not self._ready().armed:
            if time.monotonic() >= end:
                raise RobotError(self.name, f"does not arm; its supervisor says: {says(self._log.info)}")
            await self._link.send(lambda cf: cf.supervisor.send_arming_request(True))
            await self._until(lambda: self.state().armed, min(0.2, max(0.0, end - time.monotonic())))

    async def take_off(self, height_m: float, duration_s: float) -> Commanded:
        """Rise straight up to `height_m`, keeping the yaw."""
        start = self._ready().position
        sent = self._limits.clip(start, (start[0], start[1], height_m), duration_s)
        height, before = sent.target[2], self._aloft
        # Without an answer it may be in the air all the same, and then has to be landed.
        self._yaw, self._aloft = math.radians(self._log.yaw_deg), True
        try:
            await self._command(TAKE_OFF, lambda cf, left: cf.takeoff(height, left, yaw=None), duration_s, "take-off")
        except _Refused:
            self._aloft = before
            raise
        return self._flies(start, sent)

    async def go_to(self, target: Position, duration_s: float) -> Commanded:
        """Fly the straight segment from the last set-point, keeping the yaw."""
        state = self._ready()
        if not self._aloft and not state.flying:
            raise RobotError(self.name, "is not in the air")
        start = self._set_point or state.position
        sent = self._limits.clip(start, target, duration_s)
        await self._go(sent.target, duration_s)
        return self._flies(start, sent)

    async def hold(self) -> None:
        """Stop where the robot is."""
        state = self._ready()
        if not self._aloft and not state.flying:
            return
        stop: Position | None = state.position
        if self._segment is not None:
            stop = stopping_point(self._segment, time.monotonic(), HOLD_S)
        if stop is not None:
            await self._go(stop, HOLD_S)
            self._segment, self._set_point = None, stop

    async def land(self, height_m: float, duration_s: float) -> None:
        """Land straight down; tried even with a lost link. On the ground, do nothing."""
        if not self._connected:
            self._ready()
        if not self._aloft and not self.state().flying:
            return
        self._segment, self._set_point = None, None
        await self._command(LAND, lambda cf, left: cf.land(height_m, left, yaw=None), duration_s, "landing")
        self._aloft = False

    async def stop_motors(self) -> bool:
        """Emergency stop, repeated until the supervisor confirms it; tried even with a lost link."""
        end = time.monotonic() + STOP_S
        while time.monotonic() < end and self._link.open:
            try:
                await self._link.send(lambda cf: cf.supervisor.send_emergency_stop(), urgent=True)
            except RobotError:
                return False
            if await self._until(lambda: bool(self._log.info & LOCKED), 0.06):
                self._aloft = False
                return True
        return False

    def _flies(self, start: Position, sent: Commanded) -> Commanded:
        now = time.monotonic()
        self._segment = Segment(start=start, target=sent.target, duration_s=sent.duration_s, began_s=now)
        self._set_point = sent.target
        return sent

    async def _go(self, target: Position, duration_s: float) -> None:
        x, y, z = target
        old = self._link.cf.platform.get_protocol_version() < GO_TO_VERSION
        number = GO_TO_OLD if old else GO_TO
        await self._command(number, lambda cf, left: cf.go_to(x, y, z, self._yaw, left), duration_s, "a way-point")

    async def _command(self, number: int, send: Callable[[Any, float], None], duration_s: float, what: str) -> None:
        """Send until the firmware answers, each time with the rest of the duration; raises RobotError."""
        began = time.monotonic()
        for attempt in range(ATTEMPTS):
            left = max(SHORTEST_S, duration_s - (time.monotonic() - began))
            answer = await self._link.ask(number, lambda cf, left=left: send(cf.high_level_commander, left), ANSWER_S)
            if answer == 0:
                return
            # The first answer was lost: the drone is doing it already.
            if answer == REFUSED and (number == LAND or (number == TAKE_OFF and attempt)):
                return
            if answer is not None:
                said = says(self._log.info)
                raise _Refused(self.name, f"refused {what} (answer {answer}); its supervisor says: {said}")
        raise RobotError(self.name, f"did not confirm {what}, sent {ATTEMPTS} times")

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= end:
                return False
            await asyncio.sleep(0.005)
        return True
