"""Preferences of a mission: which robots should take which places of its plan."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from llm_flock.arrays import Pairwise, Point, Points, Vector
from llm_flock.message import MAX_BID
from llm_flock.mission import Mission
from llm_flock.plan import Plan

FIRM = 1e9  # cost of a place outside the own group [units^2]: more than all ways together
SIDE = 1e5  # cost of each unit by which a robot of such a group stands less far to that side [units]
SHORT = 100.0  # weight of squared ways of a robot that is to fly little
MIDDLE = 100.0  # weight of the squared distance of a place from the centre
AXES = {"west": (-1.0, 0.0), "east": (1.0, 0.0), "south": (0.0, -1.0), "north": (0.0, 1.0)}


@lru_cache(maxsize=64)
def groups_of(mission: Mission, plan: Plan) -> NDArray[np.intp]:
    """The group of the program that each place of a plan belongs to, shape (m,); zeros without groups."""
    from llm_flock.formation import group_sizes, program_of

    program = program_of(mission.shape)
    if program is None or program.groups is None:
        return np.zeros(len(plan), dtype=np.intp)
    resized = mission.resized(len(plan))
    ideal = np.array(resized.ideal)
    row = np.linalg.norm(plan.array[:, None] - ideal[None], axis=2).argmin(axis=1)
    return np.repeat(np.arange(len(program.groups)), group_sizes(program.groups, len(plan)))[row]


def costs(mission: Mission, plan: Plan, robots: tuple[int, ...], positions: Points, ways: Pairwise) -> Pairwise:
    """The cost of each place for each robot, shape (n, m) [units^2]: squared ways, and what preferences add."""
    cost, groups = ways**2, groups_of(mission, plan)
    far = ((plan.array - np.array(mission.center)) ** 2).sum(axis=1)
    for wish in mission.prefer:
        if wish.side is not None:
            cost[:, groups == wish.group] -= SIDE * (positions[:, :2] @ np.array(AXES[wish.side]))[:, None]
        elif wish.robot in robots:
            row = robots.index(wish.robot)
            if wish.group is not None:
                cost[row, groups == wish.group] -= FIRM
            elif wish.way == "shortest":
                cost[row] += (SHORT - 1) * ways[row] ** 2
            else:
                cost[row] += far * (MIDDLE if wish.way == "center" else -MIDDLE)
    return cost


def wished_bids(mission: Mission, plan: Plan, robot: int, position: Point, ways: Vector) -> Vector:
    """Bids for all places, shape (m,): where there is a preference, above those of robots without one."""
    bids, groups = 0.0 - ways, groups_of(mission, plan)
    far = np.linalg.norm(plan.array - np.array(mission.center), axis=1)
    for wish in mission.prefer:
        if wish.side is not None:
            chosen = groups == wish.group
            bids[chosen] += MAX_BID / 8 + 1000 * float(np.dot(position[:2], AXES[wish.side]))
        elif wish.robot == robot and wish.group is not None:
            bids[groups == wish.group] += MAX_BID / 2
        elif wish.robot == robot:
            bids += MAX_BID / 16 + far * {"shortest": 0.0, "center": -100.0, "edge": 100.0}[wish.way or "shortest"]
    return np.clip(bids, -MAX_BID / 2, 3 * MAX_BID / 4)


def exchange_gain(mission: Mission, plan: Plan, robots: tuple[int, int], slots: tuple[int, int], ways: Pairwise) -> float:
    """Gain of an exchange of slots between two robots, whose `ways` to both have the shape (2, 2) [units^2].

    Minus infinity between two groups of which one got the robots of a side: only where they were when it began counts.
    """
    groups = groups_of(mission, plan)
    sides = {wish.group for wish in mission.prefer if wish.side is not None}
    if groups[slots[0]] != groups[slots[1]] and sides & {int(groups[slots[0]]), int(groups[slots[1]])}:
        return -np.inf
    every = np.zeros((2, len(plan)))
    every[:, list(slots)] = ways
    cost = costs(mission, plan, robots, np.zeros((2, 2)), every)
    (a, b), own, other = slots, cost[0], cost[1]
    return float(own[a] + other[b] - own[b] - other[a])
