"""Preferences of a mission: which robots should take which places, as costs of a joint assignment."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from llm_flock.arrays import Pairwise, Points
from llm_flock.mission import Mission
from llm_flock.plan import Plan

FIRM = 1e9  # what a place in the own group saves [units^2]: more than all ways together
SIDE = 1e5  # what each unit to the side of a group saves there [units]
STRONG = 100.0  # weight of a robot's way, or of a place's distance from the centre, beside the ways of others
AXES = {"west": (-1.0, 0.0), "east": (1.0, 0.0), "south": (0.0, -1.0), "north": (0.0, 1.0)}


@lru_cache(maxsize=64)
def _groups_of(mission: Mission, plan: Plan) -> NDArray[np.intp]:
    """The group of the program that each place of a plan belongs to, shape (m,); zeros without groups."""
    from llm_flock.formation import group_sizes, program_of

    program = program_of(mission.shape)
    if program is None or program.groups is None:
        return np.zeros(len(plan), dtype=np.intp)
    ideal = np.array(mission.resized(len(plan)).ideal)
    row = np.linalg.norm(plan.array[:, None] - ideal[None], axis=2).argmin(axis=1)
    return np.repeat(np.arange(len(program.groups)), group_sizes(program.groups, len(plan)))[row]


def costs(mission: Mission, plan: Plan, robots: Sequence[int], positions: Points, ways: Pairwise) -> Pairwise:
    """The cost of each place for each robot, shape (n, m) [units^2]: squared ways, and what preferences add."""
    cost, groups = ways**2, _groups_of(mission, plan)
    far = ((plan.array - np.array(mission.center)) ** 2).sum(axis=1)
    for one in mission.prefer:
        if one.side is not None:
            cost[:, groups == one.group] -= SIDE * (positions[:, :2] @ np.array(AXES[one.side]))[:, None]
        elif one.robot in robots:
            row = robots.index(one.robot)
            if one.group is not None:
                cost[row, groups == one.group] -= FIRM
            else:
                strong = {"shortest": cost[row], "center": far, "edge": -far}[one.way or "shortest"]
                cost[row] = cost[row] + STRONG * strong
    return cost
