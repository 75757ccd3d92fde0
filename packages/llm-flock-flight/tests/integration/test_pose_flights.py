"""Flights by positions from outside in simulated time: what ends them, and what keeps them on the ground."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from flights import figures, flight_config, yes

from llm_flock.errors import InputError
from llm_flock.robots._base import Pose, PoseFrame
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock_flight._flight import deadman, positions
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet, start_of
from llm_flock_flight._flight.flight import Flight, FlightResult
from llm_flock_flight._flight.sections import DroneConfig

pytestmark = pytest.mark.usefixtures("skipped_waits")


class Seen(SimulatedRobot):
    """A simulated robot that takes poses, and flies by its own estimate."""

    async def take_pose(self, pose: Pose) -> None:
        self._need_link()


def seen(config: FlightConfig, drones: Sequence[DroneConfig]) -> list[Seen]:
    """Their driver."""
    return [Seen(drone.name, start_of(config, drone), limits=config.driver_limits) for drone in drones]


class Cameras:
    """A motion capture that sees the robots which are not hidden, fifty times a second."""

    def __init__(self, robots: Sequence[SimulatedRobot]) -> None:
        self.refused = Counter[str]()
        self.hidden, self.frozen = set[str](), dict[str, Pose]()
        self._turn = 0
        self.offset = 0.0
        self.last: dict[str, Pose] = {}
        self._robots = robots
        self._task: asyncio.Task[None] | None = None

    async def open(self, take: Callable[[PoseFrame], None]) -> None:
        self._task = asyncio.create_task(self._look(take))

    async def _look(self, take: Callable[[PoseFrame], None]) -> None:
        while True:
            now = time.monotonic()
            rows = {r.name: r.body.position(now) for r in self._robots if r.name not in self.hidden}
            self._turn += 1
            noise = 1e-6 * (self._turn % 2)
            poses = {name: Pose((x + self.offset + noise, y, z)) for name, (x, y, z) in rows.items()}
            self.last = poses = {**poses, **self.frozen}
            take(PoseFrame(stamp_s=now, poses=poses))
            await asyncio.sleep(0.02)

    async def close(self) -> None:
        assert self._task is not None
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)


def config_of(**fields: Any) -> FlightConfig:
    """A flight whose poses a test provides."""
    config = flight_config(robot="test_pose_flights:seen", **fields)
    return config.model_copy(update={"positions": config.positions.model_copy(update={"pose_source": "udp"})})


def flown(act: Callable[[Cameras], None], at: str, **fields: Any) -> FlightResult:
    """A flight in which something happens to the cameras when a stage begins."""
    config = config_of(**fields)

    async def run() -> FlightResult:
        robots = seen(config, config.fleet.drones)
        cameras = Cameras(robots)
        flight = Flight(config, robots, poses=cameras, on_stage=lambda stage: act(cameras) if stage == at else None)
        return await flight.run(yes)

    return asyncio.run(run())


@pytest.mark.parametrize(("hidden", "named"), [({"d2"}, "d2"), ({"d0", "d1", "d2", "d3"}, "d0")])
def test_drone_without_poses_lands_all_and_is_named(hidden: set[str], named: str) -> None:
    flight = figures(flown(lambda cameras: cameras.hidden.update(hidden), "flying"))
    assert flight.ended == "pose_lost" and flight.reason == f"{named}: no position from outside for 0.5 s"
    assert set(flight.ends.values()) == {"landed"} and flight.air_s < 3.0


def test_frozen_pose_lands_all_drones_and_is_named() -> None:
    result = flown(lambda cameras: cameras.frozen.update(d1=cameras.last["d1"]), "flying")
    flight = figures(result)
    assert flight.ended == "pose_lost" and flight.safe and flight.air_s < 4.0
    assert flight.reason == "d1: no position from outside for 0.5 s; what comes is refused: frozen"
    assert list(flight.poses_refused or {}) == ["d1: frozen"]


def test_a_pose_that_is_frozen_keeps_the_drones_on_the_ground() -> None:
    def freeze(cameras: Cameras) -> None:
        cameras.frozen.update(d2=Pose((1.2, 1.2, 0.0)))

    result = flown(freeze, "connecting")
    failed = [check for check in result.report.checks if not check.passed]
    assert result.result is None and [check.who for check in failed] == ["d2"]
    assert "what comes is refused: frozen" in failed[0].found


def test_a_drone_that_is_not_seen_at_take_off_lands_too() -> None:
    flight = figures(flown(lambda cameras: cameras.hidden.add("d1"), "taking off", take_off_s=1.5))
    assert flight.ended == "pose_lost" and flight.safe


def test_no_take_off_if_poses_stop_before_the_confirmation() -> None:
    async def run() -> FlightResult:
        config = config_of()
        robots = seen(config, config.fleet.drones)
        cameras = Cameras(robots)

        async def late(_: object) -> bool:
            cameras.hidden.add("d3")
            await asyncio.sleep(1.0)
            return True

        return await Flight(config, robots, poses=cameras).run(late)

    flight = figures(asyncio.run(run()))
    assert flight.ended == "pose_lost" and set(flight.ends.values()) == {"never took off"}
    assert (flight.reason or "").startswith("d3: ")


def test_drone_seen_all_the_time_lands_after_its_mission() -> None:
    result = flown(lambda cameras: None, "flying")
    assert figures(result).ended == "mission" and figures(result).poses_refused == {}


def test_deadman_lands_with_poses_and_without_if_unavailable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether the source opens or not, the drones are landed; what is wrong is said."""
    opened: list[Cameras] = []

    def source(config: FlightConfig) -> Cameras:
        if opened:
            raise InputError("pose_port", 1, "a free port")
        opened.append(Cameras(robots))
        return opened[0]

    monkeypatch.setattr(positions, "pose_source", source)
    config, said = config_of(), list[str]()
    for turn in range(2):
        robots = seen(config, config.fleet.drones)

        async def run(robots: list[Seen]) -> dict[str, str]:
            for robot in robots:
                await robot.connect(1.0)
                await robot.arm()
                await robot.take_off(1.0, 0.4)
            await asyncio.sleep(0.5)
            return await deadman._land_with_poses(config, robots, said.append)

        assert set(asyncio.run(run(robots)).values()) == {"landed"}
        assert any("no positions from outside" in line for line in said) is (turn == 1)
    assert opened[0]._task is not None and opened[0]._task.cancelled()


def test_poses_contradicting_the_estimate_prevent_take_off() -> None:
    def shift(cameras: Cameras) -> None:
        cameras.offset = 0.2

    result = flown(shift, "connecting")
    failed = [check for check in result.report.checks if not check.passed]
    assert result.result is None and {check.name for check in failed} == {"position from outside"} and len(failed) == 4
    assert "0.20 m from the estimate" in failed[0].found


def test_without_a_source_there_is_neither_a_check_nor_a_figure() -> None:
    config = flight_config()
    result = asyncio.run(Flight(config, build_fleet(config)).run(yes))
    assert figures(result).poses_refused is None
    assert "position from outside" not in {check.name for check in result.report.checks}
