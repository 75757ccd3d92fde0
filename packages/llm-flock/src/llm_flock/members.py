"""Ids of a team's members: its robots, and the processes around them that send or listen too."""

from __future__ import annotations

OPERATOR = -2  #: Gives missions.
WORLD = -1  #: Stands for sensors and bodies where the robots are simulated, and writes the record.
WATCHER = -3  #: Only listens.

OTHERS = {OPERATOR: "operator", WORLD: "world", WATCHER: "watcher"}


def member_name(member: int) -> str:
    """The folder and certificate name of a member: `robot-3`, `operator`, `world` or `watcher`."""
    return OTHERS[member] if member < 0 else f"robot-{member}"


def members(n_robots: int) -> tuple[int, ...]:
    """Ids of every member of a team of N robots."""
    return (*range(n_robots), *OTHERS)
