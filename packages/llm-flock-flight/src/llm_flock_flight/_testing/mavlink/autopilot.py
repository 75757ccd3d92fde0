"""The mind of a stand-in autopilot: its modes, answers, failsafes and reports. Reads no clock and no socket."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from llm_flock.robots import Position
from llm_flock_flight._mavlink.codec import GROUND_STATION, Codec
from llm_flock_flight._mavlink.frames import Geodetic
from llm_flock_flight._mavlink.modes import ARDUPILOT, ARDUPILOT_FLAVOUR, PX4, PX4_FLAVOUR, px4
from llm_flock_flight._testing.mavlink.body import CLIMB_M_S, FAST_LANDING_M_S, LANDING_M_S, REST, Airframe

ACCEPTED, TEMPORARILY, DENIED, UNSUPPORTED, FAILED = range(5)  # answers to a command (MAV_RESULT)
GAP_S = 0.5  # PX4: set-points farther apart than this are no stream [s]

HEALTHY, ASTRAY = 0x1 | 0x2 | 0x4 | 0x8 | 0x20, 0x1 | 0x80
"""Reports of an estimator with a position, and of one that holds it constant for want of measurements."""

ARMED_S, SPOOL_S = 2.0, 2.0
"""A lifelike one's motors do nothing for this time after arming, and then gain speed for that [s]."""

RETURN_M, NEAR_M = 15.0, 0.3
"""Height above its home at which a vehicle returns, and a distance from it that counts as above it [m]."""

PILOTED = frozenset({0, 1, 2, 5, 11, 13, 14, 15, 16, 17, 18, 22, 24})
"""ArduPilot's modes in which a pilot flies: its failsafe for a silent ground station leaves them alone (FS_OPTIONS)."""

PERIODS_S = {0: 1.0, 1: 1.0, 30: 0.0, 32: 0.0, 193: 0.0, 230: 0.0, 245: 0.0}
"""Messages by number and their default periods [s]; 0 for never."""

PX4_PARAMETERS = {
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 4,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 50.0,
    "GF_MAX_VER_DIST": 0.0,
    "NAV_RCL_ACT": 3,
    "NAV_DLL_ACT": 0,
    "COM_LOW_BAT_ACT": 2,
}
ARDUPILOT_PARAMETERS = {
    "FS_GCS_ENABLE": 5.0,
    "FS_GCS_TIMEOUT": 3.0,
    "SYSID_MYGCS": 255.0,
    "GUID_TIMEOUT": 3.0,
    "FENCE_ENABLE": 0.0,
    "FENCE_ACTION": 1.0,
    "FENCE_TYPE": 3.0,
    "FENCE_MARGIN": 2.0,
    "FENCE_RADIUS": 300.0,
    "FENCE_ALT_MAX": 100.0,
    "FENCE_ALT_MIN": -10.0,
    "FS_THR_ENABLE": 3.0,
    "BATT_FS_LOW_ACT": 1.0,
    "BATT_FS_CRT_ACT": 1.0,
    "FS_EKF_ACTION": 1.0,
}


