"""Stated times within which a flight is safe after each failure. `python -m benchmarks flight-cases` measures them.

Safe means that every drone is on the floor with its motors off, or its motors were cut, or, while no radio reaches it,
it hovers at its last set-point, at the safe distance from all others.
"""

from __future__ import annotations

from dataclasses import dataclass

from llm_flock.robots import Equipment
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.lag import STOCK_LAG_S, lag_bound_s
from llm_flock_flight._flight.landing import AGAIN_S, CALL_S, CONNECT_S, MARGIN_S
from llm_flock_flight._flight.monitors import PERIOD_S
from llm_flock_flight._flight.supervisor import CUT_TRY_S

SEND_MARGIN_S = 1.0
"""Longest time until a command has arrived, repeated where packets are lost, or has failed [s]."""


ROUTER_S = 3.0
"""Longest wait of the deadman for ROS's router, which may be gone too [s]."""


WATCHDOG_S = 1.0
"""Silence after which the firmware's emergency stop watchdog stops the motors [s]."""


@dataclass(frozen=True, slots=True)
class ReactionTime:
    """A failure, what the flight does, and the time until every drone is safe, for drones side by side."""

    case: str
    does: str
    stated_s: float


def reaction_times(config: FlightConfig) -> dict[str, ReactionTime]:
    """Every failure's reaction, by the name that the benchmark gives it."""
    safety, fleet = config.safety, config.fleet
    look, down = 2 * PERIOD_S, SEND_MARGIN_S + safety.land_s + MARGIN_S
    all_land = "all drones land"
    lag_s = lag_bound_s(config, (Equipment(lag_s=STOCK_LAG_S),))
    link_s = max(safety.stall_s, 1.0)
    reached = 2 * AGAIN_S + 2 * min(fleet.connect_s, CONNECT_S)
    called_s = 3 * min(fleet.connect_s, CONNECT_S) + CALL_S  # a first call, and a second that may take twice as long
    waits = safety.silent_rounds * (safety.think_s + safety.round_s + safety.settle_s)
    unseen_s = config.positions.pose_lost_s + look + down + CUT_TRY_S  # its estimate may say nothing of its landing
    router_s = ROUTER_S if config.positions.pose_source == "ros2" else 0.0
    rows = {
        "link_returns": (
            "The link to one drone is lost, and comes back",
            "the others land; the drone is called until it answers, then lands (counted from its return)",
            reached + down,
        ),
        "radio_pause": (
            "The radio to one drone pauses for 2 s",
            "it flies its segment to the end by itself; the others land, and it does when it is heard (from then on)",
            reached + down,
        ),
        "radio_second": (
            "The radio to one drone pauses for 1 s in mid-motion, with `stall_s` 1.5",
            "it flies its segment to the end by itself, and the flight goes on (until it is at its way-point)",
            safety.round_s + lag_s,
        ),
        "link_gone": (
            "The link to one drone is lost for good",
            "the others land; the drone hovers at its last set-point until its battery is empty, and is named",
            link_s + look + down + safety.reach_s + SEND_MARGIN_S,
        ),
        "estimate_jumps": ("A position estimate jumps", all_land, look + down),
        "estimate_stalls": (
            "A position estimate stands still in a moving drone",
            all_land,
            safety.round_s + lag_s + safety.off_course_s + look + down,
        ),
        "estimate_stops": ("Position estimates stop coming", all_land, safety.stall_s + look + down + CUT_TRY_S),
        "battery_low": ("A battery is low", all_land, safety.low_battery_s + 0.5 + look + down),
        "controller_changes": (
            "The controller of one drone changes in flight",
            all_land,
            2 * (safety.round_s + safety.settle_s + lag_s) + safety.off_course_s + look + down,
        ),
        "controller_unknown": ("A drone has a controller that nobody knows", "nothing takes off", 0.0),
        "drones_swapped": ("Two drones take each other's position for their own", all_land, look + down),
        "pose_lost": ("A motion capture sees one drone no more", all_land, unseen_s),
        "pose_frozen": (
            "A motion capture repeats the last pose of one drone",
            all_land,
            config.positions.pose_frozen_s + unseen_s,
        ),
        "markers_swapped": ("A motion capture takes two drones for each other", all_land, unseen_s),
        "tumbles": ("A drone tumbles in the air", "it falls; the others land", look + down),
        "model_silent": ("A model does not answer", all_land, waits + look + down),
        "geofence": ("A drone leaves the geofence", all_land, look + down),
        "far_outside": ("A drone is far outside the geofence", "its motors are cut; the others land", look + down),
        "too_near": ("Two drones come too near each other", all_land, look + down),
        "abort": ("The operator's abort key", all_land, down),
        "emergency": ("The operator's emergency stop", "all motors are cut, and each drone confirms it", CUT_TRY_S),
        "power_lost": (
            "Flight and deadman die together, as when the power fails, with `stop_watchdog`",
            "the firmware stops all motors; the drones fall",
            WATCHDOG_S + look,
        ),
        "killed": (
            "The flight process is killed",
            "the deadman calls the drones in the air, and lands them",
            2 * SEND_MARGIN_S + router_s + called_s + down,
        ),
        "hangs": (
            "The flight process hangs",
            "the deadman ends it, and does the same",
            fleet.deadman_s + 2 * SEND_MARGIN_S + router_s + called_s + down,
        ),
    }
    return {name: ReactionTime(case, does, seconds) for name, (case, does, seconds) in rows.items()}
