"""One estimate that jumps far outside the geofence ends the flight; motors are cut when the next one confirms it."""

from __future__ import annotations

import math

from llm_flock.robots._base import Position, RobotState
from llm_flock.robots._segment import Segment
from llm_flock_flight._crazyflie.telemetry import Telemetry
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.lag import LagTracker
from llm_flock_flight._flight.monitors import Monitors, TroubleKind

HOME: Position = (0.0, 0.0, 1.0)
WILD: Position = (50.0, 0.0, 1.0)


def kinds(*estimates: Position) -> list[set[TroubleKind]]:
    """What the monitors find at each estimate; each is looked at twice."""
    config = FlightConfig.build(
        {
            "mission": {
                "shape": "line",
                "n_robots": 2,
                "center": [20, 20],
                "arena": [[0, 0], [40, 40]],
                "comm_range": 60,
            }
        }
    )
    monitors, tracker = Monitors(config, ["a"]), LagTracker(config)
    rest = Segment(start=HOME, target=HOME, duration_s=1.0)
    found: list[set[TroubleKind]] = []
    for k, place in enumerate(estimates):
        state = RobotState(position=place, stamp_s=0.05 * k, armed=True, flying=True)
        tracking = tracker.look([state], [rest], [0])
        looks = [monitors.look(0.05 * k + 0.02 * again, [state], tracking, frozenset({0})) for again in range(2)]
        assert all(bool(t.cut) == (t.kind is TroubleKind.FAR_OUTSIDE) for look in looks for t in look)
        found.append({t.kind for look in looks for t in look})
    return found


def test_one_wild_estimate_cuts_nothing() -> None:
    steady, wild, back = kinds(HOME, WILD, HOME)
    assert not steady
    assert wild == {TroubleKind.ESTIMATE_JUMPED, TroubleKind.GEOFENCE}
    assert back == {TroubleKind.ESTIMATE_JUMPED}


def test_the_next_estimate_confirms_it() -> None:
    assert TroubleKind.FAR_OUTSIDE in kinds(HOME, WILD, WILD)[2]
    farther = (60.0, 0.0, 1.0)  # one that jumps on is still far outside
    assert TroubleKind.FAR_OUTSIDE in kinds(HOME, WILD, farther)[2]


def test_a_drone_that_flies_out_is_cut_at_once() -> None:
    places = [(6.98 + 0.04 * k, 0.0, 1.0) for k in range(3)]
    assert [TroubleKind.FAR_OUTSIDE in found for found in kinds(*places)] == [False, True, True]


def test_a_crazyflies_estimate_that_is_no_number_grows_old() -> None:
    """An estimator that diverges says so; what its supervisor says, and the battery, are still read."""
    log = Telemetry()
    good = {
        "stateEstimate.x": 1.0,
        "stateEstimate.y": 2.0,
        "stateEstimate.z": 0.5,
        "supervisor.info": 3,
        "pm.vbat": 4.0,
    }
    log.take_position(good, 5.0)
    log.take_position({**good, "stateEstimate.y": math.nan, "supervisor.info": 7, "pm.vbat": 3.5}, 6.0)
    assert (log.position, log.stamp_s, log.info, log.battery_v) == ((1.0, 2.0, 0.5), 5.0, 7, 3.5)
    log.take_position({**good, "pm.vbat": math.nan}, 7.0)
    assert log.stamp_s == 7.0 and log.battery_v is None
