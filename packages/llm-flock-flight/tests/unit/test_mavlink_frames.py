"""Frames of MAVLink: north, east, down and the world's east, north, up; places on the Earth."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.errors import InputError
from llm_flock_flight._mavlink.frames import Geodetic, LocalFrame, between, enu, ned_of

METRES = st.floats(-1000.0, 1000.0, allow_nan=False)
PLACES = st.tuples(METRES, METRES, METRES)


def test_north_is_y_east_is_x_and_down_is_minus_z() -> None:
    assert enu((1.0, 0.0, 0.0)) == (0.0, 1.0, 0.0)
    assert enu((0.0, 1.0, 0.0)) == (1.0, 0.0, 0.0)
    assert enu((0.0, 0.0, 1.0)) == (0.0, 0.0, -1.0)
    assert ned_of((1.0, 2.0, 3.0)) == (2.0, 1.0, -3.0)


def test_the_origin_of_a_vehicle_is_its_start() -> None:
    frame = LocalFrame(origin=(4.0, -2.0, 0.1))
    assert frame.to_world((0.0, 0.0, 0.0)) == (4.0, -2.0, 0.1)
    assert frame.to_world((3.0, 1.0, -1.5)) == pytest.approx((5.0, 1.0, 1.6))
    assert frame.to_ned((5.0, 1.0, 1.6)) == pytest.approx((3.0, 1.0, -1.5))


@given(origin=PLACES, place=PLACES)
def test_there_and_back(origin: tuple[float, float, float], place: tuple[float, float, float]) -> None:
    frame = LocalFrame(origin=origin)
    assert frame.to_world(frame.to_ned(place)) == pytest.approx(place, abs=1e-9)
    assert enu(ned_of(place)) == place


@given(a=PLACES, b=PLACES)
def test_distances_and_handedness_are_kept(a: tuple[float, float, float], b: tuple[float, float, float]) -> None:
    frame = LocalFrame(origin=(7.0, 8.0, 9.0))
    assert math.dist(frame.to_ned(a), frame.to_ned(b)) == pytest.approx(math.dist(a, b), abs=1e-6)


def place(latitude: float, longitude: float, altitude: float = 0.0) -> Geodetic:
    return Geodetic(latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude)


@pytest.mark.parametrize(
    ("latitude", "meridian_m", "parallel_m"),
    [
        (0.0, 110_574.3, 111_319.5),
        (45.0, 111_131.8, 78_846.8),
        (60.0, 111_412.2, 55_800.0),
        (-60.0, 111_412.2, 55_800.0),
    ],
)
def test_degrees_have_the_lengths_of_wgs_84(latitude: float, meridian_m: float, parallel_m: float) -> None:
    """Lengths of a degree from the usual tables for WGS 84."""
    east, north, up = between(place(latitude, 10.0, 400.0), place(latitude + 0.01, 10.01, 402.5))
    assert north * 100.0 == pytest.approx(meridian_m, rel=3e-5)
    assert east * 100.0 == pytest.approx(parallel_m, rel=3e-5)
    assert up == 2.5


def test_across_the_date_line() -> None:
    east, _, _ = between(place(0.0, 179.999), place(0.0, -179.999))
    assert east == pytest.approx(222.6, abs=0.1)


def test_far_places_and_absurd_ones_are_refused() -> None:
    with pytest.raises(InputError, match="within 10000 m"):
        between(place(47.0, 8.0), place(47.2, 8.0))
    for latitude, longitude in ((91.0, 0.0), (0.0, 181.0), (float("nan"), 0.0), (0.0, float("nan"))):
        with pytest.raises(InputError, match="expected degrees from"):
            place(latitude, longitude)
    with pytest.raises(InputError, match="altitude"):
        place(0.0, 0.0, float("inf"))
