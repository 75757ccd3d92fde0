"""Monitors of a flight: compare every drone's state with its command and the limits. Reads no clock and no robot.

Every trouble ends the flight. A drone is landed if that is safer than a fall: everywhere but far outside the
geofence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import scipy

from llm_flock.arrays import flattened
from llm_flock.robots import RobotState
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.lag import Tracking

PERIOD_S = 0.05  # time between two checks [s]


class TroubleKind(Enum):
    """Reasons to end a flight before its mission."""

    LINK_LOST = "link_lost"
    ESTIMATE_STALLED = "estimate_stalled"
    ESTIMATE_JUMPED = "estimate_jumped"
    POSE_LOST = "pose_lost"
    OFF_COURSE = "off_course"
    BATTERY_LOW = "battery_low"
    GEOFENCE = "geofence"
    FAR_OUTSIDE = "far_outside"
    TOO_NEAR = "too_near"
    FAULT = "fault"
    MODEL_SILENT = "model_silent"
    SET_POINT = "set_point"
    TIME_UP = "time_up"
    REFUSED = "refused"
    UNWATCHED = "unwatched"
    HUNG = "hung"
    ABORT = "abort"
    EMERGENCY = "emergency"


@dataclass(frozen=True, slots=True)
class Trouble:
    """A reason to end the flight: the drone concerned (None for all), and drones whose motors must be cut at once."""

    kind: TroubleKind
    robot: int | None = None
    detail: str = ""
    cut: frozenset[int] = frozenset()


class Monitors:
    """Checks the states of all drones, again and again."""

    def __init__(self, config: FlightConfig, names: Sequence[str]) -> None:
        self._safety = config.safety
        self._fence = config.world.geofence
        self._names = names
        self._low_v = [config.safety.low_battery_v] * len(names)
        for robot, drone in enumerate(config.fleet.drones):
            if drone.low_battery_v is not None:
                self._low_v[robot] = drone.low_battery_v
        self._last: dict[int, RobotState] = {}
        self._low_since: dict[int, float] = {}
        self._off_since: dict[int, float] = {}
        self._far_since: dict[int, float] = {}

    def look(
        self, now_s: float, states: Sequence[RobotState], tracking: Tracking, airborne: frozenset[int]
    ) -> list[Trouble]:
        """Every trouble at this moment, causes before their effects; one that lasts is returned by every call.

        Only drones in `airborne`, that have taken off and were not told to land, are held to their set-points.
        """
        found: list[Trouble] = []
        for robot, state in enumerate(states):
            found += self._one(now_s, robot, state, tracking.off_m[robot], robot in airborne)
        found += self._pairs(states, airborne)
        return sorted(found, key=lambda trouble: trouble.kind not in (TroubleKind.LINK_LOST, TroubleKind.FAULT))

    def _one(self, now: float, robot: int, state: RobotState, off: float, airborne: bool) -> list[Trouble]:
        safety = self._safety
        found: list[Trouble] = []

        def report(kind: TroubleKind, detail: str, *, cut: bool = False) -> None:
            who = frozenset((robot,)) if cut else frozenset[int]()
            found.append(Trouble(kind, robot=robot, detail=f"{self._names[robot]}: {detail}", cut=who))

        if state.taken_over is not None:
            report(TroubleKind.REFUSED, state.taken_over)
            return found  # its pilot answers for it: nothing more is asked of it, and its motors are not cut
        old = now - state.stamp_s > safety.stall_s
        if state.link_lost:
            report(TroubleKind.LINK_LOST, "its link is lost")
        elif old and state.heard_s is not None and now - state.heard_s > safety.stall_s / 2:
            # Estimates do not come because nothing does; the last to come may have been an answer, just after one.
            report(TroubleKind.LINK_LOST, f"nothing has come from it for {now - state.heard_s:.2f} s")
        elif old:
            report(TroubleKind.ESTIMATE_STALLED, f"its last position estimate is {now - state.stamp_s:.2f} s old")
        if airborne and state.fault is not None and not state.link_lost:
            report(TroubleKind.FAULT, f"it cannot fly any more: {state.fault}")
        before = self._last.get(robot)
        if before is None or state.stamp_s > before.stamp_s:
            self._last[robot] = state
        jumped = False
        if before is not None and state.stamp_s > before.stamp_s:
            moved = math.dist(before.position, state.position)
            jumped = moved > safety.jump_m + safety.max_speed_m_s * (state.stamp_s - before.stamp_s)
            if jumped:
                report(TroubleKind.ESTIMATE_JUMPED, f"its position estimate jumped by {moved:.2f} m")
        # Distance from the geofence, 0 inside.
        bounds = zip(self._fence[0], state.position, self._fence[1], strict=True)
        outside = math.hypot(*(max(low - x, 0.0, x - high) for low, x, high in bounds))
        if self._surely_far(robot, state, outside > safety.cut_outside_m, jumped=jumped):
            report(TroubleKind.FAR_OUTSIDE, f"it is {outside:.2f} m outside the geofence; its motors are cut", cut=True)
        elif outside > 0.0:
            report(TroubleKind.GEOFENCE, f"it is {outside:.2f} m outside the geofence")
        low = state.battery_v is not None and state.battery_v < self._low_v[robot]
        if self._lasts(self._low_since, robot, low, now, safety.low_battery_s):
            report(TroubleKind.BATTERY_LOW, f"its battery has {state.battery_v:.2f} V")
        if self._lasts(self._off_since, robot, airborne and off > safety.tracking_m, now, safety.off_course_s):
            report(TroubleKind.OFF_COURSE, f"it is {off:.2f} m from where its set-point leads it")
        return found

    def _surely_far(self, robot: int, state: RobotState, far: bool, *, jumped: bool) -> bool:
        """Whether motors may be cut: one estimate that jumped far out is no proof, the next one has to confirm it."""
        if not far:
            self._far_since.pop(robot, None)
            return False
        return state.stamp_s > self._far_since.setdefault(robot, state.stamp_s if jumped else -math.inf)

    @staticmethod
    def _lasts(since: dict[int, float], robot: int, holds: bool, now: float, long_s: float) -> bool:
        """Whether a condition has held for `long_s`."""
        if not holds:
            since.pop(robot, None)
            return False
        return now - since.setdefault(robot, now) >= long_s

    def _pairs(self, states: Sequence[RobotState], airborne: frozenset[int]) -> list[Trouble]:
        flying = sorted(airborne)
        if len(flying) < 2:
            return []
        safety, places = self._safety, [states[k].position for k in flying]
        distances = scipy.spatial.distance.pdist(flattened(places, safety.downwash)).tolist()
        nearest, (one, two) = min(zip(distances, combinations(flying, 2), strict=True))
        if nearest >= safety.min_separation_m:
            return []
        detail = f"{self._names[one]} and {self._names[two]} are {nearest:.3f} m apart"
        return [Trouble(TroubleKind.TOO_NEAR, robot=one, detail=detail)]
