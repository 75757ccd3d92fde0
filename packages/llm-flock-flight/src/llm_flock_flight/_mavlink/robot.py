"""A copter with PX4 or ArduPilot, with the interface of `llm_flock.robots._base`."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Coroutine
from typing import Any

from llm_flock.errors import InputError
from llm_flock.robots import (
    HOLD_S,
    PEAK_SPEED,
    Commanded,
    DriverCheck,
    MotionLimits,
    Position,
    RobotError,
    RobotState,
    Segment,
    TakenOver,
    stopping_point,
)
from llm_flock_flight._mavlink import orders
from llm_flock_flight._mavlink.autopilot_checks import judge, names_for
from llm_flock_flight._mavlink.connecting import introduce, refuse_a_second
from llm_flock_flight._mavlink.conversation import CommandRefused, Conversation
from llm_flock_flight._mavlink.frames import Geodetic, LocalFrame
from llm_flock_flight._mavlink.modes import Flavour
from llm_flock_flight._mavlink.port import Ports
from llm_flock_flight._mavlink.stream import SetPointStream
from llm_flock_flight._mavlink.telemetry import VehicleTelemetry
from llm_flock_flight._pauses import own_pauses

BELOW_M = 0.3  # until take-off, set-points are this far below the ground: PX4 would lift off for one above it [m]

LIFT_M = 0.3
"""It lifts off to this height above the ground, ArduPilot by a command of its own; then it follows set-points [m]."""

CLIMB_M_S2, PEAK_ACCELERATION = 0.5, 7.52
"""Highest vertical acceleration of a set-point after take-off, half of what ArduCopter's own controllers give by
default, and that of a segment from rest to rest, as a multiple of its length over its squared duration [m/s^2]."""

LIFT_S = 10.0
TOUCH_DOWN_S = 30.0
"""Longest wait for a lift-off by command, and for a touch-down after which the motors can be stopped [s]."""

AGAIN_S = 0.3  # time between two tries to disarm on the ground [s]

logger = logging.getLogger(__name__)


class MavlinkRobot:
    """One copter. The driver streams set-points along each segment; every command is confirmed by the autopilot.

    A change of mode that the driver did not ask for is a pilot's, or a failsafe's: the driver stops its stream, and
    sends nothing but an emergency stop until `connect`. With `origin`, the place of the world's zero on the Earth, it
    asks for that of the autopilot's own zero instead of using `frame`. Robots with the same URI share a socket of
    `ports`.
    """

    def __init__(
        self,
        name: str,
        uri: str,
        *,
        ports: Ports | None = None,
        system_id: int = 1,
        frame: LocalFrame | None = None,
        origin: Geodetic | None = None,
        limits: MotionLimits | None = None,
        link_timeout_s: float = 2.0,
        heartbeat_timeout_s: float = 5.0,
    ) -> None:
        if not 1 <= system_id <= 254:
            raise InputError("system_id", system_id, "a number from 1 to 254")
        self.name = name
        self.uri = uri
        self.system_id = system_id
        self._port = (Ports() if ports is None else ports)[uri]
        self._frame = frame or LocalFrame()
        self._origin = origin
        self._limits = limits or MotionLimits()
        self._link_timeout_s = link_timeout_s
        self._heartbeat_timeout_s = heartbeat_timeout_s
        self._talk = Conversation(name, self._port, system_id)
        self._stream: SetPointStream | None = None
        self._work: asyncio.Task[None] | None = None
        self._connected = self._lost = self._aloft = self._cut = False
        self._in_charge = self._landing = self._waiting = False

    @property
    def _log(self) -> VehicleTelemetry:
        return self._talk.telemetry

    @property
    def _taken(self) -> str | None:
        return self._talk.taken

    @property
    def _flavour(self) -> Flavour:
        assert self._log.flavour is not None, "known since connect"
        return self._log.flavour

    async def connect(self, timeout_s: float) -> None:
        """Open the link, and wait for the first estimate, or raise RobotError; reopens a lost link, also in flight."""
        end = time.monotonic() + timeout_s
        own_pauses()  # watches them from now on
        await self.close()
        talk = Conversation(self.name, self._port, self.system_id)
        log = talk.telemetry
        try:
            async with asyncio.timeout(timeout_s):
                await self._port.attach(self.system_id, lambda message: self._on_message(talk, message))
        except OSError as error:  # a TimeoutError is one as well
            raise RobotError(self.name, f"{self.uri} cannot be opened: {error.strerror or error}") from None
        try:
            frame = await introduce(talk, self._port, self.system_id, self._frame, self._origin, timeout_s)
            if log.flavour is not None and not log.armed:
                await talk.parameters(names_for(log.flavour), min(1.0, max(0.0, end - time.monotonic())))
        except BaseException:
            self._port.detach(self.system_id)
            raise
        self._talk, self._frame = talk, frame
        self._cut, self._lost, self._connected = False, False, True
        self._aloft = log.armed and log.on_ground is not True
        self._stream = SetPointStream(talk, self.system_id, frame, self._limits, self._may_stream, log.yaw)

    def checks(self) -> tuple[DriverCheck, ...]:
        """Checks of the autopilot's failsafes, and of its own fence."""
        if not self._connected:
            return ()
        return judge(self._flavour, self._log.parameters, self.state().position, self._limits)

    def state(self) -> RobotState:
        """The newest state that the autopilot sent."""
        log = self._log
        if not self._connected or log.ned is None:
            raise RobotError(self.name, "was never connected")
        lost = self._look_for_loss()
        return RobotState(
            position=self._frame.to_world(log.ned),
            stamp_s=log.ned_s,
            battery_v=log.battery_v,
            link=0.0 if lost else log.link,
            link_lost=lost,
            armed=log.armed,
            flying=log.armed and (self._aloft or log.on_ground is not True),
            settled=log.settled(time.monotonic()),
            taken_over=self._taken,
        )

    async def close(self) -> None:
        """Close the link. Set-points stop: PX4 in the air then does what COM_OBL_RC_ACT says."""
        self._end_work()
        self._stop_stream()
        self._in_charge = self._landing = False
        if self._port.attached(self.system_id):
            self._port.detach(self.system_id)

    async def arm(self) -> None:
        """Take over the mode for set-points, and arm; returns once the autopilot has confirmed both."""
        self._ready()
        if self._cut:
            raise RobotError(self.name, "its motors were cut: connect again")
        refuse_a_second(self._talk, self._port, self.system_id)
        log, flavour, stream = self._log, self._flavour, self._need_stream()
        if log.armed and self._in_charge:
            return
        orders.refuse_armed(self._talk, flavour)
        try:
            if flavour.needs_stream:
                x, y, z = self.state().position
                below = (x, y, z - BELOW_M)
                self._waiting = True
                stream.follow(Segment(start=below, target=below, duration_s=1.0), clamp=False)
                stream.yaw = log.yaw
                await asyncio.sleep(1.0)  # as PX4's documentation requires before Offboard
            await orders.refuse_armed_lately(self._talk, flavour)
            await orders.set_mode(self._talk, flavour, flavour.guided)
            self._in_charge = True
            await orders.arm(self._talk)
        except BaseException:
            stream.stop()
            if self._in_charge and self._taken is None:
                orders.withdraw_arming(self._talk)
            self._in_charge = False
            raise

    async def take_off(self, height_m: float, duration_s: float) -> Commanded:
        """Rise straight up to `height_m`: the time counts from when it is seen to lift; `reference` is None until then.

        It is extended where set-points would be too fast or accelerate too much.
        """
        start = self._ready().position
        stream = self._need_stream()
        if not self._in_charge or not self._log.armed:
            raise RobotError(self.name, "refused take-off: it is not armed")
        sent = self._limits.clip(start, (start[0], start[1], height_m), duration_s)
        before, self._aloft = self._aloft, True
        lift = max(0.1, min(LIFT_M, sent.target[2] - start[2]))
        if self._flavour.takes_off_by_command:
            try:
                await orders.lift_off(self._talk, lift)
            except CommandRefused:
                self._aloft = before
                raise
            stream.stop()
        else:
            x, y, z = start
            stream.follow(Segment(start=(x, y, z + lift), target=(x, y, z + lift), duration_s=1.0))
        self._begin(self._rise(start, lift, sent))
        return sent

    @property
    def reference(self) -> Segment | None:
        """The trajectory of the set-points that are sent; None before it is seen to lift."""
        return None if self._stream is None or self._waiting else self._stream.segment

    async def go_to(self, target: Position, duration_s: float) -> Commanded:
        """Fly the straight segment from the last set-point."""
        state = self._ready()
        if not state.flying:
            raise RobotError(self.name, "is not in the air")
        self._need_guided("a way-point")
        segment = self._need_stream().segment
        sent = self._limits.clip(segment.target if segment else state.position, target, duration_s)
        self._follow(sent.target, duration_s, state.position)
        return sent

    async def hold(self) -> None:
        state = self._ready()
        if not state.flying:
            return
        self._need_guided("a stop")
        segment = self._need_stream().segment
        stop: Position | None = state.position
        if segment is not None:
            stop = stopping_point(segment, time.monotonic(), HOLD_S)
        if stop is not None:
            self._follow(stop, HOLD_S, state.position)

    async def land(self, height_m: float, duration_s: float) -> None:
        """Land straight down: by set-points to `height_m`, then by the autopilot's own mode, which finds the ground.

        Where its stream of set-points broke off, or its estimate has jumped away from them, its own mode lands it.
        """
        if not self._connected or not self._port.attached(self.system_id):
            raise RobotError(self.name, "is not connected")
        state = self.state()
        if not state.flying:
            return
        flavour, mode = self._flavour, self._log.mode
        if mode == flavour.land and not state.link_lost:
            if self._taken is None:
                self._begin(self._touch_down(True))
            return
        self._ready()
        if mode == flavour.guided and self._stream is not None and self._stream.leads(state.position):
            x, y, z = self._stream.segment.target if self._stream.segment else state.position
            self._landing = True
            self._follow((x, y, height_m), duration_s, (x, y, z), clamp=False)
            self._begin(self._touch_down(False, duration_s))
            return
        if mode not in {flavour.guided, *flavour.holds}:
            raise TakenOver(self.name, f"its mode is {flavour.name_of(mode)}: a pilot or a failsafe flies it")
        self._landing = self._in_charge = True
        await orders.set_mode(self._talk, flavour, flavour.land)
        self._stop_stream()
        self._begin(self._touch_down(True))

    async def stop_motors(self) -> bool:
        """Emergency stop: disarm by force, and if that is refused terminate the flight; tried even with a lost link."""
        if not self._port.attached(self.system_id):
            return False
        self._end_work()
        self._stop_stream()
        self._in_charge = self._landing = False
        if not await orders.cut(self._talk):
            return False
        self._aloft, self._cut = False, True
        return True

    # What follows is between the commands.

    def _on_message(self, talk: Conversation, message: Any) -> None:
        """Take a message, and see whether the autopilot still obeys."""
        talk.take(message)
        log = talk.telemetry
        if message.get_type() != "HEARTBEAT" or talk is not self._talk:
            return
        if not log.armed:
            if self._aloft:
                if self._in_charge and not self._landing:
                    talk.taken = f"its motors were stopped, and not by this program{log.says(time.monotonic())}"
                self._aloft = self._in_charge = self._landing = False
                self._stop_stream()
            return
        obeying = {self._flavour.guided, self._flavour.land} if self._landing else {self._flavour.guided}
        if self._in_charge and log.mode not in obeying:
            now = self._flavour.name_of(log.mode)
            talk.taken = (
                f"its mode is {now}, not {self._flavour.name_of(self._flavour.guided)}: a pilot or a failsafe flies "
                f"it{log.says(time.monotonic())}"
            )
            self._in_charge = self._landing = False
            self._end_work()
            self._stop_stream()

    def _stop_stream(self) -> None:
        if self._stream is not None:
            self._stream.stop()

    def _may_stream(self) -> bool:
        return self._taken is None and not self._look_for_loss()

    def _look_for_loss(self) -> bool:
        now, log = time.monotonic(), self._log
        silent = now - log.heard_s > self._link_timeout_s or now - log.heartbeat_s > self._heartbeat_timeout_s
        self._lost = self._lost or (silent and not own_pauses().catching_up())
        return self._lost

    def _ready(self) -> RobotState:
        """The state; raises RobotError if commands are of no use."""
        if not self._connected or not self._port.attached(self.system_id):
            raise RobotError(self.name, "is not connected")
        if self._taken is not None:  # also behind a lost link: a new one would know nothing of the pilot
            raise TakenOver(self.name, self._taken)
        state = self.state()
        if state.link_lost:
            raise RobotError(self.name, "the link is lost: nothing comes any more")
        return state

    def _need_stream(self) -> SetPointStream:
        assert self._stream is not None, "made by connect"
        return self._stream

    def _need_guided(self, what: str) -> None:
        """A vehicle that was reached in flight is flown on only if it waits for set-points."""
        if self._log.mode != self._flavour.guided:
            mode = self._flavour.name_of(self._log.mode)
            raise RobotError(self.name, f"refused {what}: its mode is {mode}, and it can only be landed")
        self._in_charge, self._landing = True, False

    def _follow(
        self, target: Position, duration_s: float, start: Position, *, clamp: bool = True, climb: float = 0.0
    ) -> None:
        """Stream a segment to the target, from the set-point of the moment or else from `start`, climbing already."""
        stream, now = self._need_stream(), time.monotonic()
        rest: Position = (0.0, 0.0, 0.0)
        at, v, a = (
            (start, (0.0, 0.0, climb), rest) if stream.segment is None or self._waiting else stream.segment.at(now)
        )
        self._waiting = False
        self._end_work()
        segment = Segment(start=at, target=target, duration_s=duration_s, began_s=now, velocity=v, acceleration=a)
        stream.follow(segment, clamp=clamp)

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        self._end_work()
        self._work = asyncio.create_task(work)

    def _end_work(self) -> None:
        work, self._work = self._work, None
        if work is not None and work is not asyncio.current_task():
            work.cancel()

    async def _rise(self, start: Position, lift: float, sent: Commanded) -> None:
        """Follow set-points to the top as soon as the vehicle is seen to have lifted off, from where it is then."""
        high = start[2] + 0.8 * lift
        if not await self._talk.until(lambda: self.state().position[2] >= high, LIFT_S):
            logger.warning("%s: did not lift off within %g s%s", self.name, LIFT_S, self._log.says(time.monotonic()))
            return
        here = self.state().position
        way = abs(sent.target[2] - here[2])
        fast_s, steep_s = PEAK_SPEED * way / self._limits.max_speed_m_s, math.sqrt(PEAK_ACCELERATION * way / CLIMB_M_S2)
        self._follow(sent.target, max(sent.duration_s, fast_s, steep_s), here, climb=self._log.climb)

    async def _touch_down(self, landing: bool, after_s: float = 0.0) -> None:
        """Let the autopilot land and stop the motors; `landing` if its own mode does so already."""
        await asyncio.sleep(after_s)
        log = self._log
        end = time.monotonic() + TOUCH_DOWN_S
        while time.monotonic() < end and log.armed and self._taken is None:
            try:
                if not landing:
                    await orders.set_mode(self._talk, self._flavour, self._flavour.land)
                    landing = True
                    self._stop_stream()
                if log.on_ground is not False:
                    await orders.disarm(self._talk)
                    self._aloft = self._in_charge = self._landing = False
                    self._stop_stream()
                    return
            except RobotError as error:
                logger.debug("%s", error)
            await asyncio.sleep(AGAIN_S)
