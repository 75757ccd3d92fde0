"""Who is awake: the minds of a team, those that died, and those that have not begun yet."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from llm_flock.protocol.agent import Agent
from llm_flock.record.schema import ASLEEP, DEAD
from llm_flock.runtime.bodies import Bodies


class Roster:
    """One mind a robot, and which of them are awake. A body is there in any case.

    Args:
        make: makes the mind of a robot, anew each time.
        n_robots: team size N.
        asleep: robots that begin later.
    """

    def __init__(self, make: Callable[[int], Agent], n_robots: int, asleep: Iterable[int] = ()) -> None:
        self._make = make
        self._silent = dict.fromkeys(asleep, ASLEEP)
        self.agents = [make(robot) for robot in range(n_robots)]
        self.awake: list[int] = []
        self._count()

    def _count(self) -> None:
        self.awake = [robot for robot in range(len(self.agents)) if robot not in self._silent]

    def kill(self, robot: int) -> None:
        """From now on the robot neither thinks, moves, sends nor receives."""
        self._silent[robot] = DEAD
        self._count()

    def join(self, robot: int) -> Agent:
        """The robot begins, or begins again, and remembers nothing; returns its mind of before."""
        del self._silent[robot]
        before, self.agents[robot] = self.agents[robot], self._make(robot)
        self._count()
        return before

    def minds(self) -> list[Agent]:
        """Minds of the robots that are awake, by id."""
        return [self.agents[robot] for robot in self.awake]

    def phase(self, robot: int) -> str:
        """Phase of a robot's state machine, or what stands for it."""
        return self._silent.get(robot) or self.agents[robot].phase.value

    def hears(self, team: Bodies, robot: int) -> tuple[int, ...]:
        """Robots that are awake within radio range of one that is; none for one that is not."""
        if not self._silent:
            return team.in_radio_range[robot]
        if robot in self._silent:
            return ()
        return tuple(other for other in team.in_radio_range[robot] if other not in self._silent)
