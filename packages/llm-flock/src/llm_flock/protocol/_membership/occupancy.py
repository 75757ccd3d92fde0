"""Finds vacant and blocked places of a plan from sensors and heartbeats, and a waiting place for a spare robot."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from itertools import chain

from llm_flock import graph
from llm_flock.arrays import Point
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.obstacles import clearance
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import NONE, Occupancy
from llm_flock.protocol._membership.liveness import Liveness
from llm_flock.protocol._parts import Situation
from llm_flock.protocol._verification.plans import blocked_within

CLEARANCE = 2.0  # safe distances between a waiting robot and every place, so that another one can pass between

ANGLES, RINGS = 24, 40


@lru_cache(maxsize=1024)
def in_radio_contact(plan: Plan, comm_range: float) -> bool:
    """Whether robots on all places of a plan are connected by radio."""
    return graph.is_connected(graph.distances(plan.array) <= comm_range)


def still_bodies(now: Situation, silent: Collection[int]) -> tuple[Point, ...]:
    """Sensed bodies without heartbeat; none while the formation travels, because it passes them."""
    if now.mission.velocity is not None:
        return ()
    return tuple(now.sensed[j] for j in sorted(silent) if j in now.sensed)


def sight(mission: Mission) -> float:
    """Largest distance of a place at which every body that could block it is sensed [units]."""
    return mission.sensing - mission.downwash * max(blocked_within(mission), 0.0)


def observe(now: Situation, liveness: Liveness, *, hears_others: bool, knows_blocked: bool) -> Occupancy:
    """The occupancy of a plan's slots. `knows_blocked`: whether the own table has blocked ones. Call once a round.

    A slot is neither blocked nor clear if an unidentified body stands there, or if it is too far away to see. Living
    robots will move away. A robot declares no other dead while it hears no messages, or if its formation is not
    connected by radio.
    """
    mission, plan = now.mission, now.plan
    assert plan is not None, "slots are those of a plan"
    silent = liveness.silent if hears_others and in_radio_contact(plan, mission.comm_range) else NONE
    still = still_bodies(now, silent)
    covered = frozenset(a for a, x in enumerate(plan.points) if clearance(x, now.resting) < reachable(mission))
    if not (still or covered or knows_blocked):
        return Occupancy(silent=silent, alive=liveness.alive)
    too_near, living = blocked_within(mission), liveness.living
    places = [a for a, place in enumerate(plan.points) if math.dist(now.position, place) <= sight(mission)]

    def under(bodies: Collection[Point]) -> frozenset[int]:
        return frozenset(a for a in places if any(mission.separation(plan.points[a], x) < too_near for x in bodies))

    clear = frozenset(places) - under([x for j, x in now.sensed.items() if j not in living])
    return Occupancy(silent=silent, blocked=under(still) | covered, clear=clear - covered, alive=liveness.alive)


def reachable(mission: Mission) -> float:
    """Smallest distance from an obstacle that has come to rest at which a robot counts as at its place [units]."""
    return mission.body_radius - AT_GOAL * mission.spacing


def waiting_place(
    mission: Mission, position: Point, plan: Plan, others: Sequence[Point], blocked: Collection[int] = ()
) -> Point:
    """The nearest point clear of everything, if possible in sight of the nearest blocked slot; else `position`."""
    clear = CLEARANCE * mission.safe_distance
    watched = min((plan.points[a] for a in blocked), key=lambda place: math.dist(position, place), default=position)
    reach = sight(mission)
    low, high = mission.arena

    def fits(point: Point) -> bool:
        return (
            all(mission.separation(point, place) >= clear for place in plan.points)
            and all(mission.separation(point, other) >= mission.safe_distance for other in others)
            and all(a <= x <= b for a, x, b in zip(low, point, high, strict=True))
            and clearance(point, mission.obstacles) >= mission.body_radius
        )

    around = _rings(watched, mission.safe_distance) if blocked else ()
    for point in chain(_rings(position, mission.safe_distance), around):
        if math.dist(point, watched) <= reach and fits(point):
            return point
    return next(filter(fits, _rings(position, mission.safe_distance)), position)


def _rings(center: Point, step: float) -> Iterator[Point]:
    """Points around a centre, the nearest first, in the plane of the first two axes."""
    yield center
    for ring in range(1, RINGS + 1):
        for k in range(ANGLES):
            angle = 2.0 * math.pi * k / ANGLES
            offset = (ring * step * math.cos(angle), ring * step * math.sin(angle))
            yield (center[0] + offset[0], center[1] + offset[1], *center[2:])
