"""Who belongs to a team: its robots, and those around it that speak or listen too."""

from __future__ import annotations

from llm_flock.errors import InputError

OPERATOR = -2
"""Gives missions."""

WORLD = -1
"""Stands for sensors and bodies where the robots are simulated, and keeps the record."""

WATCHER = -3
"""Listens, and says nothing."""

OTHERS = {OPERATOR: "operator", WORLD: "world", WATCHER: "watcher"}


def member_name(member: int) -> str:
    """The folder and certificate name of a member: `robot-3`, `operator`, `world` or `watcher`."""
    return OTHERS[member] if member < 0 else f"robot-{member}"


def member_id(name: str) -> int:
    """The id of a member by its name.

    Raises:
        InputError: there is no such name.
    """
    for member, other in OTHERS.items():
        if name == other:
            return member
    head, _, number = name.partition("-")
    if head != "robot" or not (number.isascii() and number.isdecimal()):
        raise InputError("member", name, "robot-ID, operator, world or watcher")
    return int(number)


def members(n_robots: int) -> tuple[int, ...]:
    """Ids of everybody in a team of N."""
    return (*range(n_robots), *OTHERS)
