"""What a drone with a Lighthouse deck says about the base stations that it sees.

Names and values are the firmware's (`src/modules/src/lighthouse/lighthouse_core.c`): `lighthouse.status` and two bit
fields with one bit for each base station.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

LIGHTHOUSE_LOG: Mapping[str, str] = MappingProxyType(
    {"lighthouse.status": "uint8_t", "lighthouse.bsReceive": "uint16_t", "lighthouse.bsActive": "uint16_t"}
)
"""Variables of the log block, and their types in packets. Firmware built without Lighthouse does not have them."""

LIGHTHOUSE_PERIOD_MS = 500

STATUS = ("no base station is received", "geometry or calibration is missing", "in use")
"""What each value of `lighthouse.status` means."""


def lighthouse_in_words(values: Mapping[str, float]) -> str:
    """What is seen, by a packet of `LIGHTHOUSE_LOG`."""
    status = int(values["lighthouse.status"])
    if status == 0:
        return f"Lighthouse: {STATUS[0]}"
    received, active = (_stations(int(values[f"lighthouse.{name}"])) for name in ("bsReceive", "bsActive"))
    said = STATUS[status] if status < len(STATUS) else f"status {status}"
    return f"Lighthouse: {said}; receives {received}, uses {active}"


def _stations(bits: int) -> str:
    """Base stations by their channels, which count from 1."""
    return ", ".join(str(k + 1) for k in range(16) if bits >> k & 1) or "none"
