"""The controllers and estimators of a Crazyflie, by the numbers of its parameters, and how far each lags behind.

Numbers: `ControllerType` in `src/modules/interface/controller/controller.h` and `StateEstimatorType` in
`src/modules/interface/estimator/estimator.h` of the firmware. Mellinger's, Brescianini's and Lee's controllers add the
set-point's velocity to their command; PID and INDI ask for a velocity by the distance to the set-point alone, so at
a steady speed they are behind by speed over gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from llm_flock.robots import Equipment

CONTROLLER, ESTIMATOR = "stabilizer.controller", "stabilizer.estimator"


@dataclass(frozen=True, slots=True)
class FirmwareController:
    """One controller: its name, and parameters with its gains [1/s] and its highest velocities [m/s], if it lags."""

    name: str
    gains: tuple[str, ...] = ()
    speeds: tuple[str, ...] = ()


CONTROLLERS: Mapping[int, FirmwareController] = MappingProxyType(
    {
        1: FirmwareController(
            "PID",
            ("posCtlPid.xKp", "posCtlPid.yKp", "posCtlPid.zKp"),
            ("posCtlPid.xVelMax", "posCtlPid.yVelMax", "posCtlPid.zVelMax"),
        ),
        2: FirmwareController("Mellinger"),
        3: FirmwareController("INDI", ("posCtrlIndi.K_xi_x", "posCtrlIndi.K_xi_y", "posCtrlIndi.K_xi_z")),
        4: FirmwareController("Brescianini"),
        5: FirmwareController("Lee"),
    }
)

ESTIMATORS: Mapping[int, str] = MappingProxyType({1: "complementary", 2: "Kalman", 3: "UKF"})

READ: tuple[str, ...] = (
    CONTROLLER,
    ESTIMATOR,
    *(name for controller in CONTROLLERS.values() for name in (*controller.gains, *controller.speeds)),
)
"""Parameters to read before a flight."""


def number_of(table: Mapping[int, FirmwareController | str], name: str) -> int:
    """The number of a controller or estimator by its name, in lower case."""
    names = {(entry if isinstance(entry, str) else entry.name).lower(): number for number, entry in table.items()}
    return names[name]


def equipment(values: Mapping[str, float], unwatched: tuple[str, ...], complaints: tuple[str, ...]) -> Equipment:
    """The equipment by the values of `READ`, of which those that the firmware lacks are missing."""
    wrong = list(complaints)
    name = lag_s = most = None
    if CONTROLLER in values:
        number = int(values[CONTROLLER])
        controller = CONTROLLERS.get(number)
        name = f"number {number}" if controller is None else controller.name
        if controller is not None:
            gains = [values[gain] for gain in controller.gains if gain in values]
            if len(gains) == len(controller.gains) and all(gain > 0.0 for gain in gains):
                lag_s = 1.0 / min(gains) if gains else 0.0
            most = min((values[speed] for speed in controller.speeds if speed in values), default=None)
    estimator = None
    if ESTIMATOR in values:
        number = int(values[ESTIMATOR])
        estimator = ESTIMATORS.get(number, f"number {number}")
        if number == 1:  # it knows heights only
            wrong.append(f"its estimator ({ESTIMATOR}) is {estimator}: set estimator = 'kalman' in the flight file")
    return Equipment(
        controller=name,
        estimator=estimator,
        lag_s=lag_s,
        max_speed_m_s=most,
        complaints=tuple(wrong),
        unwatched=unwatched,
    )
