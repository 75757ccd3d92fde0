"""What is watched in flight: what each drone says of itself, against what it was told. No clock and no robot in here.

Every trouble ends the flight. A drone is landed where that is safer than to let it fall, which is everywhere but far
outside the geofence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from scipy.spatial.distance import pdist

from llm_flock.robots.base import Position, RobotState
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.setpoints import Motion, squeezed

PERIOD_S = 0.05
"""Time between two looks [s]."""


class Kind(Enum):
    """Everything that ends a flight before its mission does."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """Something that ends the flight.

    Attributes:
        kind: what.
        robot: whose it is; None where it is everybody's.
        detail: in words.
        cut: drones whose motors are to be cut at once.
    """

    kind: Kind
    robot: int | None = None
    detail: str = ""
    cut: frozenset[int] = frozenset()


class Monitors:
    """Looks at everybody's state, again and again.

    Args:
        config: the limits.
        names: of the drones.
    """

    def __init__(self, config: FlightConfig, names: Sequence[str]) -> None:
        self._safety = config.safety
        self._fence = config.world.geofence
        self._names = names
        self._last: dict[int, RobotState] = {}
        self._low_since: dict[int, float] = {}
        self._off_since: dict[int, float] = {}

    def look(
        self, now_s: float, states: Sequence[RobotState], motions: Sequence[Motion], airborne: frozenset[int]
    ) -> list[Trouble]:
        """What is wrong now; the same trouble is told again as long as it lasts.

        Args:
            now_s: monotonic time [s].
            states: of all drones.
            motions: what each is flying.
            airborne: drones that have taken off and were not told to land; only these have to be where they were sent.
        """
        found: list[Trouble] = []
        for robot, (state, motion) in enumerate(zip(states, motions, strict=True)):
            found.extend(self._one(now_s, robot, state, motion, robot in airborne))
        found.extend(self._pairs(states, airborne))
        return found

    def _one(self, now: float, robot: int, state: RobotState, motion: Motion, airborne: bool) -> list[Trouble]:
        safety = self._safety
        found: list[Trouble] = []

        def tell(kind: Kind, detail: str, *, cut: bool = False) -> None:
            who = frozenset((robot,)) if cut else frozenset[int]()
            found.append(Trouble(kind=kind, robot=robot, detail=f"{self._names[robot]}: {detail}", cut=who))

        if state.link_lost:
            tell(Kind.LINK_LOST, "its link is lost")
        elif now - state.stamp_s > safety.stall_s:
            tell(Kind.ESTIMATE_STALLED, f"its last position estimate is {now - state.stamp_s:.2f} s old")
        before = self._last.get(robot)
        if before is None or state.stamp_s > before.stamp_s:
            self._last[robot] = state
        if before is not None and state.stamp_s > before.stamp_s:
            moved = math.dist(before.position, state.position)
            if moved > safety.jump_m + safety.max_speed_m_s * (state.stamp_s - before.stamp_s):
                tell(Kind.ESTIMATE_JUMPED, f"its position estimate jumped by {moved:.2f} m")
        outside = self._outside(state.position)
        if outside > safety.cut_outside_m:
            tell(Kind.FAR_OUTSIDE, f"it is {outside:.2f} m outside the geofence; its motors are cut", cut=True)
        elif outside > 0.0:
            tell(Kind.GEOFENCE, f"it is {outside:.2f} m outside the geofence")
        low = state.battery_v is not None and state.battery_v < safety.low_battery_v
        if self._lasts(self._low_since, robot, low, now, safety.low_battery_s):
            tell(Kind.BATTERY_LOW, f"its battery has {state.battery_v:.2f} V")
        off = math.dist(state.position, motion.at(state.stamp_s))
        if self._lasts(self._off_since, robot, airborne and off > safety.tracking_m, now, safety.off_course_s):
            tell(Kind.OFF_COURSE, f"it is {off:.2f} m from its set-point")
        return found

    def _outside(self, position: Position) -> float:
        """How far a position is outside the geofence [m]."""
        return math.hypot(
            *(max(a - x, 0.0, x - b) for a, x, b in zip(self._fence[0], position, self._fence[1], strict=True))
        )

    @staticmethod
    def _lasts(since: dict[int, float], robot: int, is_so: bool, now: float, long_s: float) -> bool:
        """Whether something has been so for so long."""
        if not is_so:
            since.pop(robot, None)
            return False
        return now - since.setdefault(robot, now) >= long_s

    def _pairs(self, states: Sequence[RobotState], airborne: frozenset[int]) -> list[Trouble]:
        flying = sorted(airborne)
        if len(flying) < 2:
            return []
        safety = self._safety
        distances = pdist(
            squeezed([states[k].position for k in flying], safety.min_separation_m, safety.downwash_m)
        ).tolist()
        pairs = [(i, j) for k, i in enumerate(flying) for j in flying[k + 1 :]]
        nearest, (one, two) = min(zip(distances, pairs, strict=True))
        if nearest >= safety.min_separation_m:
            return []
        detail = f"{self._names[one]} and {self._names[two]} are {nearest:.3f} m apart"
        return [Trouble(kind=Kind.TOO_NEAR, robot=one, detail=detail)]
