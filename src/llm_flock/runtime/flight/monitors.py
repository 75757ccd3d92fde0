"""Monitors of a flight: compare every drone's state with its command and the limits. Reads no clock and no robot.

Every trouble ends the flight. A drone is landed wherever that is safer than a fall: everywhere but far outside the
geofence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

from scipy.spatial.distance import pdist

from llm_flock.robots.base import RobotState
from llm_flock.robots.segment import Segment
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.setpoints import scale_heights

PERIOD_S = 0.05
"""Time between two checks [s]."""


class TroubleKind(Enum):
    """Reasons to end a flight before its mission."""

    LINK_LOST = "link_lost"
    ESTIMATE_STALLED = "estimate_stalled"
    ESTIMATE_JUMPED = "estimate_jumped"
    OFF_COURSE = "off_course"
    BATTERY_LOW = "battery_low"
    GEOFENCE = "geofence"
    FAR_OUTSIDE = "far_outside"
    TOO_NEAR = "too_near"
    MODEL_SILENT = "model_silent"
    SET_POINT = "set_point"
    TIME_UP = "time_up"
    REFUSED = "refused"
    UNWATCHED = "unwatched"
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
        self._last: dict[int, RobotState] = {}
        self._low_since: dict[int, float] = {}
        self._off_since: dict[int, float] = {}

    def look(
        self, now_s: float, states: Sequence[RobotState], motions: Sequence[Segment], airborne: frozenset[int]
    ) -> list[Trouble]:
        """Every trouble at this moment; one that lasts is returned again by every call.

        Only drones in `airborne`, that have taken off and were not told to land, are held to their set-points.
        """
        found: list[Trouble] = []
        for robot, (state, motion) in enumerate(zip(states, motions, strict=True)):
            found += self._one(now_s, robot, state, motion, robot in airborne)
        return found + self._pairs(states, airborne)

    def _one(self, now: float, robot: int, state: RobotState, motion: Segment, airborne: bool) -> list[Trouble]:
        safety = self._safety
        found: list[Trouble] = []

        def report(kind: TroubleKind, detail: str, *, cut: bool = False) -> None:
            who = frozenset((robot,)) if cut else frozenset[int]()
            found.append(Trouble(kind, robot=robot, detail=f"{self._names[robot]}: {detail}", cut=who))

        if state.link_lost:
            report(TroubleKind.LINK_LOST, "its link is lost")
        elif now - state.stamp_s > safety.stall_s:
            report(TroubleKind.ESTIMATE_STALLED, f"its last position estimate is {now - state.stamp_s:.2f} s old")
        before = self._last.get(robot)
        if before is None or state.stamp_s > before.stamp_s:
            self._last[robot] = state
        if before is not None and state.stamp_s > before.stamp_s:
            moved = math.dist(before.position, state.position)
            if moved > safety.jump_m + safety.max_speed_m_s * (state.stamp_s - before.stamp_s):
                report(TroubleKind.ESTIMATE_JUMPED, f"its position estimate jumped by {moved:.2f} m")
        # Distance from the geofence, 0 inside.
        bounds = zip(self._fence[0], state.position, self._fence[1], strict=True)
        outside = math.hypot(*(max(low - x, 0.0, x - high) for low, x, high in bounds))
        if outside > safety.cut_outside_m:
            report(TroubleKind.FAR_OUTSIDE, f"it is {outside:.2f} m outside the geofence; its motors are cut", cut=True)
        elif outside > 0.0:
            report(TroubleKind.GEOFENCE, f"it is {outside:.2f} m outside the geofence")
        low = state.battery_v is not None and state.battery_v < safety.low_battery_v
        if self._lasts(self._low_since, robot, low, now, safety.low_battery_s):
            report(TroubleKind.BATTERY_LOW, f"its battery has {state.battery_v:.2f} V")
        off = math.dist(state.position, motion.at(state.stamp_s)[0])
        if self._lasts(self._off_since, robot, airborne and off > safety.tracking_m, now, safety.off_course_s):
            report(TroubleKind.OFF_COURSE, f"it is {off:.2f} m from its set-point")
        return found

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
        distances = pdist(scale_heights(places, safety.min_separation_m, safety.downwash_m)).tolist()
        nearest, (one, two) = min(zip(distances, combinations(flying, 2), strict=True))
        if nearest >= safety.min_separation_m:
            return []
        detail = f"{self._names[one]} and {self._names[two]} are {nearest:.3f} m apart"
        return [Trouble(TroubleKind.TOO_NEAR, robot=one, detail=detail)]
