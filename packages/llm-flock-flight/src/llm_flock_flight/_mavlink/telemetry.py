"""The newest values that an autopilot sent. Takes any message, and drops impossible values."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from llm_flock.robots import Position
from llm_flock_flight._mavlink.codec import parameter_value, text_of
from llm_flock_flight._mavlink.frames import Geodetic
from llm_flock_flight._mavlink.modes import COPTERS, FLAVOURS, Flavour

FARTHEST_M = 100_000.0  # a position farther from the autopilot's origin is none [m]
FASTEST_M_S = 100.0  # a speed above this is none [m/s]
ARMED = 0x80  # bit of a heartbeat's `base_mode` (MAV_MODE_FLAG_SAFETY_ARMED)
NEEDED = 0x01 | 0x02 | 0x20  # bits of an estimator's report that must be set: attitude, horizontal velocity, height
PLACES = 0x08 | 0x10  # bits of which one must be set: horizontal position, relative or absolute
FORBIDDEN = 0x80 | 0x800  # bits that must not be set: position held constant, bad accelerometers
REPORT_S = 3.0  # oldest report of an estimator that counts [s]
WARNING = 4  # least urgent severity that explains something (MAV_SEVERITY)
SAMPLES = 100  # packets by which the share that got through is judged


class VehicleTelemetry:
    """The last values of one autopilot. All times are those of arrival on `time.monotonic` [s].

    `refusal` says why it cannot be driven; `ned` is (north, east, down) [m], `climb` the speed upwards [m/s]; `yaw` is
    clockwise from north [rad].
    Heartbeats tell mode and arming from `certain_s` on: until then a confirmed command counts.
    """

    def __init__(self) -> None:
        self.flavour: Flavour | None = None
        self.refusal: str | None = None
        self.ned: Position | None = None
        self.ned_s = 0.0
        self.climb = 0.0
        self.heard_s = 0.0
        self.heartbeat_s = 0.0
        self.mode = -1
        self.armed = False
        self.on_ground: bool | None = None
        self.battery_v: float | None = None
        self.yaw: float | None = None
        self.gps_origin: Geodetic | None = None
        self.parameters: dict[str, float] = {}
        self.certain_s = 0.0
        self._flags: tuple[int, float] | None = None
        self._texts: deque[tuple[float, str]] = deque(maxlen=5)
        self._last_seq: int | None = None
        self._arrivals: deque[int] = deque(maxlen=SAMPLES)
        self._takers: Mapping[str, Callable[[Any, float], None]] = {
            "HEARTBEAT": self._heartbeat,
            "LOCAL_POSITION_NED": self._position,
            "ATTITUDE": self._attitude,
            "SYS_STATUS": self._battery,
            "EXTENDED_SYS_STATE": self._landed,
            "ESTIMATOR_STATUS": self._estimator,
            "EKF_STATUS_REPORT": self._estimator,
            "GPS_GLOBAL_ORIGIN": self._origin,
            "STATUSTEXT": self._text,
            "PARAM_VALUE": self._parameter,
        }

    def take(self, message: Any, now: float) -> None:
        """Take any message of the autopilot."""
        self.heard_s = now
        self._count(int(message.get_seq()))
        taker = self._takers.get(message.get_type())
        if taker is not None:
            taker(message, now)

    def confirm(self, now: float, *, mode: int | None = None, armed: bool | None = None) -> None:
        """Note what the autopilot has just confirmed, ahead of its next heartbeat."""
        self.certain_s = now + 0.3  # heartbeats before were under way already
        self.mode = self.mode if mode is None else mode
        self.armed = self.armed if armed is None else armed

    @property
    def link(self) -> float | None:
        """Share of the autopilot's packets that arrived, by their numbers; None before there are some."""
        if len(self._arrivals) < 10:
            return None
        return len(self._arrivals) / (len(self._arrivals) + sum(self._arrivals))

    @property
    def reported(self) -> bool:
        """Whether its estimator has ever reported."""
        return self._flags is not None

    def settled(self, now: float) -> bool:
        """Whether the estimator reports a position, by its last report."""
        if self._flags is None or now - self._flags[1] > REPORT_S:
            return False
        flags = self._flags[0]
        return flags & NEEDED == NEEDED and bool(flags & PLACES) and not flags & FORBIDDEN

    def says(self, now: float) -> str:
        """The autopilot's last warnings, as an end of a sentence; empty without."""
        texts = dict.fromkeys(text for stamp, text in self._texts if now - stamp <= 3.0)
        return f" ({'; '.join(texts)})" if texts else ""

    def _count(self, seq: int) -> None:
        if self._last_seq is not None:
            missing = (seq - self._last_seq - 1) % 256
            self._arrivals.append(missing if missing < 128 else 0)
        self._last_seq = seq

    def _heartbeat(self, message: Any, now: float) -> None:
        flavour, kind = FLAVOURS.get(int(message.autopilot)), int(message.type)
        if self.flavour is not None and (flavour is not self.flavour or kind not in COPTERS):
            return  # an autopilot does not become another one
        self.heartbeat_s = now
        if flavour is None:
            self.refusal = f"its autopilot is neither PX4 nor ArduPilot (MAV_AUTOPILOT {int(message.autopilot)})"
            return
        if kind not in COPTERS:
            self.refusal = f"it is no copter (MAV_TYPE {kind})"
            return
        self.flavour, self.refusal = flavour, None
        if now >= self.certain_s:
            self.mode = int(message.custom_mode)
            self.armed = bool(int(message.base_mode) & ARMED)

    def _position(self, message: Any, now: float) -> None:
        ned = (float(message.x), float(message.y), float(message.z))
        if all(math.isfinite(v) and abs(v) < FARTHEST_M for v in ned):
            self.ned, self.ned_s = ned, now
            climb = -float(message.vz)
            self.climb = climb if abs(climb) < FASTEST_M_S else 0.0

    def _attitude(self, message: Any, _now: float) -> None:
        yaw = float(message.yaw)
        if math.isfinite(yaw) and abs(yaw) < 10.0:
            self.yaw = yaw

    def _battery(self, message: Any, _now: float) -> None:
        millivolts = int(message.voltage_battery)
        self.battery_v = millivolts / 1000.0 if 0 < millivolts < 65_535 else None

    def _landed(self, message: Any, _now: float) -> None:
        state = int(message.landed_state)
        self.on_ground = None if state == 0 else state == 1  # MAV_LANDED_STATE_ON_GROUND

    def _estimator(self, message: Any, now: float) -> None:
        self._flags = (int(message.flags), now)

    def _origin(self, message: Any, _now: float) -> None:
        latitude, longitude = message.latitude / 1e7, message.longitude / 1e7
        if (latitude, longitude) == (0.0, 0.0) or abs(latitude) > 85.0 or abs(longitude) > 180.0:
            return
        altitude = message.altitude / 1e3
        self.gps_origin = Geodetic(latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude)

    def _text(self, message: Any, now: float) -> None:
        text = text_of(message.text)
        if int(message.severity) <= WARNING and text:
            self._texts.append((now, text))

    def _parameter(self, message: Any, _now: float) -> None:
        name = text_of(message.param_id)
        if self.flavour is None or len(self.parameters) > 1000:
            return
        value = parameter_value(message, self.flavour.integers_as_bits)
        if math.isfinite(value):
            self.parameters[name] = value
