"""What a trial needs of the bodies of its team, simulated or real."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from llm_flock.arrays import Point, Points
from llm_flock.robots.simulated import Sensing, SimulatedTeam


class Bodies(Protocol):
    """Positions and sensors of all robots, in mission units, and their joint motion."""

    @property
    def positions(self) -> Points:
        """Positions of all robots, as recorded, shape (n, d) [units; world frame]."""
        ...

    @property
    def in_radio_range(self) -> Sequence[tuple[int, ...]]:
        """For each robot the others within radio range, ascending."""
        ...

    def connected(self, robots: Sequence[int]) -> bool:
        """Whether the radio graph of these robots is connected."""
        ...

    def sense(self, robot: int) -> Sensing:
        """One robot's sensor readings."""
        ...

    def others(self, robot: int) -> tuple[Point, ...]:
        """Positions of all other robots, in ascending order of ids, whatever their range."""
        ...

    async def fly(self, displacements: Points) -> None:
        """Fly every robot by its displacement, shape (n, d) [units], all at once; returns when they have arrived."""
        ...


class InstantBodies(SimulatedTeam):
    """Simulated bodies whose motions take no time."""

    @property
    def positions(self) -> Points:
        """True positions, shape (n, d) [units]."""
        return self.places

    async def fly(self, displacements: Points) -> None:
        """Move at once."""
        self.move(displacements)
