"""What keeps drones on the floor, what ends a flight, and the words for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from flights import STARTS, flight_config

from llm_flock.robots._base import Equipment, RobotState
from llm_flock_flight._crazyflie.controllers import CONTROLLER, ESTIMATOR, equipment
from llm_flock_flight._flight.lag import Tracking
from llm_flock_flight._flight.monitors import Monitors, TroubleKind
from llm_flock_flight._flight.preflight import _pauses, look
from llm_flock_flight._pauses import own_pauses

NAMES = ["d0", "d1", "d2", "d3"]
GAINS = {f"posCtlPid.{axis}Kp": 2.0 for axis in "xyz"}
SPEEDS = {f"posCtlPid.{axis}VelMax": 1.0 for axis in "xyz"}
PID = equipment({CONTROLLER: 1, ESTIMATOR: 2, **GAINS, **SPEEDS}, (), ())
SLOW: dict[str, Any] = {"max_speed_m_s": 1.0, "round_s": 2.0, "take_off_s": 2.5, "land_s": 2.5}
READY = [RobotState(position=(x, y, 0.0), stamp_s=5.0, battery_v=4.0, equipment=PID) for x, y in STARTS]


def failed(states: list[RobotState], **fields: Any) -> list[str]:
    config = flight_config(**{**SLOW, **fields})
    return [str(check) for check in look(config, NAMES, states, 5.1) if not check.passed]


def but_one(**fields: Any) -> list[RobotState]:
    return [READY[0], replace(READY[1], **fields), *READY[2:]]


def test_stock_drones_may_fly() -> None:
    assert failed(READY) == []
    checks = look(flight_config(**SLOW), NAMES, READY, 5.1)
    assert next(check.found for check in checks if check.name == "controller") == "PID, 0.5 s behind"


@pytest.mark.parametrize("fault", ["locked: restart it", "tumbled", "crashed: recover it"])
def test_a_drone_that_cannot_fly_keeps_all_on_the_floor(fault: str) -> None:
    assert failed(but_one(fault=fault)) == [f"d1: ready: {fault}, ready to fly"]


def test_parameter_that_was_not_accepted_is_reported() -> None:
    wrong = replace(PID, complaints=("stabilizer.controller is 1, though it was set to 2",))
    assert failed(but_one(equipment=wrong))[0].startswith("d1: ready: stabilizer.controller is 1")


def test_unknown_controller_is_refused_unless_its_lag_is_given() -> None:
    strange = [replace(state, equipment=equipment({CONTROLLER: 9}, (), ())) for state in READY]
    assert (
        failed(strange)[0] == "d0: controller: number 9, a controller whose lag is known, or lag_s in the flight file"
    )
    assert failed(strange, lag_s=0.5) == []


@pytest.mark.parametrize(("longest_s", "passed", "warned"), [(0.1, True, False), (0.8, True, True), (1.3, False, True)])
def test_own_pauses_are_held_against_the_limit(monkeypatch, longest_s: float, passed: bool, warned: bool) -> None:
    monkeypatch.setattr(own_pauses(), "longest_s", longest_s)
    (check,) = _pauses(flight_config(robot="flights:one_by_one", deadman=True))
    assert check.passed is passed and ("WARNING" in check.found) is warned
    assert f"at most {longest_s:.2f} s in " in check.found and "less than 1.2 s" in check.asked
    assert not list(_pauses(flight_config())), "no deadman would take over"


def test_the_estimator_without_positions_is_refused() -> None:
    heights = equipment({ESTIMATOR: 1}, (), ())
    assert "complementary" in failed(but_one(equipment=heights))[0]


def test_a_drone_that_stands_too_near_to_an_obstacle_is_refused() -> None:
    """Its start is clear of it by 2 cm; it stands 5 cm nearer, which is near enough to its start."""
    near: dict[str, Any] = {"obstacles": [{"center": [23.3, 3.0], "radius": 2}]}
    assert failed(READY, mission=near) == []
    (said,) = failed(but_one(position=(1.15, -1.2, 0.0)), mission=near)
    assert said.startswith("d1: in the arena: 1.15, -1.20 m: 0.12 m from an obstacle, in the mission's arena, at least")


def test_drone_without_a_start_must_be_apart_from_other_starts() -> None:
    """It returns to where it stands, and another to its start: 5 cm nearer than that one stands."""
    drones: list[dict[str, Any]] = [{"name": f"d{k}", "start": start} for k, start in enumerate(STARTS)]
    drones[0] = {"name": "d0"}
    states = [replace(READY[0], position=(0.92, -1.2, 0.0)), replace(READY[1], position=(1.25, -1.2, 0.0)), *READY[2:]]
    assert failed(states, drones=drones) == [
        "team: apart: 0.28 m, at least 0.3 m between the start of d1 and d0",
    ]


def test_a_controller_that_falls_behind_is_refused() -> None:
    assert failed(READY, max_speed_m_s=1.2) == [
        f"{name}: controller: PID, for at most 1 m/s, one for max_speed_m_s, 1.2 m/s" for name in NAMES
    ]


def test_drones_that_do_not_lag_alike_are_refused() -> None:
    """At most the tracking error is gained: at 0.66 m/s that is a difference of 0.08 s."""
    fast = equipment({CONTROLLER: 2}, (), ())
    (said,) = failed(but_one(equipment=fast))
    assert said.startswith("team: in step: d1 is 0.33 m ahead of d3, at 0.66 m/s")
    near = replace(PID, lag_s=0.43)
    assert failed(but_one(equipment=near)) == []


def test_each_drone_has_its_own_battery_limits() -> None:
    drones: list[dict[str, Any]] = [{"name": f"d{k}", "start": start} for k, start in enumerate(STARTS)]
    drones[2] = {**drones[2], "ready_battery_v": 4.05, "low_battery_v": 3.6}
    assert failed(READY, drones=drones) == ["d2: battery: 4.00 V, at least 4.05 V"]
    config = flight_config(drones=drones, low_battery_s=0.5)
    monitors = Monitors(config, NAMES)
    low = [replace(state, battery_v=3.5) for state in READY]
    still = Tracking(delay_s=(0.0,) * 4, expected=tuple(s.position for s in READY), off_m=(0.0,) * 4)
    assert monitors.look(5.0, low, still, frozenset()) == []
    found = monitors.look(5.5, [replace(state, stamp_s=5.5) for state in low], still, frozenset())
    assert [(trouble.kind, trouble.robot) for trouble in found] == [(TroubleKind.BATTERY_LOW, 2)]


def test_preflight_names_what_is_not_watched() -> None:
    blind = replace(PID, unwatched=("its battery",))
    states = but_one(equipment=blind, battery_v=None)
    assert failed(states) == []
    checks = look(flight_config(**SLOW), NAMES, states, 5.1)
    assert [check.found for check in checks if check.name == "watched"] == ["all", "not its battery", "all", "all"]


@pytest.mark.parametrize(
    ("heard_s", "kind"),
    [
        (4.2, TroubleKind.LINK_LOST),
        (4.6, TroubleKind.LINK_LOST),
        (4.8, TroubleKind.ESTIMATE_STALLED),
        (4.95, TroubleKind.ESTIMATE_STALLED),
        (None, None),
    ],
)
def test_the_first_cause_is_named(heard_s: float | None, kind: TroubleKind | None) -> None:
    """Where nothing at all comes, it is the link; where only estimates do not come, it is those."""
    states = [replace(state, heard_s=4.95) for state in READY]
    states[3] = replace(states[3], stamp_s=4.2, heard_s=heard_s)
    still = Tracking(delay_s=(0.0,) * 4, expected=tuple(s.position for s in READY), off_m=(0.0,) * 4)
    found = Monitors(flight_config(), NAMES).look(5.0, states, still, frozenset(range(4)))
    assert [trouble.kind for trouble in found] == [kind or TroubleKind.ESTIMATE_STALLED]


def test_the_lag_of_each_controller() -> None:
    assert (PID.controller, PID.lag_s, PID.max_speed_m_s, PID.estimator) == ("PID", 0.5, 1.0, "Kalman")
    assert equipment({CONTROLLER: 1, **GAINS, "posCtlPid.yKp": 1.0}, (), ()).lag_s == 1.0
    assert equipment({CONTROLLER: 3, **{f"posCtrlIndi.K_xi_{axis}": 1.0 for axis in "xyz"}}, (), ()).lag_s == 1.0
    assert equipment({CONTROLLER: 3}, (), ()).lag_s is None
    assert equipment({CONTROLLER: 2}, (), ()).lag_s == 0.0
    assert equipment({}, (), ()) == Equipment()
