"""The flight file: what is refused before anything moves, and where a mission is in the world."""

from __future__ import annotations

import asyncio
import math
import random
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from flights import STARTS, flight_config
from pydantic import BaseModel

from llm_flock import plugins
from llm_flock.errors import InputError
from llm_flock.robots._base import PEAK_SPEED
from llm_flock.robots._segment import Segment
from llm_flock.runtime._mission_frame import MissionFrame
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.dry_run import dry_run
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.setpoints import SetPointCheck, resting

SPACE: dict[str, Any] = {
    "points": [[0, 0, -4], [0, 0, 4], [8, 0, 0]],
    "center": [15, 15, 15],
    "arena": [[5, 5, 5], [25, 25, 25]],
    "spacing": 4,
    "comm_range": 20,
    "downwash": 2.4,
}
IN_SPACE: dict[str, Any] = {
    "altitude_m": 2.8,
    "geofence": [[-3, -3, -0.5], [3, 3, 6]],
    "max_speed_m_s": 12.0,
    "take_off_s": 1.0,
    "land_s": 1.0,
    "drones": [{"name": f"d{k}", "start": [k - 1.0, 0.0]} for k in range(3)],
}


def test_field_names_are_unique_and_described() -> None:
    names: list[str] = []
    for info in FlightConfig.model_fields.values():
        assert isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel)
        names.extend(info.annotation.model_fields)
        assert all(field.description for field in info.annotation.model_fields.values())
    assert len(names) == len(set(names))


def called(*uris: str) -> list[dict[str, Any]]:
    """Drones in the corners, of which the first have these addresses."""
    drones: list[dict[str, Any]] = [{"name": f"d{k}", "start": start} for k, start in enumerate(STARTS)]
    for k, uri in enumerate(uris):
        drones[k] |= {"uri": uri, "system_id": k + 1}
    return drones


def with_start(*start: float, **fields: Any) -> list[dict[str, Any]]:
    """Drones in the corners, of which the first starts here, or has other fields."""
    return [{"name": "d0", "start": start or STARTS[0], **fields}, *called()[1:]]


@pytest.mark.parametrize(
    ("fields", "field", "says"),
    [
        ({"min_separation_m": 0.25}, "safe_distance", "0.35 m"),
        ({"tracking_m": 0.06}, "safe_distance", "3.2 units"),
        ({"scale_m": 0.09}, "safe_distance", "one unit is 0.09 m"),
        ({"round_s": 0.2}, "round_s", "2.1875"),
        ({"take_off_s": 0.1}, "take_off_s", "at least"),
        ({"land_s": 0.1}, "land_s", "at least"),
        ({"geofence": [[-1, -1, 0], [1, 1, 2]]}, "geofence", "a corner of the arena is at"),
        ({"geofence": [[-2, -2, 0], [2, 2, 1.02]]}, "geofence", "1) m"),
        ({"geofence": [[2, 2, 2], [-2, -2, 0]]}, "geofence", "two corners"),
        ({"floor_m": -0.6, "take_off_s": 1.0, "land_s": 1.0}, "floor_m", "z = -0.5 m"),
        ({"floor_m": 1.0}, "altitude_m", "above the floor"),
        ({"shield": False}, "shield", "on in a flight"),
        ({"kill": "1@2"}, "kill", "cannot be used in a flight"),
        ({"noise": 0.1}, "noise", "cannot be used in a flight"),
        ({"drones": [{"name": "a"}]}, "drones", "one for each"),
        ({"drones": [{"name": "a"}] * 4}, "drones", "two drones have this name"),
        ({"drones": [{"name": f"d{k}", "uri": "udp://x:1"} for k in range(4)]}, "drones", "two drones have this uri"),
        ({"drones": [{"name": f"d{k}", "start": [k / 5, 0]} for k in range(4)]}, "drones", "at least 0.3 m apart"),
        ({"crazyflies": "crazyflies.yaml"}, "drones", "either drones, or crazyflies"),
        (
            {"drones": with_start(-1.2, -1.2, 0.31)},
            "drones",
            "within 0.3 m of the floor at z = 0 m (here 0.31 m)",
        ),
        ({"altitude_m": 0.26}, "altitude_m", "at least 0.27 m: the lowest place is 0.26 m above the floor"),
        ({"low_battery_v": 3.9}, "low_battery_v", "at most ready_battery_v, 3.8 V"),
        ({"drones": with_start(low_battery_v=3.9)}, "low_battery_v", "at most ready_battery_v of d0, 3.8 V"),
        ({"drones": with_start(parameters={"a.b": math.nan})}, "drones.0.parameters.a.b", "a finite number"),
        ({"drones": [{"name": f"d{k}", "start": [k, 0]} for k in range(4)]}, "drones", "d2 at (2, 0) m"),
        ({"mission": {"obstacles": [{"center": [27, 3], "radius": 2}]}}, "drones", "(here in an obstacle)"),
        ({"mission": {"obstacles": [{"center": [24, 3], "radius": 2}]}}, "drones", "(here 0.10 m from an obstacle)"),
        ({"drones": called("udp://127.0.0.1:1", "udp://LOCALHOST:1/")}, "drones", "in other words"),
        ({"robot": "mavlink", "drones": called("udp://0.0.0.0:1", "udpin://[::]:1")}, "drones", "d1"),
        ({"robot": "mavlink", "drones": called("serial:///dev/a", "serial:///dev/a:9600")}, "drones", "in other words"),
    ],
)
def test_a_flight_that_cannot_be_safe_is_refused(fields: dict[str, Any], field: str, says: str) -> None:
    with pytest.raises(InputError) as raised:
        flight_config(**fields)
    assert raised.value.field == field and says in str(raised.value)


