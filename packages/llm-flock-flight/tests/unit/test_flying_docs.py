"""docs/how-to/flying.md says what the code promises."""

from __future__ import annotations

import asyncio
import csv
import re
import tomllib
from pathlib import Path

import pytest
from benchmarks.autopilot_faults import FAULTS
from benchmarks.autopilots import DRONES
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


def test_shipped_flights_formed_and_landed_or_say_why_not() -> None:
    rows = measured("autopilot-flights.csv")
    kinds = {"triangle 3", "square 4", "cross 5", "circle 5"}
    for drones, least_m, most_m in ((DRONES["ardupilot"], 0.8, 0.35), (DRONES["crazyflie"], 0.2, 0.05)):
        mine = [row for row in rows if row["Drones"] == drones]
        assert {row["Flight"] for row in mine} == kinds and {row["Monitors"] for row in mine} == {
            "as shipped",
            "halved",
        }
        for row in mine:
            early = [int(why.split()[0]) for why in row["Ended early"].split(" / ") if why]
            assert int(row["Formed and landed"]) + sum(early) == int(row["Runs"]), row
            assert row["Monitors"] == "halved" or not early, row
            assert float(row["Smallest distance [m]"]) >= least_m and float(row["Off then, rms [m]"]) < most_m, row


def test_every_fault_of_an_autopilot_was_flown() -> None:
    rows = {row["Name"]: row for row in measured("autopilot-faults.csv")}
    assert rows.keys() == FAULTS.keys()
    for name, row in rows.items():
        assert row["What is done"] == FAULTS[name].does and row["Fault"] == FAULTS[name].title
        assert float(row["Others down [s]"] or 0.0) < 25.0 and float(row["All down or safe [s]"] or 0.0) < 30.0, name
        assert row["Ended"].startswith("mission") is (row["What is done"] == "the mission is flown"), name


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
