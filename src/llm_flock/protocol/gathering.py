"""Where a large team meets that is still in pieces.

Every piece has a plan of its own, and the same shape in another turn has its places elsewhere: the corners of two
squares are far from each other's sides, and pieces that sit on them do not meet. The circle about the centre with the
mean radius of the places is the same in every turn. So while less than half of a plan's places have owners, a robot
goes to where its place lies on that circle as seen from the centre, and looks for others along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.protocol.messages import NO_OWNER, Entry
from llm_flock.protocol.plan import Plan

HOLLOW = 0.5
"""Shapes whose nearest place to the centre is at this share of the farthest one's distance, or more, have a circle."""

ENOUGH = 0.5
"""With this share of a plan's places taken, its robots fly to them."""


def meeting_places(mission: Mission, plan: Plan, table: Sequence[Entry]) -> Plan:
    """Where the places of a plan are for now: on the circle of the mean radius while most are nobody's.

    Args:
        mission: centre, and obstacles that no place may be on.
        plan: the plan that is followed.
        table: all claims known.
    """
    places = _on_circle(plan, mission.center)
    if places is plan or sum(owner > NO_OWNER for _, _, owner in table) >= ENOUGH * len(plan):
        return plan
    clear = all(clearance(place, mission.obstacles) >= mission.body_radius for place in places.points)
    return places if clear else plan


@lru_cache(maxsize=256)
def _on_circle(plan: Plan, center: Point) -> Plan:
    """The places of a hollow plan, each moved to or from the centre onto the circle of their mean radius."""
    offsets = plan.array - np.array(center)
    radii = np.linalg.norm(offsets, axis=1, keepdims=True)
    if radii.min() < HOLLOW * radii.max() or not radii.min():
        return plan
    return Plan.of(tuple(place) for place in (np.array(center) + offsets * (radii.mean() / radii)).tolist())
