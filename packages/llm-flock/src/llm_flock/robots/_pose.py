"""Poses of drones that something outside measures, and the interface of what hands them over."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from llm_flock.robots._base import Position

Quaternion: TypeAlias = tuple[float, float, float, float]
"""x, y, z and w, of length 1."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a drone is [m; world frame, z up], and how it is turned, if that is known."""

    position: Position
    quaternion: Quaternion | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFrame:
    """Poses by the drones' names, of one moment of the sender's clock [s], whose zero may be anywhere."""

    stamp_s: float
    poses: Mapping[str, Pose]


class PoseSource(Protocol):
    """Hands over frames while it is open. Open and close it once, in a running event loop."""

    @property
    def refused(self) -> Counter[str]:
        """Input that was dropped, by reason. It never ends a source."""
        ...

    async def open(self, take: Callable[[PoseFrame], None]) -> None:
        """Call `take` with each frame from now on, in the event loop.

        Raises:
            InputError: the source cannot be opened.
        """
        ...

    async def close(self) -> None:
        """Hand nothing over any more; harmless when called twice or never opened."""
        ...
