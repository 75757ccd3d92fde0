"""What a trial needs of the bodies of its team, simulated or real."""

from __future__ import annotations

from typing import Protocol

from llm_flock.arrays import Points
from llm_flock.robots.simulated import Readings


class Bodies(Protocol):
    """Positions and sensors of all robots, in mission units, and their joint motion."""

    @property
    def positions(self) -> Points:
        """Positions of all robots, as recorded, shape (n, d) [units; world frame]."""
        ...

    @property
    def readings(self) -> Readings:
        """What the robots read of each other now, and who is within range of whom."""
        ...

    async def fly(self, displacements: Points) -> None:
        """Fly every robot by its displacement, shape (n, d) [units], all at once; returns when they have arrived."""
        ...


class InstantBodies:
    """Simulated bodies whose motions take no time."""

    def __init__(self, readings: Readings) -> None:
        self.readings = readings

    @property
    def positions(self) -> Points:
        """True positions, shape (n, d) [units]."""
        return self.readings.places

    async def fly(self, displacements: Points) -> None:
        """Move at once."""
        self.readings.move(displacements)
