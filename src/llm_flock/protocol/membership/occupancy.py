"""What a robot sees of bodies without a mind: where they stand, and which places of a plan they keep from everybody."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.verification.plans import blocked_within


def bodies(mission: Mission, sensed: Mapping[int, Point], silent: Collection[int]) -> tuple[Point, ...]:
    """Bodies in sight without a mind [units; frame of the mission].

    None while the formation travels: it passes them by, and no place stays under them.

    Args:
        mission: the mission in force.
        sensed: positions of the robots within sensing range, by id [units; frame of the mission].
        silent: robots that were heard of and are no more.
    """
    if mission.velocity is not None:
        return ()
    return tuple(sensed[j] for j in sorted(silent) if j in sensed)


def sight(mission: Mission) -> float:
    """How far away a place may be so that every body is sensed that could block it [units]."""
    return mission.sensing - max(blocked_within(mission), 0.0)


def observed_occupancy(
    mission: Mission,
    plan: Plan,
    position: Point,
    sensed: Mapping[int, Point],
    still: Sequence[Point],
    living: Collection[int],
) -> tuple[frozenset[int], frozenset[int]]:
    """Places that a body without a mind keeps anybody from taking, and places that have none, as far as can be told.

    Whose body it is that stands on a place may be known to others only: such a place counts as neither. Nor does one
    that is too far away to be seen with all that could block it. Who is known to live will move off by itself.

    Args:
        mission: the mission in force.
        plan: whose places are looked at.
        position: where the robot looks from [units; frame of the mission].
        sensed: positions of the robots within sensing range, by id [units; frame of the mission].
        still: those of them that have no mind (`bodies`).
        living: robots that have one, as far as can be told (`Liveness.living`).
    """
    too_near = blocked_within(mission)
    places = [a for a, place in enumerate(plan.points) if math.dist(position, place) <= sight(mission)]

    def under(those: Collection[Point]) -> frozenset[int]:
        return frozenset(a for a in places if any(math.dist(plan.points[a], x) < too_near for x in those))

    return under(still), frozenset(places) - under([x for j, x in sensed.items() if j not in living])
