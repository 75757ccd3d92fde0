"""An autopilot's own failsafes and its own fence: judges its parameters before a flight.

Parameters and their values: ArduCopter's Parameters.cpp, events.cpp, AP_BattMonitor_Params.cpp and AC_Fence.cpp (4.3 to
4.7); PX4's commander and navigator parameters and failsafe.cpp (1.14 and newer).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from llm_flock.robots import DriverCheck, MotionLimits, Position
from llm_flock_flight._mavlink.codec import GROUND_STATION
from llm_flock_flight._mavlink.modes import Flavour

_SMART = ("SmartRTL or RTL", "SmartRTL or Land")
_LAST = ("the landing of the mission, or RTL", "Brake or Land")
_BATTERY = ("nothing", "Land", "RTL", *_SMART, "Terminate", *_LAST)
_RADIO = ("nothing", "RTL", "RTL unless in a mission", "Land", *_SMART, *_LAST)
_LINK = ("nothing", "Hold", "Return", "Land", "action 4", "Terminate", "Disarm")

ARDUPILOT_FAILSAFES: Mapping[str, tuple[str, Sequence[str], Collection[int]]] = {
    "FS_THR_ENABLE": ("radio control lost", _RADIO, (3, 0, 7)),
    "BATT_FS_LOW_ACT": ("battery low", _BATTERY, (1, 0, 7)),
    "BATT_FS_CRT_ACT": ("battery critical", _BATTERY, (1, 0, 7)),
    "FS_EKF_ACTION": ("estimator lost", ("nothing", "Land", "AltHold", "Land"), (1, 3)),
}
PX4_FAILSAFES: Mapping[str, tuple[str, Sequence[str], Collection[int]]] = {
    "NAV_RCL_ACT": ("radio control lost", _LINK, (3, 0, 1)),
    "NAV_DLL_ACT": ("ground station lost", _LINK, (3, 0, 1)),
    "COM_LOW_BAT_ACT": ("battery critical", ("a warning", "Return", "Land", "Return, then Land"), (2, 0)),
}
"""What each is for, its actions by value, and those allowed, the advised one first: none flies home by itself, where no
shield keeps it from the others, and none stops the motors in the air."""

PX4_NAMES = ("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", *PX4_FAILSAFES)
ARDUPILOT_NAMES = (
    "FS_GCS_ENABLE",
    "FS_GCS_TIMEOUT",
    "SYSID_MYGCS|MAV_GCS_SYSID",
    "GUID_TIMEOUT",
    "FENCE_ENABLE",
    "FENCE_ACTION",
    "FENCE_TYPE",
    "FENCE_RADIUS",
    "FENCE_ALT_MAX",
    "FENCE_ALT_MIN",
    "FENCE_MARGIN",
    *ARDUPILOT_FAILSAFES,
)
MAX_HEIGHT, CIRCLE, POLYGON, MIN_HEIGHT = 1, 2, 4, 8  # bits of FENCE_TYPE

MAX_DELAY_S = 5.0  # longest silence of this computer after which an autopilot has to act [s]

LOSS_ACTIONS = ("Position mode", "Altitude mode", "Stabilized mode", "Return", "Land", "Hold", "Terminate", "Disarm")
"""Of PX4's COM_OBL_RC_ACT, by value."""

GCS_ACTIONS = (
    "nothing",
    "RTL",
    "RTL unless in a mission",
    *_SMART,
    "Land",
    *_LAST,
)
"""Of ArduPilot's FS_GCS_ENABLE, by value."""


def names_for(flavour: Flavour) -> Sequence[str]:
    """Parameters to read; "A|B" where versions differ in the name."""
    return ARDUPILOT_NAMES if flavour.takes_off_by_command else PX4_NAMES


