"""Slots that robots without a heartbeat occupy or leave free: what sensors and heartbeats say about a plan's places."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import lru_cache

from llm_flock import graph
from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import NONE, Occupancy
from llm_flock.protocol._membership.liveness import Liveness
from llm_flock.protocol._verification.plans import blocked_within


@lru_cache(maxsize=1024)
def in_radio_contact(plan: Plan, comm_range: float) -> bool:
    """Whether robots on all places of a plan are connected by radio."""
    return graph.is_connected(graph.distances(plan.array) <= comm_range)


def still_bodies(mission: Mission, sensed: Mapping[int, Point], silent: Collection[int]) -> tuple[Point, ...]:
    """Positions of sensed robots whose heartbeats have stopped [units; frame of the mission].

    Empty while the formation travels: it passes such bodies, and no place stays under them.
    """
    if mission.velocity is not None:
        return ()
    return tuple(sensed[j] for j in sorted(silent) if j in sensed)


def sight(mission: Mission) -> float:
    """Largest distance of a place at which every body that could block it is sensed [units]."""
    return mission.sensing - max(blocked_within(mission), 0.0)


def observe(
    mission: Mission,
    plan: Plan,
    position: Point,
    sensed: Mapping[int, Point],
    liveness: Liveness,
    *,
    hears_others: bool,
    knows_blocked: bool,
) -> Occupancy:
    """The occupancy of a plan's slots as one robot sees it. Call once a round.

    A slot is neither blocked nor clear if an unidentified body stands there, which may be known to others, or if it is
    too far away to see everything that could block it. Robots known to live do not block a slot: they will move away.
    A robot that hears no others is itself cut off: it declares nobody dead, so it neither frees a slot of another robot
    nor blocks one. The same holds in a formation whose places are not all in radio contact, where silence proves
    nothing.

    `sensed` has the positions of the robots within sensing range, by id [units; frame of the mission]; `knows_blocked`
    says whether the robot's bid table has blocked slots.
    """
    silent = liveness.silent if hears_others and in_radio_contact(plan, mission.comm_range) else NONE
    still = still_bodies(mission, sensed, silent)
    alive = mission.n_robots - len(liveness.silent | liveness.strangers)
    if not (still or knows_blocked):
        return Occupancy(silent=silent, alive=alive)
    too_near, living = blocked_within(mission), liveness.living
    places = [a for a, place in enumerate(plan.points) if math.dist(position, place) <= sight(mission)]

    def under(bodies: Collection[Point]) -> frozenset[int]:
        return frozenset(a for a in places if any(math.dist(plan.points[a], x) < too_near for x in bodies))

    clear = frozenset(places) - under([x for j, x in sensed.items() if j not in living])
    return Occupancy(silent=silent, blocked=under(still), clear=clear, alive=alive)