class Autopilot:
    """One stand-in autopilot, in the manner of `flavour`, "px4" or "ardupilot".

    Tests give `refuse` an answer and a text by command, and `deaf_to` the number of answers by command that are lost,
    after the command was done. It keeps the numbers of all `commands` and all `set_points` (north, east, down) [m] that
    came. A `lifelike` one takes off and climbs as late and as slowly as ArduCopter 4.7 in its own simulator.
    """

    def __init__(self, flavour: str, system_id: int, *, lifelike: bool = False) -> None:
        self.px4 = {"px4": True, "ardupilot": False}[flavour]
        self.flavour = PX4_FLAVOUR if self.px4 else ARDUPILOT_FLAVOUR
        self.kind, self.autopilot = 2, PX4 if self.px4 else ARDUPILOT  # a quadrotor
        self.mode = px4(4, 3) if self.px4 else 0
        self.body = Airframe(lifelike=lifelike)
        self.battery_v = 15.6
        self.healthy = True
        self.origin: Geodetic | None = None
        self.parameters: dict[str, float] = dict(PX4_PARAMETERS if self.px4 else ARDUPILOT_PARAMETERS)
        self.refuse: dict[int, tuple[int, str]] = {}
        self.deaf_to: dict[int, int] = {}
        self.commands: list[int] = []
        self.set_points: list[Position] = []
        self.offset: Position = REST
        self._codec = Codec(system_id, 1)
        self._system_id = system_id
        self._periods = dict(PERIODS_S)
        self._due: dict[int, float] = {}
        self._stream: tuple[float, float] | None = None  # since, until
        self._heard_s: float | None = None
        self._deserted = False
        self._climb_to: float | None = None
        self._landed_s: float | None = None
        self._ready_s = 0.0
        self._out: list[bytes] = []

    @property
    def armed(self) -> bool:
        return self.body.motors

    @property
    def on_ground(self) -> bool:
        """The state of its land detector."""
        return not self.body.lifted

    def switch(self, mode: int) -> None:
        """Change the mode, as a pilot does by radio."""
        self.mode, self._climb_to = mode, None

    def lose_radio(self) -> None:
        """Do as FS_THR_ENABLE or NAV_RCL_ACT says once the pilot's radio is silent."""
        action = int(self.parameters["NAV_RCL_ACT" if self.px4 else "FS_THR_ENABLE"])
        returns = action == (2 if self.px4 else 1)
        self.say("Failsafe activated: manual control lost" if self.px4 else "Radio Failsafe")
        self.switch(self.flavour.land if action == 3 else self._home_mode if returns else self.mode)

    def restart(self) -> None:
        """Reboot: the motors stop, and nothing that it was told is known any more."""
        self.body.motors, self.mode = False, px4(4, 3) if self.px4 else 0
        self._periods, self._stream, self._heard_s, self._climb_to = dict(PERIODS_S), None, None, None

    @property
    def _home_mode(self) -> int:
        return px4(4, 5) if self.px4 else 6

    def say(self, text: str) -> None:
        self._out.append(self._codec.encode("statustext", 4, text.encode()[:50]))

    def handle(self, message: Any, now: float) -> list[bytes]:
        """Take a message of a ground station; returns the answers."""
        kind = message.get_type()
        if int(getattr(message, "target_system", self._system_id)) not in (0, self._system_id):
            return []
        if kind == "HEARTBEAT" and int(message.get_srcSystem()) == GROUND_STATION:
            self._heard_s = now
        elif kind == "COMMAND_LONG":
            self._command(message, now)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._set_point(message, now)
        elif kind == "PARAM_REQUEST_READ":
            self._parameter(str(message.param_id))
        return self._sent()

    def tick(self, now: float) -> list[bytes]:
        """Let time pass; returns the messages that are due."""
        self._fly(now)
        self.body.advance(now)
        for number, period_s in self._periods.items():
            if period_s > 0.0 and now >= self._due.get(number, 0.0):
                self._due[number] = now + period_s
                self._report(number, now)
        return self._sent()

    def _sent(self) -> list[bytes]:
        out, self._out = self._out, []
        return out

    # Flying.

    def _fly(self, now: float) -> None:
        body = self.body
        self._failsafe(now)
        if not body.motors:
            self._landed_s = None
            return
        if self.mode == self.flavour.land:
            self._land(now)
        elif self.mode == self._home_mode:
            self._return(now)
        elif self.mode != self.flavour.guided:
            body.target = body.target if body.feed_forward == REST and body.target else body.ned
            body.feed_forward = REST
        elif self._climb_to is not None and now >= self._ready_s:
            body.lifted, body.feed_forward = True, (0.0, 0.0, -CLIMB_M_S / 2)
            body.target = (body.ned[0], body.ned[1], max(-self._climb_to, body.ned[2] - 0.15))
            if body.height_m >= 0.95 * self._climb_to:
                self._climb_to, body.feed_forward = None, REST

    def _return(self, now: float) -> None:
        """Rise, fly home without regard to other vehicles, and land there."""
        body = self.body
        (north, east, _), body.feed_forward = body.ned, REST
        if math.hypot(north, east) <= NEAR_M:
            self._land(now)
        elif body.height_m < RETURN_M - NEAR_M:
            body.target = (north, east, max(-RETURN_M, -body.height_m - 0.5))  # at 1.5 m/s: it brakes late
        else:
            body.target = (0.0, 0.0, -RETURN_M)

    def _failsafe(self, now: float) -> None:
        if self.px4:
            if self.mode != self.flavour.guided:
                return
            until = self._stream[1] if self._stream is not None else now
            if now - until > self.parameters["COM_OF_LOSS_T"]:
                self.say("Failsafe activated: no offboard signal")
                self.switch({4: self.flavour.land, 5: px4(4, 3)}.get(int(self.parameters["COM_OBL_RC_ACT"]), px4(3)))
            return
        silent = self._heard_s is not None and now - self._heard_s > self.parameters.get("FS_GCS_TIMEOUT", 5.0)
        if silent != self._deserted:
            self._deserted = silent
            left = " - Continuing Pilot Control" if self.mode in PILOTED else ""
            self.say(f"GCS Failsafe{left}" if silent else "GCS Failsafe Cleared")
            if silent and not left and self.body.motors and self.parameters.get("FS_GCS_ENABLE") == 5.0:
                self.switch(self.flavour.land)
        elif self._stream is not None and now - self._stream[1] > 3.0:
            self.body.feed_forward = REST  # GUID_TIMEOUT: it stays at its last set-point

    def _land(self, now: float) -> None:
        body = self.body
        speed = FAST_LANDING_M_S if body.lifelike else LANDING_M_S
        if body.lifted and body.height_m > 0.01:
            body.target, body.feed_forward = (body.ned[0], body.ned[1], body.ned[2]), (0.0, 0.0, speed)
            return
        body.lifted, body.target, body.feed_forward = False, None, REST
        self._landed_s = self._landed_s or now
        if now - self._landed_s > 2.0:  # COM_DISARM_LAND, DISARM_DELAY
            body.motors = False

    def _set_point(self, message: Any, now: float) -> None:
        ned = (float(message.x), float(message.y), float(message.z))
        self.set_points.append(ned)
        since, until = self._stream or (now, now)
        self._stream = (since if now - until <= GAP_S else now, now)
        body = self.body
        if self.mode != self.flavour.guided or not body.motors or self._climb_to is not None or self._fenced_off(ned):
            return
        if not body.lifted:
            if not self.px4 or ned[2] > body.ned[2] - 1e-4 or now < self._ready_s:
                return  # PX4 lifts off for a set-point above it; ArduPilot only by command
            body.lifted = True
        body.target = ned
        body.feed_forward = (float(message.vx), float(message.vy), float(message.vz))

    def _fenced_off(self, ned: Position) -> bool:
        """Whether ArduPilot drops a set-point, without an answer."""
        fence = self.parameters
        if self.px4 or not fence.get("FENCE_ENABLE"):
            return False
        kinds = int(fence["FENCE_TYPE"])
        far = bool(kinds & 2) and math.hypot(ned[0], ned[1]) > fence["FENCE_RADIUS"]
        return far or (bool(kinds & 1) and -ned[2] > fence["FENCE_ALT_MAX"])

    # Answering.

    def _command(self, message: Any, now: float) -> None:
        number = int(message.command)
        self.commands.append(number)
        parameters = [float(getattr(message, f"param{k}")) for k in range(1, 8)]
        if number in self.refuse:
            result, text = self.refuse[number]
            if text:
                self.say(text)
        else:
            doer = self._doers().get(number)
            result = UNSUPPORTED if doer is None else doer(parameters, now)
        if self.deaf_to.get(number, 0) > 0:
            self.deaf_to[number] -= 1
            return
        self._out.append(self._codec.encode("command_ack", number, result))

    def _doers(self) -> dict[int, Callable[[list[float], float], int]]:
        doers: dict[int, Callable[[list[float], float], int]] = {
            176: self._do_mode,
            400: self._do_arm,
            511: self._do_interval,
            512: self._do_request,
        }
        if not self.px4:
            doers |= {22: self._do_take_off, 185: self._do_terminate}
        return doers

    def _do_mode(self, parameters: list[float], now: float) -> int:
        mode = px4(int(parameters[1]), int(parameters[2])) if self.px4 else int(parameters[1])
        if mode not in self.flavour.names:
            return DENIED
        if self.px4 and mode == self.flavour.guided:
            since, until = self._stream or (now, now)
            if until - since < 0.8 or now - until > GAP_S:  # a stream has to last
                self.say("Switching to mode 'Offboard' is currently not possible")
                return TEMPORARILY
        self.switch(mode)
        return ACCEPTED

    def _do_arm(self, parameters: list[float], now: float) -> int:
        wanted, forced = parameters[0] > 0.5, parameters[1] == 21196.0
        refused = TEMPORARILY if self.px4 else FAILED
        if wanted and not self.healthy and not forced:
            self.say("Preflight Fail: ekf2 missing data" if self.px4 else "PreArm: Need Position Estimate")
            return refused
        if not wanted and not self.on_ground and not forced:
            self.say("Disarming denied: not landed")
            return refused
        if wanted and not self.body.motors and self.body.lifelike:
            self._ready_s = now + ARMED_S + SPOOL_S
        self.body.motors = wanted
        return ACCEPTED

    def _do_take_off(self, parameters: list[float], _now: float) -> int:
        if self.mode != self.flavour.guided or not self.body.motors or self.body.lifted:
            return FAILED
        self._climb_to = parameters[6]
        return ACCEPTED

    def _do_terminate(self, _parameters: list[float], _now: float) -> int:
        self.body.motors = False
        return ACCEPTED

    def _do_interval(self, parameters: list[float], _now: float) -> int:
        number = int(parameters[0])
        if number not in self._periods or number == (193 if self.px4 else 230):
            self.say(f"No ap_message for mavlink id ({number})")  # as ArduPilot answers
            return DENIED
        if number == 0 and not self.px4:
            return DENIED  # ArduPilot's heartbeat stays at 1 Hz
        self._periods[number] = parameters[1] / 1e6
        return ACCEPTED

    def _do_request(self, parameters: list[float], now: float) -> int:
        if int(parameters[0]) == 0:
            self._report(0, now)
            return ACCEPTED
        if int(parameters[0]) != 49 or self.origin is None:
            return FAILED
        place = self.origin
        latitude, longitude = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
        self._out.append(self._codec.encode("gps_global_origin", latitude, longitude, round(place.altitude_m * 1e3)))
        return ACCEPTED

    def _parameter(self, name: str) -> None:
        value = self.parameters.get(name)
        if value is None:
            return
        kind = 9  # MAV_PARAM_TYPE_REAL32
        if self.px4 and isinstance(value, int):
            kind, value = 6, struct.unpack("<f", struct.pack("<i", value))[0]
        self._out.append(self._codec.encode("param_value", name.encode(), float(value), kind, len(self.parameters), 0))

    def _report(self, number: int, now: float) -> None:
        ms = int(now * 1000) & 0xFFFF_FFFF
        encode, body = self._codec.encode, self.body
        if number == 0:
            self._out.append(encode("heartbeat", self.kind, self.autopilot, 0x81 if self.armed else 0x01, self.mode, 4))
        elif number == 1:
            self._out.append(encode("sys_status", 0, 0, 0, 0, round(1000 * self.battery_v), -1, -1, 0, 0, 0, 0, 0, 0))
        elif number == 30:
            self._out.append(encode("attitude", ms, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
        elif number == 32 and self.healthy:
            ned = [p + o for p, o in zip(body.ned, self.offset, strict=True)]
            self._out.append(encode("local_position_ned", ms, *ned, *body.velocity))
        elif number == 193:
            self._out.append(encode("ekf_status_report", HEALTHY if self.healthy else ASTRAY, *(0.1,) * 5))
        elif number == 230:
            flags = HEALTHY if self.healthy else ASTRAY
            self._out.append(encode("estimator_status", ms * 1000, flags, *(0.1,) * 8))
        elif number == 245:
            self._out.append(encode("extended_sys_state", 0, 1 if self.on_ground else 2))
