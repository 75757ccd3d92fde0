"""A Crazyflie with the interface of `llm_flock.robots._base`."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from llm_flock.errors import InputError
from llm_flock.robots import (
    HOLD_S,
    Commanded,
    Equipment,
    MotionLimits,
    Pose,
    Position,
    RobotError,
    RobotState,
    Segment,
    stopping_point,
)
from llm_flock_flight._crazyflie.controllers import READ, equipment
from llm_flock_flight._crazyflie.link import NETWORK, SCHEMES, CrazyflieLink, Unusable, host_and_port
from llm_flock_flight._crazyflie.telemetry import (
    ARMED,
    FLYING,
    LIGHTHOUSE_LOG,
    LIGHTHOUSE_PERIOD_MS,
    LOCKED,
    NEEDED,
    POSITION_LOG,
    POSITION_PERIOD_MS,
    UNWATCHED,
    VARIANCE_LOG,
    VARIANCE_PERIOD_MS,
    Telemetry,
    fault_of,
    says,
)
from llm_flock_flight._pauses import own_pauses

TAKE_OFF, LAND, GO_TO, GO_TO_OLD = 7, 8, 12, 4
"""Commands of the high-level commander (firmware: `crtp_commander_high_level.c`)."""

ANSWER_S = 0.2  # wait for the answer to a command before it is resent [s]

ATTEMPTS = 8
"""Tries of a command: with a tenth of all packets lost, four fail once in 800 commands, eight once in 600,000."""

ARM_S = 2.0
STOP_S = 1.0
"""Longest time to try arming, and an emergency stop [s]."""

REFUSED = 1  # the firmware's answer to a take-off in flight, and to a second landing

RELAX_TIMES, RELAX_S = 4, 0.02
"""How often the drone is told that no set-points come from here, and the time in between [s]: nothing confirms it."""

UNPREPARED = "it was flying, or had landed less than 2 s ago, as it was connected: try again"
"""Why a drone is not ready whose parameters were left alone."""

LINK_TIMEOUT_S = 1.0  # a link is lost after this silence, unless a flight puts up with more [s]


class _Refused(RobotError):
    """The firmware refused a command."""


class CrazyflieRobot:
    """One Crazyflie. The firmware confirms each command; it is resent with the rest of its duration until then.

    `parameters` of the firmware, by `group.name`, are set and read back on connect, never in flight. With
    `stop_watchdog` the motors stop after a second without a packet, from take-off on, and the drone falls; as nothing
    ends the watchdog, it is locked after `close`. `cache` is a folder for the drones' tables; None: the user's.
    """

    def __init__(
        self,
        name: str,
        uri: str,
        *,
        limits: MotionLimits | None = None,
        link_timeout_s: float = LINK_TIMEOUT_S,
        parameters: Mapping[str, float] | None = None,
        cache: Path | None = None,
        stop_watchdog: bool = False,
    ) -> None:
        if not uri.startswith(SCHEMES):
            raise InputError("uri", uri, f"one that begins with {', '.join(SCHEMES)}")
        if uri.startswith(NETWORK) and host_and_port(uri) is None:
            raise InputError("uri", uri, "a host and a port: udp://127.0.0.1:19850")
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
        self._equipment = Equipment()
        self._stop_watchdog = stop_watchdog
        self._feeding: asyncio.Task[None] | None = None

    async def connect(self, timeout_s: float) -> None:
        """Open the link and wait for the first estimate, or raise RobotError; reopens a lost link, also in flight."""
        end = time.monotonic() + timeout_s
        own_pauses()  # watches them from now on
        while True:
            try:
                return await self._connect(end)
            except RobotError as error:
                await self._link.close()
                if time.monotonic() >= end or isinstance(error, Unusable):
                    raise
            except BaseException:
                await self._link.close()
                raise

    async def _connect(self, end: float) -> None:
        await self._link.close()
        self._link, log = CrazyflieLink(self.name, self.uri, self._cache), Telemetry()
        self._set_point, self._segment = None, None
        await self._link.connect(max(0.0, end - time.monotonic()))
        until = min(end, time.monotonic() + 5.0)  # then the link is opened again
        missing = await self._link.log("position", POSITION_PERIOD_MS, POSITION_LOG, log.take_position, NEEDED)
        missing += await self._link.log("variance", VARIANCE_PERIOD_MS, VARIANCE_LOG, log.take_variance)
        log.without_variance = any(name in missing for name in VARIANCE_LOG)
        if all(map(self._link.logs, LIGHTHOUSE_LOG)):
            await self._link.log("lighthouse", LIGHTHOUSE_PERIOD_MS, LIGHTHOUSE_LOG, log.take_lighthouse)
        while log.position is None:
            if time.monotonic() >= until:
                raise RobotError(self.name, "connected, but sends no position")
            await asyncio.sleep(0.005)
        # A drone that was told to take off may be about to, even if it does not report flying.
        if not log.info & FLYING and not self._aloft:
            self._equipment = await self._prepare(until, missing)
        elif not self._connected:
            self._equipment = Equipment(complaints=(UNPREPARED,))
        self._log, self._connected, self._lost = log, True, False

    async def _prepare(self, until: float, missing: tuple[str, ...]) -> Equipment:
        """Set and read parameters, and hand the drone to its high-level commander. Only on the ground."""
        parameters = self._link.parameters
        differ = await parameters.write(self._parameters, until)
        values = {name: await parameters.read(name, until) for name in parameters.known(READ)}
        await self._relax()
        return equipment(values, tuple(UNWATCHED[name] for name in missing if name in UNWATCHED), differ)

    async def _relax(self) -> None:
        """Say that no set-points come from here.

        A client that sent one, if only as it closed its link, has left a set-point that outranks the high-level
        commander's: a take-off is confirmed then, and the motors do not turn.
        """
        for _ in range(RELAX_TIMES):
            await self._link.send(lambda cf: cf.commander.send_notify_setpoint_stop())
            await asyncio.sleep(RELAX_S)

    def state(self) -> RobotState:
        """The newest state that was logged."""
        log, now = self._log, time.monotonic()
        if not self._connected or log.position is None:
            raise RobotError(self.name, "was never connected")
        silent = self._link.silent_s(now) > self._link_timeout_s and not own_pauses().catching_up()
        self._lost = self._lost or silent or self._link.lost is not None
        return RobotState(
            position=log.position,
            stamp_s=log.stamp_s,
            battery_v=log.battery_v,
            link=0.0 if self._lost else self._link.quality,
            link_lost=self._lost,
            heard_s=self._link.heard_s,
            armed=bool(log.info & ARMED),
            flying=bool(log.info & FLYING),
            settled=log.settled(now),
            fault=fault_of(log.info),
            equipment=self._equipment,
        )

    @property
    def localisation(self) -> str | None:
        """A Lighthouse deck's report on its base stations; None from firmware that knows no Lighthouse."""
        return self._log.lighthouse

    async def take_pose(self, pose: Pose) -> None:
        """Send a pose from outside to the estimator; nothing confirms it."""
        if not self._connected:
            raise RobotError(self.name, self._link.why_closed)
        position, turn = pose.position, pose.quaternion
        if turn is None:
            await self._link.send(lambda cf: cf.extpos.send_extpos(*position))
        else:
            await self._link.send(lambda cf: cf.extpos.send_extpose(*position, *turn))

    async def close(self) -> None:
        """Close the link; a drone in the air hovers on until its battery is empty, or falls if it has a watchdog."""
        feeding, self._feeding = self._feeding, None
        if feeding is not None:
            feeding.cancel()
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
        """Arm the drone, and repeat until the supervisor confirms it; hand it to its high-level commander again."""
        end = time.monotonic() + ARM_S
        while not self._ready().armed:
            if time.monotonic() >= end:
                raise RobotError(self.name, f"does not arm; its supervisor says: {says(self._log.info)}")
            await self._link.send(lambda cf: cf.supervisor.send_arming_request(True))
            await self._until(lambda: self.state().armed, min(0.2, max(0.0, end - time.monotonic())))
        if not self._aloft and not self.state().flying:
            await self._relax()

    async def take_off(self, height_m: float, duration_s: float) -> Commanded:
        """Rise straight up to `height_m`, keeping the yaw."""
        start = self._ready().position
        if self._stop_watchdog and self._feeding is None:
            self._feeding = asyncio.create_task(self._feed())
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

    async def _feed(self) -> None:
        """Keep the emergency stop watchdog quiet, once it has begun."""
        while True:
            with contextlib.suppress(RobotError):
                await self._link.send(lambda cf: cf.supervisor.send_emergency_stop_watchdog())
            await asyncio.sleep(0.2)  # the watchdog wants one a second

    def _flies(self, start: Position, sent: Commanded) -> Commanded:
        now = time.monotonic()
        self._segment = Segment(start=start, target=sent.target, duration_s=sent.duration_s, began_s=now)
        self._set_point = sent.target
        return sent

    async def _go(self, target: Position, duration_s: float) -> None:
        x, y, z = target
        old = self._link.cf.platform.get_protocol_version() < 8  # which knows `GO_TO`
        number = GO_TO_OLD if old else GO_TO
        await self._command(number, lambda cf, left: cf.go_to(x, y, z, self._yaw, left), duration_s, "a way-point")

    async def _command(self, number: int, send: Callable[[Any, float], None], duration_s: float, what: str) -> None:
        """Send until the firmware answers, each time with the rest of the duration; raises RobotError."""
        began = time.monotonic()
        for attempt in range(ATTEMPTS):
            left = max(0.1, duration_s - (time.monotonic() - began))
            answer = await self._link.ask(number, lambda cf, left=left: send(cf.high_level_commander, left), ANSWER_S)
            if answer == 0:
                return
            # The first answer was lost: the drone is doing it already.
            if answer == REFUSED and (number == LAND or (number == TAKE_OFF and attempt)):
                return
            if answer is not None:
                supervisor = says(self._log.info)
                raise _Refused(self.name, f"refused {what} (answer {answer}); its supervisor says: {supervisor}")
        raise RobotError(self.name, f"did not confirm {what}, sent {ATTEMPTS} times")

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= end:
                return False
            await asyncio.sleep(0.005)
        return True