def judge(
    flavour: Flavour, values: Mapping[str, float], home: Position, limits: MotionLimits
) -> tuple[DriverCheck, ...]:
    """The checks, by the parameters that the autopilot told; one that it did not tell is not judged.

    Set-points may lead anywhere within the `limits` [m], and the autopilot measures its fence from `home` [m].
    """
    far = [max(home[axis] - limits.low[axis], limits.high[axis] - home[axis]) for axis in range(2)]
    reach = math.hypot(*far), limits.high[2] - home[2]
    if flavour.takes_off_by_command:
        kinds, margin = int(values.get("FENCE_TYPE", MAX_HEIGHT | CIRCLE)), values.get("FENCE_MARGIN", 2.0)
        sides = [(CIRCLE, "FENCE_RADIUS", reach[0], "around"), (MAX_HEIGHT, "FENCE_ALT_MAX", reach[1], "up")]
        limits_m = [(values[name], far_m, where) for bit, name, far_m, where in sides if kinds & bit and name in values]
        if kinds & MIN_HEIGHT and "FENCE_ALT_MIN" in values:
            limits_m.append((-values["FENCE_ALT_MIN"], 0.0, "down"))  # set-points land it
        drawn = bool(kinds & POLYGON and "FENCE_TYPE" in values)
        fence = _fence(values.get("FENCE_ENABLE"), limits_m, margin, drawn=drawn)
        return (_ground_station(values), _failsafes(ARDUPILOT_FAILSAFES, values), fence)
    sides = (("GF_MAX_HOR_DIST", reach[0], "around"), ("GF_MAX_VER_DIST", reach[1], "up"))
    limits_m = [(values[name], far_m, where) for name, far_m, where in sides if values.get(name)]
    fence = _fence(values.get("GF_ACTION"), limits_m, 0.0, drawn=False)
    return (_stream(values), _failsafes(PX4_FAILSAFES, values), fence)


def _failsafes(
    known: Mapping[str, tuple[str, Sequence[str], Collection[int]]], values: Mapping[str, float]
) -> DriverCheck:
    """Failsafes other than for a silent computer: a vehicle that goes home by itself is under no shield."""
    told = {name: int(values[name]) for name in known if name in values}
    found = "; ".join(f"{known[name][0]}: {_word(known[name][1], value)}" for name, value in told.items())
    wrong = [name for name, value in told.items() if value not in known[name][2]]
    asked = ", ".join(f"{name} {next(iter(known[name][2]))}" for name in wrong)
    return DriverCheck(name="its failsafes", passed=not wrong, found=found or "not told", asked=asked)


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
    asked = f"COM_OBL_RC_ACT none of 3, 6 and 7, COM_OF_LOSS_T at most {MAX_DELAY_S:g} s; 4 lands it"
    return DriverCheck(name=name, passed=action in (0, 1, 2, 4, 5) and after <= MAX_DELAY_S, found=found, asked=asked)


def _ground_station(values: Mapping[str, float]) -> DriverCheck:
    """ArduPilot stays in Guided without set-points, and hovers: only its failsafe for heartbeats lands it."""
    name = "without heartbeats"
    action, after = values.get("FS_GCS_ENABLE"), values.get("FS_GCS_TIMEOUT", MAX_DELAY_S)
    if action is None:
        return DriverCheck(name=name, passed=True, found="not told")
    station = values.get("SYSID_MYGCS", values.get("MAV_GCS_SYSID", float(GROUND_STATION)))
    found = f"{_word(GCS_ACTIONS, action)} after {after:g} s without system {station:g}"
    asked = f"FS_GCS_ENABLE 5 or 7, and SYSID_MYGCS (or MAV_GCS_SYSID) {GROUND_STATION}; 5 lands it"
    return DriverCheck(name=name, passed=action in (5, 7) and station == GROUND_STATION, found=found, asked=asked)


def _fence(
    on: float | None, limits_m: Sequence[tuple[float, float, str]], margin: float, *, drawn: bool
) -> DriverCheck:
    """Its own fence has to hold ours: set-points outside it would be dropped without an answer, or end the flight.

    `limits_m` has each side's limit, how far set-points may lead, and its name.
    """
    name = "its own fence"
    if not on:
        return DriverCheck(name=name, passed=True, found="not told" if on is None else "off")
    sides = ", ".join([f"{limit:g} m {where}" for limit, _, where in limits_m] + ["a polygon, not compared"] * drawn)
    wrong = [f"at least {far + margin:.1f} m {where}" for limit, far, where in limits_m if far > limit - margin]
    asked = f"{', '.join(wrong)}, for our geofence and its margin of {margin:g} m" if wrong else ""
    return DriverCheck(name=name, passed=not wrong, found=f"on{': ' if sides else ''}{sides}", asked=asked)
