"""What stand-ins do when the computer of a flight loses its power: flight and deadman die in the same moment."""

from __future__ import annotations

import pytest

pytest.importorskip("cflib")

from benchmarks import flight_cases


@pytest.mark.parametrize(("watchdog", "ends"), [(False, "0 fell, 4 hover"), (True, "4 fell, 0 hover")])
def test_nothing_lands_them_and_the_watchdog_lets_them_fall(
    monkeypatch: pytest.MonkeyPatch, watchdog: bool, ends: str
) -> None:
    monkeypatch.setattr(flight_cases, "HOVER_S", 4.0)
    row = flight_cases.case("power_lost", stop_watchdog=watchdog)
    assert row["ends"] == ends
    assert (row["took_s"] <= row["stated_s"]) is watchdog


def test_second_without_radio_stops_neither_motion_nor_flight() -> None:
    row = flight_cases.case("radio_second")
    assert row["ends"] == "4 landed" and row["took_s"] <= row["stated_s"]
