"""Logs of a Crazyflie: the variables, the newest values, and the state of its supervisor."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType

from llm_flock.robots import Position

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

NEEDED = frozenset({"stateEstimate.x", "stateEstimate.y", "stateEstimate.z", "supervisor.info"})
"""Those without which no flight is possible. The rest is watched where the firmware logs it."""

UNWATCHED: Mapping[str, str] = MappingProxyType({"pm.vbat": "its battery", "kalman.varPX": "its estimator's variance"})
"""The measurement that is lost if a variable is missing."""

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


def fault_of(info: int) -> str | None:
    """The reason why a drone cannot fly; None if it can."""
    wrong = [name for bit, name in _NAMES.items() if info & bit & (TUMBLED | LOCKED | CRASHED)]
    if not wrong and not info & (CAN_ARM | ARMED):
        wrong = ["cannot be armed: its self-test or its sensors' calibration is not passed"]
    return ", ".join(wrong) or None


def says(info: int) -> str:
    """The supervisor's state as text."""
    return ", ".join(name for bit, name in _NAMES.items() if info & bit) or "not ready"


LIGHTHOUSE_LOG: Mapping[str, str] = MappingProxyType(
    {"lighthouse.status": "uint8_t", "lighthouse.bsReceive": "uint16_t", "lighthouse.bsActive": "uint16_t"}
)
"""Variables of the log block of a Lighthouse deck (`lighthouse_core.c` of the firmware): a status, and two bit fields
with one bit for each base station. Firmware built without Lighthouse does not have them."""

LIGHTHOUSE_PERIOD_MS = 500

STATUS = (
    "no base station is received; not checked: others may give positions",
    "geometry or calibration is missing",
    "in use",
)
"""What each value of `lighthouse.status` means."""


class Telemetry:
    """The newest values that were logged. Written by one thread, read by any."""

    def __init__(self) -> None:
        self.position: Position | None = None
        self.stamp_s = 0.0
        self.yaw_deg = 0.0
        self.battery_v: float | None = None
        self.info = 0
        self.lighthouse: str | None = None
        self._variances: deque[tuple[float, float, float]] = deque(maxlen=SETTLED_SAMPLES)
        self._variance_stamp_s = 0.0
        self.without_variance = False

    def take_position(self, data: Mapping[str, float], now: float) -> None:
        """Take a packet of `POSITION_LOG` that arrived at `now`. An estimate that is no number is none: it ages."""
        volts = float(data.get("pm.vbat", math.nan))
        self.battery_v = volts if math.isfinite(volts) else None
        self.info = int(data["supervisor.info"])
        self.yaw_deg = float(data.get("stateEstimate.yaw", 0.0))
        position = (float(data["stateEstimate.x"]), float(data["stateEstimate.y"]), float(data["stateEstimate.z"]))
        if all(map(math.isfinite, position)):
            self.position, self.stamp_s = position, now

    def take_variance(self, data: Mapping[str, float], now: float) -> None:
        """Take a packet of `VARIANCE_LOG` that arrived at `now`."""
        self._variances.append((data["kalman.varPX"], data["kalman.varPY"], data["kalman.varPZ"]))
        self._variance_stamp_s = now

    def take_lighthouse(self, data: Mapping[str, float], now: float) -> None:
        self.lighthouse = lighthouse_text(data)

    def settled(self, now: float) -> bool:
        """Whether the estimator has converged, by recent samples; True where the firmware does not log its variance."""
        if self.without_variance:
            return True
        samples = list(self._variances)
        if len(samples) < SETTLED_SAMPLES or now - self._variance_stamp_s > SETTLED_SAMPLES * VARIANCE_PERIOD_MS / 1e3:
            return False
        return all(max(axis) - min(axis) < SETTLED_RANGE for axis in zip(*samples, strict=True))


def lighthouse_text(values: Mapping[str, float]) -> str:
    """The state of the Lighthouse as text, by a packet of `LIGHTHOUSE_LOG`."""
    status = int(values["lighthouse.status"])
    if status == 0:
        return f"Lighthouse: {STATUS[0]}"
    received, active = (_stations(int(values[f"lighthouse.{name}"])) for name in ("bsReceive", "bsActive"))
    state = STATUS[status] if status < len(STATUS) else f"status {status}"
    return f"Lighthouse: {state}; receives {received}, uses {active}"


def _stations(bits: int) -> str:
    """Base stations by their channels, which count from 1."""
    return ", ".join(str(k + 1) for k in range(16) if bits >> k & 1) or "none"
