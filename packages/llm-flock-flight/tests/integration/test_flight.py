"""Whole flights of simulated drones, brisk and without the waits: the mission, and everything that may end it early."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import math
import resource
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import pytest
from flights import STOCK, Robots, Sabotage, figures, flight_config, flown, fly, trial
from slowness import slowness

from llm_flock.errors import RecordError
from llm_flock.planner import NoAnswer
from llm_flock.protocol import _geometry as geometry
from llm_flock.protocol._geometry import GeometryPlanner
from llm_flock.record._reader import read_record
from llm_flock.record._schema import CHANNELS, SummaryMessage, channel_schema
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock_flight._flight import landing
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.flight import Flight
from llm_flock_flight._flight.landing import FELL, STOPPED
from llm_flock_flight._flight.monitors import TroubleKind

pytestmark = pytest.mark.usefixtures("skipped_waits")


def test_a_square_is_formed_and_landed(tmp_path) -> None:
    result = flown(flight_config(out=str(tmp_path)))
    assert result.report.passed and trial(result).formed
    flight = figures(result)
    assert flight.ended == "mission" and flight.safe and set(flight.ends.values()) == {"landed"}
    assert (flight.min_separation_m or 0.0) >= 0.2
    assert flight.tracking_max_m is not None and flight.tracking_max_m < 0.05
    assert flight.fan_out_ms is not None and flight.fan_out_ms < 100 * slowness()
    record = read_record(tmp_path / "run.mcap")
    assert record.result is not None and record.result["flight"]["ends"] == flight.ends
    assert record.rounds == trial(result).summary.rounds == max(sample.round for sample in record.bodies)
    times = [sample.time_s for sample in record.bodies]
    assert all(0.05 < b - a < 1.0 for a, b in pairwise(times))
    kinds = [event.kind for event in record.flight]
    assert kinds.count("take_off") == kinds.count("aloft") == kinds.count("landing") == kinds.count("landed") == 4
    highest = max(row[2] for sample in record.bodies for row in sample.measured)
    assert 0.9 < highest < 1.1
    assert all(x <= 0.02 for _, _, x in record.bodies[0].measured)


def lose_link(flight: Flight, robots: Robots) -> None:
    robots[1].lose_link()


def lose_link_for_a_while(flight: Flight, robots: Robots) -> None:
    robot = robots[1]
    robot.lose_link()
    asyncio.get_running_loop().call_later(1.0, setattr, robot, "_lost", False)


def stall(flight: Flight, robots: Robots) -> None:
    """No estimate comes any more."""
    robot = robots[2]
    seen = robot.state()
    robot.state = lambda: seen


def jump(flight: Flight, robots: Robots) -> None:
    robots[0].body.jump((0.5, 0.5, 0.0), time.monotonic())


def frozen(flight: Flight, robots: Robots) -> None:
    """Estimates come, but they stand still while the drone is sent away."""
    robots[0].body.stall(time.monotonic())


def low_battery(flight: Flight, robots: Robots) -> None:
    robots[3].body.battery_v = 3.0


def outside(flight: Flight, robots: Robots) -> None:
    robots[0].body.jump((-5.0, 0.0, 0.0), time.monotonic())


def far_outside(flight: Flight, robots: Robots) -> None:
    robots[0].body.jump((-9.0, 0.0, 0.0), time.monotonic())


def too_near(flight: Flight, robots: Robots) -> None:
    """One is blown next to another."""
    now = time.monotonic()
    (ax, ay, az), (bx, by, bz) = (robots[k].body.position(now) for k in (0, 1))
    robots[0].body.jump((bx - ax + 0.1, by - ay, bz - az), now)


def refuse(flight: Flight, robots: Robots) -> None:
    robots[2].body.armed = False


def abort(flight: Flight, robots: Robots) -> None:
    assert flight.abort()


def emergency(flight: Flight, robots: Robots) -> None:
    assert flight.emergency()


def nothing(flight: Flight, robots: Robots) -> None:
    pass


LANDED = {"landed"}


JUMPED = {TroubleKind.ESTIMATE_JUMPED, TroubleKind.OFF_COURSE}
"""An estimate that jumps also leaves its set-point, which a busy machine may see first."""


@pytest.mark.parametrize(
    ("sabotage", "at", "ended", "ends", "within_s"),
    [
        (lose_link_for_a_while, "round 1", {TroubleKind.LINK_LOST}, LANDED, 3.5),
        (stall, "round 1", {TroubleKind.ESTIMATE_STALLED}, {"landed", STOPPED}, 6.0),
        (jump, "round 1", JUMPED, LANDED, 2.0),
        (frozen, "round 1", {TroubleKind.OFF_COURSE}, {"landed", STOPPED}, 6.0),
        (low_battery, "round 1", {TroubleKind.BATTERY_LOW}, LANDED, 3.0),
        (outside, "round 1", {TroubleKind.GEOFENCE, *JUMPED}, LANDED, 2.0),
        (far_outside, "round 1", {TroubleKind.FAR_OUTSIDE, *JUMPED}, {"landed", "motors cut"}, 2.0),
        (too_near, "round 1", {TroubleKind.TOO_NEAR, *JUMPED}, LANDED, 2.0),
        (refuse, "round 1", {TroubleKind.REFUSED}, None, 12.0),
        (abort, "round 1", {TroubleKind.ABORT}, LANDED, 1.5),
        (abort, "taking off", {TroubleKind.ABORT}, {"never took off"}, 0.5),
        (emergency, "round 1", {TroubleKind.EMERGENCY}, {"motors cut"}, 0.5),
        (emergency, "landing", {TroubleKind.EMERGENCY}, {"motors cut"}, 6.0),
    ],
)
def test_every_fault_ends_with_all_drones_down_in_time(
    sabotage: Sabotage, at: str, ended: set[TroubleKind], ends: set[str] | None, within_s: float
) -> None:
    done: list[float] = []

    def act(flight: Flight, robots: Robots) -> None:
        done.append(time.monotonic())
        sabotage(flight, robots)

    result = flown(flight_config(reach_s=4.0, connect_s=1.0), act, at)
    assert done and time.monotonic() - done[0] < within_s
    flight = figures(result)
    assert flight.ended in {kind.value for kind in ended}
    if ends is not None:
        assert set(flight.ends.values()) == ends
    summary = trial(result).summary
    assert (summary.stopped, summary.reason) == (flight.ended, flight.reason) or at == "landing"


def test_drone_out_of_reach_is_named_and_the_others_landed(tmp_path) -> None:
    flight = figures(flown(flight_config(reach_s=1.5, connect_s=1.0, out=str(tmp_path)), lose_link))
    assert flight.ends == {"d0": "landed", "d1": "out of reach", "d2": "landed", "d3": "landed"}
    assert not flight.safe
    kinds = {event.kind: event for event in read_record(tmp_path / "run.mcap").flight}
    assert kinds["given_up"].robot == 1 and len(kinds["given_up"].detail["position"]) == 3
    assert kinds["link_lost"].robot == 1


@pytest.mark.parametrize(("shape", "n"), [("triangle", 3), ("square", 4), ("cross", 5), ("circle", 5)])
def test_default_flight_forms_and_lands_with_stock_controller(shape: str, n: int) -> None:
    """Drones are up to 20 cm and more behind their set-points, and 35 cm as they take off."""
    config = flight_config(n, shape, robot="flights:stock", **STOCK)
    assert config.safety == FlightConfig().safety
    flight = figures(flown(config))
    assert flight.ended == "mission" and set(flight.ends.values()) == {"landed"}
    assert (flight.min_separation_m or 0.0) >= 0.2
    assert flight.lag_s > 0.3
    assert flight.tracking_max_m is not None and flight.tracking_max_m < 0.04


def test_smallest_distance_covers_the_landing() -> None:
    """One comes within 0.1 m of another on the way down, by their own estimates, which the mission's end is not."""
    flight = figures(flown(flight_config(), too_near, "landing"))
    assert flight.ended == "mission" and (flight.min_separation_m or 1.0) < 0.12