@pytest.mark.parametrize("robot", ["crazyflie", "mavlink"])
@pytest.mark.parametrize("uri", ["udp://127.0.0.1", "udp://127.0.0.1:0", "udp://127.0.0.1:65536", "raido://0/80", ""])
def test_a_dry_run_refuses_the_addresses_that_the_flight_would(robot: str, uri: str) -> None:
    config = flight_config(
        robot=robot, drones=called("udp://127.0.0.1:1", "udp://127.0.0.1:2", "udp://127.0.0.1:3", uri)
    )
    with pytest.raises(InputError, match="uri = "):
        asyncio.run(dry_run(config))


def test_the_vertical_rule() -> None:
    assert flight_config(3, "points", SPACE, **IN_SPACE).mission.height_apart == pytest.approx(7.2)
    with pytest.raises(InputError, match=r"at least 1\.17 m: the lowest place is 0\.15 m above the floor"):
        flight_config(3, "points", SPACE, **IN_SPACE | {"altitude_m": 1.15})
    with pytest.raises(InputError, match="downwash") as raised:
        flight_config(3, "points", SPACE, **IN_SPACE | {"downwash": 2.0})
    assert raised.value.field == "downwash"


def test_the_speed_limit_is_that_of_the_middle_of_a_step() -> None:
    limit = PEAK_SPEED * 0.6 / 3.0
    flight_config(max_speed_m_s=limit, round_s=3.0, take_off_s=6.0, land_s=6.0)
    with pytest.raises(InputError, match="round_s"):
        flight_config(max_speed_m_s=0.99 * limit, round_s=3.0, take_off_s=6.0, land_s=6.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_there_and_back(dim: int) -> None:
    rng = random.Random(dim)
    for _ in range(100):
        frame = MissionFrame(
            anchor=tuple(rng.uniform(-50, 50) for _ in range(dim)),
            scale_m=rng.uniform(0.01, 2),
            yaw=rng.uniform(-7, 7),
            origin=(rng.uniform(-5, 5), rng.uniform(-5, 5)),
            altitude_m=rng.uniform(0.2, 3),
        )
        one, two = (tuple(rng.uniform(-100, 100) for _ in range(dim)) for _ in range(2))
        assert frame.to_mission(frame.to_world(one)) == pytest.approx(one, abs=1e-9)
        assert math.dist(frame.to_world(one)[:2], frame.to_world(two)[:2]) == pytest.approx(
            frame.scale_m * math.dist(one[:2], two[:2])
        )
        assert frame.to_world(frame.anchor) == pytest.approx((*frame.origin, frame.altitude_m))
    quarter = MissionFrame(anchor=(0, 0), scale_m=0.1, yaw=math.pi / 2, origin=(1, 2), altitude_m=1)
    assert quarter.to_world((10, 0)) == pytest.approx((1, 3, 1))


def test_set_points_are_checked_singly_and_against_each_other() -> None:
    config = flight_config(max_speed_m_s=1.0, round_s=2.0, take_off_s=3.0, land_s=3.0)
    check = SetPointCheck(config)
    here = [(-1.0, -1.0, 1.0), (1.0, 1.0, 1.0)]
    assert check.faults(here, here, 2.0) == []
    assert check.faults(here, [(-1.0, -0.1, 1.0), here[1]], 2.0) == []
    for there, says in (
        ([(-1.0, 0.0, 1.0), here[1]], "m/s on the way"),
        ([(-7.0, -1.0, 1.0), here[1]], "geofence"),
        ([(math.nan, -1.0, 1.0), here[1]], "no place"),
    ):
        seconds = 2.0 if "m/s" in says else 60.0
        assert any(says in fault and "robot 0" in fault for fault in check.faults(here, there, seconds))
    swapped = check.faults(here, here[::-1], 60.0)
    assert len(swapped) == 1 and "0.000 m" in swapped[0]
    above = [(0.0, 0.0, 1.0), (0.0, 0.0, 1.89)]
    assert "two set-points" in check.faults(above, above, 2.0)[0]
    assert check.faults(above, [(0.0, 0.0, 1.0), (0.0, 0.0, 1.91)], 2.0)  # it begins too near
    higher = [(0.0, 0.0, 1.0), (0.0, 0.0, 1.91)]
    assert check.faults(higher, higher, 2.0) == []


def test_set_points_move_as_the_drones_do() -> None:
    motion = Segment(start=(0.0, 0.0, 1.0), target=(1.0, 0.0, 1.0), duration_s=2.0, began_s=10.0)
    assert motion.at(5.0)[0] == (0.0, 0.0, 1.0) and motion.at(12.0)[0] == motion.target == (1.0, 0.0, 1.0)
    (x, _, _), (speed, _, _), _ = motion.at(11.0)
    assert x == pytest.approx(0.5) and speed == pytest.approx(PEAK_SPEED / 2)
    step = 1e-4
    assert (motion.at(11.0 + step)[0][0] - motion.at(11.0 - step)[0][0]) / (2 * step) == pytest.approx(PEAK_SPEED / 2)
    assert resting((1.0, 2.0, 3.0)).at(-1e9)[0] == (1.0, 2.0, 3.0)


def test_drones_of_crazyflies_yaml(tmp_path: Path) -> None:
    pytest.importorskip("cflib")
    file = tmp_path / "crazyflies.yaml"
    rows = "".join(
        f"  cf{k}:\n    enabled: true\n    uri: udp://127.0.0.1:{5000 + k}\n"
        f"    initial_position: [{x}, {y}, 0.0]\n    type: cf21\n"
        for k, (x, y) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1)))
    )
    file.write_text(
        f"fileversion: 3\nrobots:\n{rows}robot_types:\n  cf21:\n    motion_capture: {{tracking: none}}\n"
        "all:\n  firmware_params: {stabilizer: {estimator: 2}}\n"
    )
    settings = flight_config(crazyflies=str(file), drones=[], robot="crazyflie")
    assert [drone.name for drone in settings.fleet.drones] == ["cf0", "cf1", "cf2", "cf3"]
    assert settings.fleet.drones[2].start == (1, 1, 0)
    assert settings.fleet.drones[0].parameters == {"stabilizer.estimator": 2}
    assert [robot.name for robot in build_fleet(settings)] == ["cf0", "cf1", "cf2", "cf3"]


