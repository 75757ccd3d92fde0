"""A record's row of states, from what the robots of a swarm report about themselves."""

from __future__ import annotations

from collections.abc import Mapping, Set

from llm_flock.arrays import Point, Points
from llm_flock.protocol.events import Origin
from llm_flock.record.schema import ASLEEP, DEAD, State
from llm_flock.runtime.network.wire import RobotReport


def state_row(
    row: int,
    positions: Points,
    reports: Mapping[int, RobotReport],
    goals: Mapping[int, Point | None],
    seen: Set[int],
) -> State:
    """The row of this number, for bodies at positions of shape (N, d) [units; world frame].

    A robot without a report sleeps if it was never `seen`, and is dead otherwise.
    """
    start = Origin.START.value if row == 0 else Origin.HOLD.value
    all_reports = [reports.get(robot) for robot in range(len(positions))]
    places = [goals.get(robot) for robot in range(len(positions))]
    return State(
        round=row,
        positions=positions.tolist(),
        goals=[None if place is None else list(place) for place in places],
        slots=[None if r is None else r.slot for r in all_reports],
        plan_ids=[None if r is None else r.plan_id for r in all_reports],
        influence=[0.0 if r is None else r.neighbors / len(positions) for r in all_reports],
        waypoints=[None if r is None or r.waypoint is None else list(r.waypoint) for r in all_reports],
        origins=[start if r is None else r.origin for r in all_reports],
        open_breakers=[[] if r is None else list(r.breakers) for r in all_reports],
        phases=[r.phase if r is not None else DEAD if robot in seen else ASLEEP for robot, r in enumerate(all_reports)],
    )
