"""Crazyswarm2's list of drones."""

from __future__ import annotations

import pytest

pytest.importorskip("cflib")
import yaml
from flights import flight_config

from llm_flock.errors import InputError
from llm_flock_flight._crazyflie.crazyflies_yaml import parse_crazyflies, read_crazyflies
from llm_flock_flight._flight.fleet import with_drones

TEXT = """
fileversion: 3
robots:
  cf1:
    enabled: true
    uri: radio://0/80/2M/E7E7E7E701
    initial_position: [0.0, 0.5, 0]
    type: small
    firmware_params:
      kalman:
        pNAcc_xy: 1.0
  cf2:
    enabled: true
    uri: udp://127.0.0.1:19850
    initial_position: [1e-1, 5e-1, 0.0]
    type: large
  cf3:
    enabled: false
    uri: nonsense
    type: unknown
robot_types:
  small:
    motion_capture: {enabled: true}
    battery: {voltage_warning: 3.8, voltage_critical: 3.7}
    firmware_params:
      kalman: {pNAcc_xy: 0.7, pNAcc_z: 0.9}
      stabilizer: {controller: 2}
  large:
    battery: {voltage_warning: 7.6}
all:
  firmware_logging: {enabled: true}
  battery: {voltage_critical: 3.0}
  firmware_params:
    stabilizer: {estimator: 2, controller: 1}
    locSrv: {extPosStdDev: 1e-3}
"""


def content(text=TEXT):
    return yaml.safe_load(text)


def test_a_robot_goes_before_its_type_and_its_type_before_all():
    one, two = parse_crazyflies(content())
    assert (one.name, one.uri, one.home) == ("cf1", "radio://0/80/2M/E7E7E7E701", (0.0, 0.5, 0.0))
    assert one.parameters == {
        "stabilizer.estimator": 2.0,
        "stabilizer.controller": 2.0,
        "locSrv.extPosStdDev": 0.001,
        "kalman.pNAcc_xy": 1.0,
        "kalman.pNAcc_z": 0.9,
    }
    assert two.parameters["stabilizer.controller"] == 1.0


def test_batteries_limit_what_takes_off_and_what_lands(tmp_path):
    """The limits are those of a battery at rest; in flight it has less, and the flight file's limit holds as well."""
    one, two = (drone.battery for drone in parse_crazyflies(content()))
    assert (one.voltage_warning, one.voltage_critical) == (3.8, 3.7)
    assert (two.voltage_warning, two.voltage_critical) == (7.6, 3.0)
    path = tmp_path / "crazyflies.yaml"
    path.write_text(TEXT.replace("[1e-1, 5e-1, 0.0]", "[1.0, 0.5, 0.0]"))
    first, second = with_drones(flight_config(2, "line", crazyflies=str(path))).fleet.drones
    assert (first.ready_battery_v, first.low_battery_v) == (3.8, pytest.approx(3.2))
    assert (second.ready_battery_v, second.low_battery_v) == (7.6, pytest.approx(3.2))


ZEROS = TEXT.replace("[0.0, 0.5, 0]", "[0, 0.0, 0]").replace("[1e-1, 5e-1, 0.0]", "[0.0, 0.0, 0.0]")


def test_starts_that_are_all_zero_are_measured(tmp_path, caplog):
    """With positions from outside only, and not where one start is known."""
    path = tmp_path / "crazyflies.yaml"
    path.write_text(ZEROS)
    config = flight_config(2, "line", crazyflies=str(path), pose_source="udp", robot="crazyflie")
    assert [drone.start for drone in config.fleet.drones] == [None, None]
    assert "drones start where they are measured" in caplog.text
    with pytest.raises(InputError, match=r"starts at least .* m apart"):
        flight_config(2, "line", crazyflies=str(path))
    path.write_text(ZEROS.replace("[0, 0.0, 0]", "[1.0, 0.5, 0]"))
    placed = flight_config(2, "line", crazyflies=str(path), pose_source="udp", robot="crazyflie")
    assert [drone.start for drone in placed.fleet.drones] == [(1.0, 0.5, 0.0), (0.0, 0.0, 0.0)]


def test_numbers_that_yaml_takes_for_text_are_numbers():
    assert content()["all"]["firmware_params"]["locSrv"]["extPosStdDev"] == "1e-3"
    assert parse_crazyflies(content())[1].home == (0.1, 0.5, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("fileversion: 3", "fileversion: 2", "fileversion"),
        ("type: small", "type: huge", "robots.cf1.type"),
        ("radio://0/80/2M/E7E7E7E701", "80", "robots.cf1.uri"),
        ("[0.0, 0.5, 0]", "[0.0, 0.5]", "robots.cf1.initial_position.2"),
        ("[0.0, 0.5, 0]", "[0.0, .nan, 0]", "robots.cf1.initial_position.1"),
        ("pNAcc_xy: 1.0", "pNAcc_xy: much", "robots.cf1.firmware_params.kalman.pNAcc_xy"),
        ("enabled: true", "enabled: false", "robots"),
        ("      kalman: {pNAcc_xy: 0.7, pNAcc_z: 0.9}", "      locSrv: 3", "robots.cf1.firmware_params.locSrv"),
    ],
)
def test_unusable_field_of_crazyflies_yaml_is_named(old, new, field):
    assert old in TEXT
    with pytest.raises(InputError) as caught:
        parse_crazyflies(content(TEXT.replace(old, new)))
    assert caught.value.field == field


def test_files(tmp_path):
    path = tmp_path / "crazyflies.yaml"
    with pytest.raises(InputError, match="can be read"):
        read_crazyflies(path)
    path.write_text("robots: [")
    with pytest.raises(InputError, match="can be read"):
        read_crazyflies(path)
    path.write_text("- a\n")
    with pytest.raises(InputError, match="a table"):
        read_crazyflies(path)
    path.write_text(TEXT)
    assert [drone.name for drone in read_crazyflies(path)] == ["cf1", "cf2"]


@pytest.mark.parametrize(
    "text",
    [
        "a: 2001-99-99",
        "a: " + "1" * 5000,
        "a: 59:" * 200 + "59.5",
        'a: !!int ""',
        'a: !!bool "x"',
        "robots: {a: {enabled: true, type: [b]}}",
    ],
    ids=range(6),
)
def test_no_content_ends_in_anything_but_a_refusal(tmp_path, text):
    """Odd values and tags."""
    path = tmp_path / "crazyflies.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_crazyflies(path)
    assert len(str(caught.value)) < 1000
