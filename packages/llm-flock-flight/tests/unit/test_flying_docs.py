"""docs/how-to/flying.md says what the code promises."""

from __future__ import annotations

import asyncio
import csv
import re
import tomllib
from pathlib import Path

import pytest
from benchmarks.flight_cases import ALL

from llm_flock_flight._cli.fly import WORD
from llm_flock_flight._cli.keyboard import CUT_KEYS, LAND_KEYS, RETURN_KEYS
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.dry_run import dry_run
from llm_flock_flight._flight.monitors import TroubleKind

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs" / "how-to" / "flying.md").read_text(encoding="utf-8")


def measured(name: str) -> list[dict[str, str]]:
    """The rows of a file of measured figures."""
    with (ROOT / "docs" / "data" / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_every_case_was_measured_within_its_stated_time() -> None:
    rows = measured("flight-cases.csv")
    assert {row["Name"] for row in rows} == set(ALL)
    for row in rows:
        assert float(row["Measured [s]"]) <= float(row["Stated [s]"]), row["Name"]


def test_all_of_the_paper_s_flights_landed() -> None:
    flights = measured("flights.csv")
    for row in flights:
        assert row["Runs"] == row["Formed"] == row["Landed"], row
        assert float(row["Smallest distance [m]"]) >= 0.2
    assert {row["Flight"] for row in flights} == {"triangle 3", "square 4", "cross 5", "circle 5"}
    assert f"all {sum(int(row['Runs']) for row in flights)} formed" in PAGE.replace("\n", " ")


def test_the_example_formed_and_landed_on_late_stand_ins() -> None:
    rows = measured("autopilot-flights.csv")
    assert {row["Flight"] for row in rows} == {"triangle 3", "square 4", "cross 5", "circle 5"}
    for row in rows:
        assert (row["Formed"], row["Landed"], row["Ended"]) == ("True", "True", "mission"), row
        assert float(row["Tracking, at most [m]"]) < 0.35 and float(row["Smallest distance [m]"]) >= 0.8


def test_page_lists_every_trouble_that_ends_a_flight() -> None:
    table = re.search(r"^\| Kind \|.*\n(?:^\|.*\n)+", PAGE, re.MULTILINE)
    assert table is not None
    assert set(re.findall(r"^\| `(\w+)` \|", table[0], re.MULTILINE)) == {kind.value for kind in TroubleKind}


def test_first_flight_of_one_drone_is_half_a_metre_to_middle() -> None:
    page = (ROOT / "docs" / "how-to" / "four-crazyflies.md").read_text(encoding="utf-8")
    (file,) = re.findall(r"^ +```toml\n(.*?)^ +```", page, re.MULTILINE | re.DOTALL)
    config = FlightConfig.model_validate(tomllib.loads(file))
    plan = asyncio.run(dry_run(config))
    assert not plan.faults and config.fleet.drones[0].start == (0.5, 0.0)
    assert plan.motions[-1].targets[0] == pytest.approx((0.0, 0.0, 1.0), abs=1e-3)


def test_keys_and_word_are_those_of_the_command() -> None:
    assert "**l** or the space bar" in PAGE and {"l", " "} <= LAND_KEYS
    assert "**r**" in PAGE and "r" in RETURN_KEYS
    assert "**x**" in PAGE and "x" in CUT_KEYS
    assert f"Type `{WORD}`" in PAGE