def test_a_drone_whose_controller_changes_in_flight_is_noticed() -> None:
    def tune(flight: Flight, robots: Robots) -> None:
        robots[1].body.follow(None, time.monotonic())

    flight = figures(flown(flight_config(robot="flights:stock", **STOCK), tune))
    assert flight.ended == "off_course" and flight.safe and "d1: it is" in (flight.reason or "")


def test_drone_stopped_in_the_air_is_named_and_others_landed() -> None:
    def stop(flight: Flight, robots: Robots) -> None:
        robots[2].body.emergency_stop(time.monotonic())

    flight = figures(flown(flight_config(), stop))
    assert flight.ended == "fault" and flight.reason == "d2: it cannot fly any more: locked"
    assert flight.ends == {name: "landed" if name != "d2" else FELL for name in ("d0", "d1", "d2", "d3")}


def test_time_is_up() -> None:
    config = flight_config(max_flight_s=1.5, stop_when_formed=False, rounds=100)
    flight = figures(flown(config))
    assert flight.ended == "time_up" and flight.safe and flight.air_s < 4.0


class Mute(GeometryPlanner):
    """Answers the first question, and then never again."""

    async def step(self, question):
        await asyncio.sleep(3600)
        return NoAnswer(cause="timeout", reason="")


def test_a_model_that_falls_silent_ends_the_flight(monkeypatch) -> None:
    plain, count = geometry.GeometryPlanner, itertools.count()

    def made(rng: np.random.Generator) -> object:
        return (Mute if next(count) % 3 == 2 else plain)(rng)

    monkeypatch.setattr(geometry, "GeometryPlanner", made)
    config = {"model": "geometry", "think_s": 0.3, "silent_rounds": 2}
    flight = figures(flown(flight_config(**config, fallback="hold")))
    assert flight.ended == "model_silent" and flight.safe and "2 rounds in a row" in (flight.reason or "")


