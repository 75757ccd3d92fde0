"""An autopilot's own failsafes for a silent computer: judges its parameters before a flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from llm_flock.robots import DriverCheck
from llm_flock_flight._mavlink.codec import GROUND_STATION
from llm_flock_flight._mavlink.modes import Flavour

PX4_NAMES = ("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST")
ARDUPILOT_NAMES = (
    "FS_GCS_ENABLE",
    "FS_GCS_TIMEOUT",
    "SYSID_MYGCS|MAV_GCS_SYSID",
    "GUID_TIMEOUT",
    "FENCE_ENABLE",
    "FENCE_ACTION",
    "FENCE_RADIUS",
    "FENCE_ALT_MAX",
)

MAX_DELAY_S = 5.0
"""Longest silence of this computer after which an autopilot has to act [s]."""

LOSS_ACTIONS = ("Position mode", "Altitude mode", "Stabilized mode", "Return", "Land", "Hold", "Terminate", "Disarm")
"""Of PX4's COM_OBL_RC_ACT, by value."""

GCS_ACTIONS = (
    "nothing",
    "RTL",
    "RTL unless in a mission",
    "SmartRTL or RTL",
    "SmartRTL or Land",
    "Land",
    "the landing of the mission, or RTL",
    "Brake or Land",
)
"""Of ArduPilot's FS_GCS_ENABLE, by value."""


def names_for(flavour: Flavour) -> Sequence[str]:
    """Parameters to read; "A|B" where versions differ in the name."""
    return ARDUPILOT_NAMES if flavour.takes_off_by_command else PX4_NAMES


def judge(flavour: Flavour, values: Mapping[str, float]) -> tuple[DriverCheck, ...]:
    """The checks, by the parameters that the autopilot told; one that it did not tell is not judged."""
    if flavour.takes_off_by_command:
        return (_ground_station(values), _fence(values, "FENCE_ENABLE", "FENCE_RADIUS", "FENCE_ALT_MAX"))
    return (_stream(values), _fence(values, "GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"))


def _word(names: Sequence[str], value: float) -> str:
    return names[int(value)] if 0 <= value < len(names) else f"action {value:g}"


def _stream(values: Mapping[str, float]) -> DriverCheck:
    """PX4 leaves Offboard by itself when set-points stop."""
    name = "without set-points"
    after, action = values.get("COM_OF_LOSS_T"), values.get("COM_OBL_RC_ACT")
    if after is None or action is None:
        return DriverCheck(name=name, passed=True, found="not told")
    word = _word(LOSS_ACTIONS, action)
    found = f"{word} after {after:g} s" + (", which needs a pilot" if action < 3 else "")
    asked = f"COM_OBL_RC_ACT neither 6 nor 7, COM_OF_LOSS_T at most {MAX_DELAY_S:g} s; 4 lands it"
    return DriverCheck(name=name, passed=0 <= action < 6 and after <= MAX_DELAY_S, found=found, asked=asked)


def _ground_station(values: Mapping[str, float]) -> DriverCheck:
    """ArduPilot stays in Guided without set-points, and hovers: only its failsafe for heartbeats lands it."""
    name = "without heartbeats"
    action, after = values.get("FS_GCS_ENABLE"), values.get("FS_GCS_TIMEOUT", MAX_DELAY_S)
    if action is None:
        return DriverCheck(name=name, passed=True, found="not told")
    station = values.get("SYSID_MYGCS", values.get("MAV_GCS_SYSID", float(GROUND_STATION)))
    found = f"{_word(GCS_ACTIONS, action)} after {after:g} s without system {station:g}"
    asked = f"FS_GCS_ENABLE not 0, and SYSID_MYGCS (or MAV_GCS_SYSID) {GROUND_STATION}; 5 lands it"
    return DriverCheck(name=name, passed=action >= 1 and station == GROUND_STATION, found=found, asked=asked)


def _fence(values: Mapping[str, float], on: str, radius: str, height: str) -> DriverCheck:
    """Its own fence: told, not required, as the driver keeps the flight's own geofence."""
    if on not in values:
        return DriverCheck(name="its own fence", passed=True, found="not told")
    if not values[on]:
        return DriverCheck(name="its own fence", passed=True, found="off")
    limits = ", ".join(
        f"{values[key]:g} m {where}" for key, where in ((radius, "around"), (height, "up")) if values.get(key)
    )
    return DriverCheck(name="its own fence", passed=True, found=f"on{': ' if limits else ''}{limits}")
