"""A robot that another flies is left alone, and motors are not cut high above the floor."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from flights import STARTS, flight_config

from llm_flock.record._schema import NullWriter
from llm_flock.robots._base import DriverCheck, Position, RobotState, SelfChecked, TakenOver
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock_flight._flight import landing
from llm_flock_flight._flight.lag import LagTracker
from llm_flock_flight._flight.landing import LANDED, LOST, STOPPED, TAKEN, TOLD, Landing
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.monitors import Monitors, TroubleKind
from llm_flock_flight._flight.preflight import preflight
from llm_flock_flight._flight.setpoints import resting
from llm_flock_flight._flight.team import FlyingTeam

WHY = "its mode is Position"


class Stubborn(SimulatedRobot):
    """In the air at a height that its test decides, not its orders; a pilot may take it over."""

    def __init__(self, name: str, home: Position) -> None:
        super().__init__(name, home)
        self.heights: list[float] = [1.0]
        self.taken: str | None = None
        self.cut = False

    def state(self) -> RobotState:
        z = self.heights.pop(0) if len(self.heights) > 1 else self.heights[0]
        x, y, _ = super().state().position
        flying = not self.cut and z > 0.0
        return replace(super().state(), position=(x, y, z), flying=flying, armed=flying, taken_over=self.taken)

    async def land(self, height_m: float, duration_s: float) -> None:
        if self.taken is not None:
            raise TakenOver(self.name, self.taken)

    async def stop_motors(self) -> bool:
        self.cut = True
        return True

    def checks(self) -> tuple[DriverCheck, ...]:
        return (DriverCheck(name="its own", passed=self.taken is None, found=self.taken or "fine"),)


def landed(robot: Stubborn, monkeypatch: pytest.MonkeyPatch) -> str:
    """How one drone ends."""
    for name, seconds in (("MARGIN_S", 0.1), ("SINKS_S", 0.2), ("LOOK_S", 0.01), ("AGAIN_S", 0.05)):
        monkeypatch.setattr(landing, name, seconds)
    config = flight_config(1, "circle", reach_s=0.5, land_s=0.5, drones=[{"name": "d0", "start": STARTS[0]}])

    async def land() -> str:
        await robot.connect(1.0)
        log = FlightLog(config, NullWriter())
        team = FlyingTeam(config, [robot], log)
        team.aloft = {0}
        landing_all = Landing(config, team, log)
        await landing_all.land_all()
        assert 0 not in team.aloft or landing_all.ends[0] in (TOLD, LOST)
        return landing_all.ends[0]

    return asyncio.run(land())


def drone() -> Stubborn:
    return Stubborn("d0", (*STARTS[0], 0.0))


def test_a_drone_that_a_pilot_flies_is_neither_called_nor_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = drone()
    robot.taken = WHY
    assert landed(robot, monkeypatch) == TAKEN and not robot.cut


def test_a_drone_that_a_pilot_takes_while_it_sinks_is_not_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = drone()

    async def told(height_m: float, duration_s: float) -> None:
        robot.taken = WHY

    monkeypatch.setattr(robot, "land", told)
    assert landed(robot, monkeypatch) == TAKEN and not robot.cut


def test_a_drone_near_the_floor_that_does_not_stop_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = drone()
    robot.heights = [0.5]
    assert landed(robot, monkeypatch) == STOPPED and robot.cut


def test_a_drone_high_above_the_floor_is_not_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = drone()
    robot.heights = [2.4]
    assert landed(robot, monkeypatch) == TOLD and not robot.cut


def test_a_drone_that_sinks_slowly_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = drone()
    robot.heights = [3.0 - 0.025 * k for k in range(121)]  # takes twice as long as it was given
    assert landed(robot, monkeypatch) == LANDED and not robot.cut


def test_drone_flown_by_a_pilot_has_its_motors_left_alone() -> None:
    """One trouble that says so, and none that would cut its motors, far outside the geofence."""
    config = flight_config(1, "circle", drones=[{"name": "d0", "start": STARTS[0]}])
    far: Position = (50.0, 0.0, 1.0)
    state = RobotState(position=far, stamp_s=10.0, armed=True, flying=True)
    still = LagTracker(config).look([state], [resting(far)], [0])
    free = Monitors(config, ["d0"]).look(10.0, [state], still, frozenset({0}))
    assert any(trouble.cut for trouble in free)
    taken = Monitors(config, ["d0"]).look(10.0, [replace(state, taken_over=WHY)], still, frozenset({0}))
    assert [(trouble.kind, trouble.cut, trouble.detail) for trouble in taken] == [
        (TroubleKind.REFUSED, frozenset(), f"d0: {WHY}")
    ]


@pytest.mark.parametrize("taken", [None, WHY])
def test_checks_of_a_driver_are_part_of_the_preflight(taken: str | None) -> None:
    robot = drone()
    robot.heights, robot.taken = [0.0], taken
    assert isinstance(robot, SelfChecked) and not isinstance(SimulatedRobot("x", (0.0, 0.0, 0.0)), SelfChecked)
    config = flight_config(1, "circle", drones=[{"name": "d0", "start": STARTS[0]}], stall_s=60.0)
    report = asyncio.run(preflight(config, [robot]))
    own = [check for check in report.checks if check.name == "its own"]
    assert [(check.who, check.passed) for check in own] == [("d0", taken is None)]
    assert report.passed is (taken is None)
