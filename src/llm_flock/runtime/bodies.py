"""What a trial needs of the bodies of its team, simulated or real."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from llm_flock.arrays import Point, Points
from llm_flock.robots.simulated import Sensing, SimulatedTeam


class Bodies(Protocol):
    """Positions and sensors of all robots, in mission units, and one motion of all of them."""

    @property
    def positions(self) -> Points:
        """Where everybody is, as the record has it, shape (n, d) [units; world frame]."""
        ...

    @property
    def in_radio_range(self) -> Sequence[tuple[int, ...]]:
        """For each robot the others within radio range, ascending."""
        ...

    def connected(self, robots: Sequence[int]) -> bool:
        """Whether the radio graph of these robots is one piece."""
        ...

    def sense(self, robot: int) -> Sensing:
        """What one robot's sensors say."""
        ...

    def everybody(self, robot: int) -> tuple[Point, ...]:
        """Positions of all other robots, in ascending order of ids, whatever their range."""
        ...

    async def fly(self, displacements: Points) -> None:
        """Fly every robot by its displacement, shape (n, d) [units], all at once; returns when they have arrived."""
        ...


class AtOnce(SimulatedTeam):
    """Simulated bodies for which a motion takes no time."""

    async def fly(self, displacements: Points) -> None:
        """Move, and be there."""
        self.move(displacements)