@pytest.mark.parametrize("robot", ["tricycle", "llm_flock.robots._base:nothing", "no.such.module:make"])
def test_a_driver_that_is_not_there(robot: str) -> None:
    with pytest.raises(InputError, match="robot"):
        build_fleet(flight_config(robot=robot))
    with pytest.raises(InputError, match="robot"):
        asyncio.run(dry_run(flight_config(robot=robot)))


def test_a_driver_is_a_plug_in_and_a_wrong_name_gets_a_hint(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="did you mean 'crazyflie'"):
        build_fleet(flight_config(robot="crazyfly"))
    entry = EntryPoint("tricycle", "flights:one_by_one", "llm_flock.robots")
    monkeypatch.setattr(plugins, "entries", lambda _kind: {"tricycle": entry})
    assert len(build_fleet(flight_config(robot="tricycle"))) == 4


def test_own_driver_makes_a_robot_for_each_drone() -> None:
    made = build_fleet(flight_config(robot="flights:one_by_one"))
    assert [robot.name for robot in made] == ["d0", "d1", "d2", "d3"]


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("llm_flock.robots:SimulatedRobot", ""),  # a class
        ("llm_flock.robots:PEAK_SPEED", ""),  # a number
        ("flights:only_one", ", 4 here (not SimulatedRobot)"),
        ("flights:too_few", ", 4 here (not 3)"),
    ],
)
def test_class_that_makes_no_robot_per_drone_is_explained(name: str, wrong: str) -> None:
    with pytest.raises(InputError) as caught:
        build_fleet(flight_config(robot=name))
    expected = "expected a function (config, drones) that returns a robot for each drone"
    assert (caught.value.field, caught.value.says) == ("robot", expected + wrong)


