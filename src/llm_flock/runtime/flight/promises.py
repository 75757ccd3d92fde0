"""In what time a flight is in a safe state after each thing that may go wrong: stated here, measured by the benchmark.

Safe is: every drone is on the floor with its motors off; or its motors were cut; or, as long as no radio reaches it, it
hovers at its last set-point, which is at the safe distance from everybody's.
"""

from __future__ import annotations

from dataclasses import dataclass

from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.guard import CUT_TRY_S
from llm_flock.runtime.flight.landing import AGAIN_S, CONNECT_S, MARGIN_S
from llm_flock.runtime.flight.monitors import PERIOD_S

SEND_MARGIN_S = 1.0
"""Commands are sent again where packets are lost; after so long they have arrived, or have failed [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Promise:
    """What is done about one thing that may go wrong.

    Attributes:
        case: what happens.
        does: what the flight does about it.
        stated_s: from then until everybody is safe, drones side by side [s].
    """

    case: str
    does: str
    stated_s: float


def promises(config: FlightConfig) -> dict[str, Promise]:
    """What is promised for each case, by the name that the benchmark gives it."""
    safety, fleet = config.safety, config.fleet
    look, down = 2 * PERIOD_S, SEND_MARGIN_S + safety.land_s + MARGIN_S
    everybody = "everybody lands"
    link_s = max(safety.stall_s, 1.0)
    reached = 2 * AGAIN_S + 2 * min(fleet.connect_s, CONNECT_S)
    waits = safety.silent_rounds * (safety.think_s + safety.round_s + safety.settle_s)
    rows = {
        "link_returns": (
            "The link to one drone is lost, and comes back",
            "everybody else lands; the drone is called until it answers, and lands (counted from its return)",
            reached + down,
        ),
        "link_gone": (
            "The link to one drone is lost for good",
            "everybody else lands; the drone hovers at its last set-point until its battery is empty, and is named",
            link_s + look + down + safety.reach_s + SEND_MARGIN_S,
        ),
        "estimate_jumps": ("A position estimate jumps", everybody, look + down),
        "estimate_stalls": (
            "A position estimate stands still in a moving drone",
            everybody,
            safety.round_s + safety.off_course_s + look + down,
        ),
        "estimate_stops": ("No position estimate comes any more", everybody, safety.stall_s + look + down + CUT_TRY_S),
        "battery_low": ("A battery is low", everybody, safety.low_battery_s + 0.5 + look + down),
        "model_silent": ("A model does not answer", everybody, waits + look + down),
        "geofence": ("A drone leaves the geofence", everybody, look + down),
        "far_outside": ("A drone is far outside the geofence", "its motors are cut; everybody else lands", look + down),
        "too_near": ("Two drones come too near each other", everybody, look + down),
        "abort": ("The operator's abort key", everybody, down),
        "emergency": ("The operator's emergency stop", "all motors are cut, which each drone confirms", CUT_TRY_S),
        "killed": (
            "The flight process is killed",
            "the deadman calls everybody who is in the air, and lands them",
            2 * SEND_MARGIN_S + fleet.connect_s + down,
        ),
        "hangs": (
            "The flight process hangs",
            "the deadman ends it, and does the same",
            fleet.deadman_s + 2 * SEND_MARGIN_S + fleet.connect_s + down,
        ),
    }
    return {name: Promise(case=case, does=does, stated_s=seconds) for name, (case, does, seconds) in rows.items()}