def test_a_process_that_stood_still_does_not_blame_the_drones(monkeypatch) -> None:
    """Estimates come twelve times a second; ten times they are not read for 0.7 s, as on a busy machine."""
    plain, lost_s = time.monotonic, [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: plain() + lost_s[0])
    tasks: list[asyncio.Task[None]] = []

    async def keep_reading(robot: SimulatedRobot) -> None:
        look = robot.state
        seen = [look()]
        robot.state = lambda: seen[0]
        while True:
            await asyncio.sleep(0.083)
            seen[0] = look()

    async def stand_still() -> None:
        for k in range(10):
            await asyncio.sleep(0.2 + 0.013 * k)
            lost_s[0] += 0.7

    def act(flight: Flight, robots: Robots) -> None:
        loop = asyncio.get_running_loop()
        tasks.extend(loop.create_task(work) for work in (*map(keep_reading, robots), stand_still()))

    flight = figures(flown(flight_config(), act))
    assert flight.ended == "mission" and flight.safe


def test_a_set_point_that_breaks_a_limit_is_never_sent(monkeypatch) -> None:
    from llm_flock_flight._flight import setpoints

    sent: list[Sequence[float]] = []
    monkeypatch.setattr(setpoints.SetPointCheck, "faults", lambda *_: ["too fast"])
    plain = SimulatedRobot.go_to
    monkeypatch.setattr(SimulatedRobot, "go_to", lambda self, *args: (sent.append(args), plain(self, *args))[1])
    flight = figures(flown(flight_config()))
    assert flight.ended == "set_point" and flight.reason == "too fast" and flight.safe and not sent


