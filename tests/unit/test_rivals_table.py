"""The table of rivals: its figures, its two forms, and the files that the page shows."""

import csv
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks import rivals

import llm_flock
from llm_flock.mission import Mission

DATA = rivals.OUT.parent
ONE = rivals.Flown(formed=True, ratio=1.5, detour=1.2, separation=3.2, messages=2.0, bytes=100.0, calls=4, tokens=1000)
LOST = replace(ONE, formed=False, ratio=np.nan, detour=np.nan, separation=2.5, calls=8)
TEAM = ("circle", 10)


def read(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_distance_and_rounds_count_up_to_the_formation():
    given: dict[str, Any] = {"model": "simulated:canonical", "protocol": "baseline"}
    mission = Mission(shape="line", n_robots=2)
    below = [[45.0, 20.0], [55.0, 20.0]]
    straight = llm_flock.run(mission, start_positions=below, **given)
    found = rivals.figures_of(straight, 3.0, 40.0)
    assert (found.formed, found.ratio, found.messages, found.bytes) == (True, 1.0, 3.0, 40.0)
    assert found.detour == pytest.approx(1.0, abs=0.01) and found.separation == pytest.approx(10.0)
    crossed = llm_flock.run(mission, start_positions=below[::-1], **given)
    found = rivals.figures_of(crossed, 0.0, 0.0)
    assert found.ratio == pytest.approx(6 / 5) and found.detour == pytest.approx(np.hypot(30, 10) / 30, abs=0.01)
    lost = rivals.figures_of(llm_flock.run(mission, start_positions=below, rounds=3, **given), 0.0, 0.0)
    assert not lost.formed and np.isnan(lost.ratio)


def test_means_are_of_those_that_formed_and_costs_of_all():
    row = rivals.row("CAPT", TEAM, False, [ONE, ONE, LOST, LOST])
    assert row[rivals.FORMED] == "50 [15, 85]" and row[rivals.RATIO] == "1.50 [1.50, 1.50]"
    assert (row[rivals.NEAREST], row["trials below the safe distance"]) == ("2.500", 2)
    assert (row["model calls"], row["trials"], row["shield"]) == ("6.0", 4, "no")
    assert rivals.row("CAPT", TEAM, True, [LOST])[rivals.RATIO] == ""


def test_shielded_and_unshielded_rows_stand_side_by_side():
    table = [rivals.row("CAPT", TEAM, True, [ONE, ONE]), rivals.row("CAPT", TEAM, False, [LOST, LOST])]
    (line,) = rivals.side_by_side([*table, rivals.row("CAPT", ("square", 8), True, [LOST])], TEAM)
    assert line["rounds/bound"] == "1.50" and line["rounds/bound, no shield"] == ""
    assert line["formed (%)"] == "100 [34, 100]" and line["formed (%), no shield"] == "0 [0, 66]"
    assert line["smallest separation, no shield"] == "2.500" and line["model calls"] == "4.0"


SHIELDED = {name for name, options in rivals.OURS.items() if "protocol" not in options}


def test_ours_never_flies_without_its_shield():
    mission = Mission(shape="triangle", n_robots=3)
    for name, options in rivals.OURS.items():
        flown = rivals.ours(options, mission, False, 0)
        assert (flown is None) == (name in SHIELDED)
    shielded = rivals.ours({"protocol": "paper"}, mission, True, 1)
    assert shielded is not None and shielded.separation >= mission.safe_distance - 1e-6


@pytest.mark.parametrize("team", rivals.TEAMS)
def test_the_files_have_every_method(team: tuple[str, int]):
    rows = [row for row in read("rivals.csv") if (row["shape"], int(row["robots"])) == team]
    assert [row["method"] for row in rows if row["shield"] == "yes"] == [*rivals.METHODS]
    assert [row["method"] for row in rows if row["shield"] == "no"] == [m for m in rivals.METHODS if m not in SHIELDED]
    shown = read(f"rivals-{team[0]}.csv")
    assert [row["method"] for row in shown] == [*rivals.METHODS]
    given = {(row["method"], row["shield"]): row for row in rows}
    assert all(row[rivals.FORMED] == given[row["method"], "yes"][rivals.FORMED] for row in shown)
    assert all(row["trials below the safe distance"] == "0" for row in rows if row["shield"] == "yes")


def test_every_rival_has_its_source():
    assert [(row["method"], row["source"]) for row in read("rivals-sources.csv")] == [
        (row["method"], row["source"]) for row in rivals.sources()
    ]
    assert all(row["source"] and row["assumes"] for row in rivals.sources())
