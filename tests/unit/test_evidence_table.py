"""The tables of the evidence: trials that all cells have flown, pairs with the default, one family of tests."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from benchmarks import evidence
from sample_results import SEEDS, trial

from llm_flock_lab._experiments.store import Store
from llm_flock_lab._report.findings import pair_lines, usual_reference
from llm_flock_lab._report.results import Results

FACTORS = {"default": "flock", "loss 0.3": "flock", "out: everything": "paper"}


def flown(folder: Path, missing: int = 0) -> Results:
    """Two teams; a factor has `missing` trials fewer, and without everything no team forms."""
    for shape, n in (("circle", 10), ("triangle", 6)):
        for name, protocol in FACTORS.items():
            for seed in range(SEEDS - missing * (name == "loss 0.3")):
                changes = {"id": f"{shape}{seed}-{len(name)}", "axes": {"factor": name}, "cell": f"{shape} {name}"}
                Store(folder).save(trial(shape, n, protocol, seed, **changes))
    return Results.read(folder)


def test_a_value_of_an_axis_is_the_reference(tmp_path: Path) -> None:
    results = flown(tmp_path)
    assert usual_reference(results) == "factor=default"
    lines = {(line.cell.team.shape, line.cell.condition): line for line in pair_lines(results, "factor=default")}
    assert len(lines) == 4, "each team has two cells beside the default, which stands for itself"
    worse = lines["circle", "factor out: everything"]
    assert worse.formed.difference.value == -1.0 and worse.formed.p_value == pytest.approx(2 / 2**SEEDS)
    same = lines["triangle", "factor loss 0.3"]
    assert same.formed.difference.value == 0.0 and same.formed.p_value == 1.0
    assert [line.cell.condition for line in pair_lines(results, "paper")] == []


def test_tables_hold_the_seeds_that_all_cells_have_flown(tmp_path: Path) -> None:
    flown(tmp_path, missing=1)
    evidence.main(tmp_path, tmp_path / "evidence.csv")
    with (tmp_path / "evidence.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert [(row["factor"], row["shape"], row["trials"]) for row in rows] == [
        (name, shape, str(SEEDS - 1)) for name in FACTORS for shape in ("circle", "triangle")
    ]
    worse = rows[4]
    assert (worse["formed %"].split()[0], worse["difference of formed"].split()[0]) == ("0", "\N{MINUS SIGN}100")
    # Exact tests of five pairs give 1/16; four of them in a family, two of which are this one.
    assert worse["p of formed"] == worse["p of rounds"] == "0.250" and rows[0]["p of formed"] == ""
    with (tmp_path / "evidence-parts.csv").open() as lines:
        assert [row["factor"] for row in csv.DictReader(lines)] == ["default", "out: everything"]
    with (tmp_path / "evidence-conditions.csv").open() as lines:
        assert [row["factor"] for row in csv.DictReader(lines)] == ["default", "loss 0.3"]


def test_what_is_surely_different_has_a_star() -> None:
    row: evidence.Row = {"shape": "circle", "formed %": "50", "rounds": "9.0", "trials too near": 2}
    table = [row | {"factor": "default", "p of formed": "", "p of rounds": ""}]
    table.append(row | {"factor": "out: x", "p of formed": "< 0.001", "p of rounds": "0.051"})
    shown = evidence.beside_each_other(table, parts=True)
    assert [line["circle: formed %"] for line in shown] == ["50", "50 *"]
    assert [line["circle: rounds"] for line in shown] == ["9.0", "9.0"] and shown[1]["circle: too near"] == 2
