"""A stand-in's estimator by positions from outside: it follows each received pose, and stands still without one.

A real estimator would go on by its inertial sensors, and drift; that is not modelled.
"""

from __future__ import annotations

import struct

from llm_flock.robots import PointMass, Position

POSITION_CHANNEL, GENERIC_CHANNEL, EXT_POSE = 0, 1, 8
"""Channels of the localisation port, and the kind of packet with a pose (firmware: `crtp_localization_service.c`)."""

TRUST = 0.3  # share by which one position corrects the estimate
FAR_M = 1.0  # a position that is farther off replaces the estimate [m]
SILENT_S = 0.15  # the estimate stands still after this time without a position [s]


class ExternalPosition:
    """The part of an estimator that is told where it is: at the origin before. `taken` has times [s] and places [m]."""

    def __init__(self, body: PointMass) -> None:
        self.taken: list[tuple[float, Position]] = []
        self._body = body
        self._standing = False
        x, y, z = body.home
        body.jump((-x, -y, -z), 0.0)

    def take(self, channel: int, data: bytes, now: float) -> bool:
        """Take a packet of the localisation port; returns whether it is a position."""
        if channel == POSITION_CHANNEL:
            position: Position = struct.unpack_from("<fff", data)
        elif channel == GENERIC_CHANNEL and data[0] == EXT_POSE:
            position = struct.unpack_from("<fff", data, 1)
        else:
            return False
        self.taken.append((now, position))
        if self._standing:
            self._standing = False
            self._body.stall(now, False)
        x, y, z = (target - here for target, here in zip(position, self._body.estimate(now), strict=True))
        share = 1.0 if max(abs(x), abs(y), abs(z)) > FAR_M else TRUST
        self._body.jump((share * x, share * y, share * z), now)
        return True

    def advance(self, now: float) -> None:
        last_s = self.taken[-1][0] if self.taken else 0.0
        if not self._standing and now - last_s > SILENT_S:
            self._standing = True
            self._body.stall(now)