@contextlib.contextmanager
def small_files(size: int) -> Iterator[None]:
    """Let no file grow beyond a size [bytes], as on a disc that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_flight_goes_on_when_its_record_cannot_be_written(tmp_path, caplog) -> None:
    seen: list[object] = []
    config = flight_config(out=str(tmp_path))
    size = len(json.dumps([channel_schema(model) for model in CHANNELS.values()])) + 40_000
    with small_files(size):
        result = flown(config, sink=lambda entry: seen.append(entry))
    flight = figures(result)
    assert trial(result).formed and flight.ended == "mission" and set(flight.ends.values()) == {"landed"}
    assert "cannot be written (File too large)" in str(result.broken_record)
    assert "the record ends here, and the robots fly on" in caplog.text
    record = read_record(tmp_path / "run.mcap")
    assert record.result is None and 0 < record.rounds < trial(result).summary.rounds
    assert isinstance(seen[-1], SummaryMessage), "a live viewer misses nothing"


def test_no_drone_takes_off_without_room_for_a_record(tmp_path) -> None:
    stages: list[str] = []
    with small_files(1000), pytest.raises(RecordError, match="cannot be written"):
        flown(flight_config(out=str(tmp_path)), lambda flight, robots: stages.append("up"), "taking off")
    assert not stages


def test_failed_preflight_prevents_take_off() -> None:
    def discharged(flight: Flight, robots: Robots) -> None:
        robots[1].body.battery_v = 3.5

    result = flown(flight_config(), discharged, "connecting")
    assert result.result is None and not result.report.passed
    failed = [check for check in result.report.checks if not check.passed]
    assert [(check.who, check.name) for check in failed] == [("d1", "battery")]
    assert str(failed[0]) == "d1: battery: 3.50 V, at least 3.80 V"


def test_unconfirmed_flight_does_not_start() -> None:
    async def no(report) -> bool:
        assert report.passed
        return False

    async def ask():
        config = flight_config()
        from llm_flock_flight._flight.fleet import build_fleet

        flight = Flight(config, build_fleet(config))
        assert not flight.abort() and not flight.emergency()
        return await flight.run(no)

    assert asyncio.run(ask()).result is None


def in_space(**fields):
    """Three drones, of which the mission puts one above another."""
    return flight_config(
        3,
        "points",
        {
            "points": [[0, 0, -4], [0, 0, 4], [8, 0, 0]],
            "center": [15, 15, 15],
            "arena": [[5, 5, 5], [25, 25, 25]],
            "spacing": 4,
            "downwash": 2.4,
            "sense_range": 20,
        },
        altitude_m=2.8,
        geofence=[[-3, -3, -0.5], [3, 3, 6]],
        max_speed_m_s=8.0,
        take_off_s=0.8,
        land_s=0.8,
        drones=[{"name": f"d{k}", "start": [0.8 * k - 0.8, 0.0]} for k in range(3)],
        **fields,
    )


@pytest.mark.parametrize("at_end", ["land", "return"])
def test_a_mission_in_space_is_formed_and_landed(at_end: str) -> None:
    robots: Robots = []
    result = flown(in_space(at_end=at_end), lambda flight, made: robots.extend(made), "landing")
    assert figures(result).safe and set(figures(result).ends.values()) == {"landed"}
    assert (figures(result).min_separation_m or 0.0) >= 0.2
    now = time.monotonic()
    spots = [robot.body.position(now) for robot in robots]
    at_home = [math.dist(spot, robot.body.home) <= 0.05 for spot, robot in zip(spots, robots, strict=True)]
    assert all(at_home) is (at_end == "return")
    assert len(spots) == 3 and all(z == 0.0 for _, _, z in spots)
    assert all(math.dist(a, b) >= 0.3 - 2e-3 for k, a in enumerate(spots) for b in spots[:k])


def test_landing_of_a_mission_in_space() -> None:
    """Drones above each other: the lower one first, and none on another."""
    config = in_space()
    low, high, aside = (0.0, 0.0, 1.0), (0.0, 0.0, 2.0), (1.0, 0.0, 1.5)
    groups = landing.plan_landing(config, {0: high, 1: low, 2: aside}, [])
    assert [[descent.robot for descent in group] for group in groups] == [[1], [2], [0]]
    last = groups[-1][0]
    assert last.via is not None and last.via[2] == high[2]
    assert (last.spot[0] ** 2 + last.spot[1] ** 2) ** 0.5 >= 0.3 - 1e-3
    side_by_side = landing.plan_landing(config, {0: low, 2: aside}, [(2.0, 0.0, 0.0)])
    assert [[descent.robot for descent in group] for group in side_by_side] == [[0, 2]]
    assert all(descent.via is None for descent in side_by_side[0])


def test_faultless_preflight_asks_no_question() -> None:
    assert trial(asyncio.run(fly(flight_config(), nothing))).formed