def test_crazyflie_needs_an_address_simulated_drone_a_start() -> None:
    with pytest.raises(InputError, match="uri"):
        build_fleet(flight_config(robot="crazyflie"))
    with pytest.raises(InputError, match="start"):
        build_fleet(flight_config(drones=[{"name": f"d{k}"} for k in range(4)]))


def mavlink_config(drones: list[Any] | None = None, **fields: Any) -> FlightConfig:
    places = ((-1.2, -1.2), (1.2, -1.2), (1.2, 1.2), (-1.2, 1.2))
    listed = [
        {"name": f"d{k}", "uri": "udp://0.0.0.0:14540", "system_id": k + 1, "start": place}
        for k, place in enumerate(places)
    ]
    return flight_config(robot="mavlink", drones=drones or listed, **fields)


def test_vehicles_at_one_address_differ_by_their_system_ids() -> None:
    robots = build_fleet(mavlink_config())
    assert [(robot.name, robot.system_id) for robot in robots] == [("d0", 1), ("d1", 2), ("d2", 3), ("d3", 4)]  # type: ignore[attr-defined]
    same = [{"name": f"d{k}", "uri": "udp://0.0.0.0:14540", "system_id": 1 + k % 3} for k in range(4)]
    with pytest.raises(InputError, match="system_id = 1: expected one that no other drone at udp"):
        mavlink_config(same)


def test_mavlink_needs_a_start_or_an_origin_for_positions() -> None:
    drones = [{"name": f"d{k}", "uri": f"udp://0.0.0.0:{14540 + k}"} for k in range(4)]
    with pytest.raises(InputError, match="a start for each drone"):
        build_fleet(mavlink_config(drones))
    assert len(build_fleet(mavlink_config(drones, local_frames="common"))) == 4
    assert len(build_fleet(mavlink_config(drones, origin_lat_lon_alt=[47.4, 8.5, 490.0]))) == 4
    with pytest.raises(InputError, match="latitude"):
        build_fleet(mavlink_config(drones, origin_lat_lon_alt=[91.0, 8.5, 490.0]))
    with pytest.raises(InputError, match="no use with origin_lat_lon_alt"):
        build_fleet(mavlink_config(drones, origin_lat_lon_alt=[47.4, 8.5, 490.0], local_frames="common"))


def test_a_vehicle_needs_an_address_and_keeps_its_parameters() -> None:
    with pytest.raises(InputError, match="a uri for each drone"):
        build_fleet(mavlink_config([{"name": f"d{k}", "system_id": k + 1} for k in range(4)]))
    one = {"name": "d0", "uri": "udp://0.0.0.0:14540", "start": [0, 0], "parameters": {"a.b": 1.0}}
    rest = [{"name": f"d{k}", "uri": f"udp://0.0.0.0:{14540 + k}", "start": [k / 2, k / 2]} for k in range(1, 4)]
    with pytest.raises(InputError, match="cannot be set by MAVLink"):
        build_fleet(mavlink_config([one, *rest]))


@pytest.mark.parametrize("name", ["flight.toml", "flight_mavlink.toml"])
def test_the_examples_are_flights(name: str) -> None:
    example = Path(__file__).parents[4] / "examples" / name
    settings = FlightConfig.load(example)
    assert len(settings.fleet.drones) == settings.mission.n_robots == 4


@pytest.mark.parametrize(("name", "n"), [("triangle3", 3), ("square4", 4), ("cross5", 5), ("circle5", 5)])
def test_the_papers_flights_are_flown_by_stand_ins(name: str, n: int) -> None:
    settings = FlightConfig.load(Path(__file__).parents[4] / "experiments" / "flights" / f"{name}.toml")
    assert f"{settings.mission.shape}{settings.mission.n_robots}" == name
    assert len(settings.fleet.drones) == n and settings.fleet.robot == "simulated"


def test_a_missing_library_is_named_when_a_vehicle_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    robot = build_fleet(mavlink_config())[0]
    with pytest.raises(InputError, match="needs the extra mavlink"):
        asyncio.run(robot.connect(1.0))


@pytest.mark.parametrize(("stall_s", "link_timeout_s"), [(0.5, 1.0), (1.5, 1.5)])
def test_a_link_is_not_given_up_before_the_flight_gives_it_up(stall_s: float, link_timeout_s: float) -> None:
    pytest.importorskip("cflib")
    drones = [{"name": f"d{k}", "uri": f"udp://127.0.0.1:{19850 + k}", "start": [k / 2, k / 2]} for k in range(4)]
    robots = build_fleet(flight_config(robot="crazyflie", stall_s=stall_s, drones=drones))
    assert {vars(robot)["_link_timeout_s"] for robot in robots} == {link_timeout_s}
