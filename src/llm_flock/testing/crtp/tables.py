"""The tables of contents of a drone: its log variables and its parameters."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

LOG_TYPES: Mapping[int, str] = MappingProxyType(
    {1: "<B", 2: "<H", 3: "<L", 4: "<b", 5: "<h", 6: "<i", 7: "<f", 8: "<e"}
)
"""How a log variable of a type is packed (firmware: `src/modules/interface/log.h`)."""

PARAMETER_TYPES: Mapping[int, str] = MappingProxyType({0x08: "<B", 0x09: "<H", 0x0A: "<L", 0x06: "<f"})
"""How a parameter of a type is packed (firmware: `src/modules/interface/param_logic.h`)."""

LOGGED: Mapping[str, int] = MappingProxyType(
    {
        "stateEstimate.x": 7,
        "stateEstimate.y": 7,
        "stateEstimate.z": 7,
        "stateEstimate.yaw": 7,
        "pm.vbat": 7,
        "kalman.varPX": 7,
        "kalman.varPY": 7,
        "kalman.varPZ": 7,
        "supervisor.info": 2,
    }
)
"""Type of each log variable by name, in order."""


@dataclass(slots=True)
class Parameter:
    """One parameter."""

    kind: int
    value: float

    def packed(self) -> bytes:
        """The bytes of the value."""
        code = PARAMETER_TYPES[self.kind]
        return struct.pack(code, self.value if code == "<f" else int(self.value))

    def take(self, data: bytes) -> None:
        """Set the value from its bytes."""
        self.value = float(struct.unpack(PARAMETER_TYPES[self.kind], data)[0])


def parameters() -> dict[str, Parameter]:
    """The parameters that flights set, by name, in order."""
    return {
        "stabilizer.estimator": Parameter(0x08, 2),
        "stabilizer.controller": Parameter(0x08, 1),
        "kalman.resetEstimation": Parameter(0x08, 0),
        "locSrv.extPosStdDev": Parameter(0x06, 0.01),
        "commander.enHighLevel": Parameter(0x08, 1),
    }


def contents(names: Sequence[str], kinds: Sequence[int]) -> tuple[int, list[bytes]]:
    """Checksum of a table, and the bytes of each entry."""
    rows = [
        bytes([kind]) + group.encode() + b"\0" + name.encode() + b"\0"
        for (group, name), kind in zip((n.split(".") for n in names), kinds, strict=True)
    ]
    return zlib.crc32(b"".join(rows)), rows
