"""Flight modes of PX4 and of ArduPilot's copters: their numbers, their names, and the pilot in each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

PX4 = 12
ARDUPILOT = 3
"""Numbers of the autopilots in a heartbeat (MAV_AUTOPILOT)."""

COPTERS = frozenset({2, 3, 4, 13, 14, 15, 29, 35})
"""Types of vehicles that hover (MAV_TYPE): quad-, hexa-, octo-, tri-, deca- and dodecarotors, helicopters."""


def px4(main: int, sub: int = 0) -> int:
    """PX4's number of a mode: the main mode in the third byte, the sub-mode in the fourth."""
    return main << 16 | sub << 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Flavour:
    """The differences between the autopilots.

    The mode `guided` follows set-points of a computer; from those that it `holds` in by itself after a lost stream it
    may be landed. `needs_stream`: set-points have to come before `guided` and all the time in it. `integers_as_bits`: a
    parameter's float holds the bits of an integer, not its value.
    """

    name: str
    guided: int
    land: int
    holds: frozenset[int]
    names: Mapping[int, str]
    needs_stream: bool
    takes_off_by_command: bool
    integers_as_bits: bool

    def name_of(self, mode: int) -> str:
        """The name of a mode."""
        return self.names.get(mode, f"mode {mode}")

    def set_mode(self, mode: int) -> tuple[float, float, float]:
        """The first three parameters of MAV_CMD_DO_SET_MODE; 1 is for modes with numbers of the autopilot's own."""
        if self.integers_as_bits:
            return 1.0, float(mode >> 16 & 0xFF), float(mode >> 24 & 0xFF)
        return 1.0, float(mode), 0.0


PX4_FLAVOUR = Flavour(
    name="PX4",
    guided=px4(6),
    land=px4(4, 6),
    holds=frozenset({px4(4, 3), px4(4, 2)}),
    names=MappingProxyType(
        {
            px4(1): "Manual",
            px4(2): "Altitude",
            px4(3): "Position",
            px4(4, 1): "Ready",
            px4(4, 2): "Takeoff",
            px4(4, 3): "Hold",
            px4(4, 4): "Mission",
            px4(4, 5): "Return",
            px4(4, 6): "Land",
            px4(4, 8): "Follow",
            px4(4, 9): "Precision land",
            px4(5): "Acro",
            px4(6): "Offboard",
            px4(7): "Stabilized",
        }
    ),
    needs_stream=True,
    takes_off_by_command=False,
    integers_as_bits=True,
)

ARDUPILOT_FLAVOUR = Flavour(
    name="ArduPilot",
    guided=4,
    land=9,
    holds=frozenset({17}),
    names=MappingProxyType(
        {
            0: "Stabilize",
            1: "Acro",
            2: "AltHold",
            3: "Auto",
            4: "Guided",
            5: "Loiter",
            6: "RTL",
            7: "Circle",
            9: "Land",
            11: "Drift",
            13: "Sport",
            14: "Flip",
            15: "AutoTune",
            16: "PosHold",
            17: "Brake",
            18: "Throw",
            19: "Avoid_ADSB",
            20: "Guided_NoGPS",
            21: "SmartRTL",
            22: "FlowHold",
            23: "Follow",
            24: "ZigZag",
            27: "Auto RTL",
        }
    ),
    needs_stream=False,
    takes_off_by_command=True,
    integers_as_bits=False,
)

FLAVOURS: Mapping[int, Flavour] = MappingProxyType({PX4: PX4_FLAVOUR, ARDUPILOT: ARDUPILOT_FLAVOUR})  # by MAV_AUTOPILOT
