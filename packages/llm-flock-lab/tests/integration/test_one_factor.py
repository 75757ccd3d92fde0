"""A sweep that changes one thing at a time: it goes on where it ended, with the rows of one that was never stopped."""

from __future__ import annotations

from pathlib import Path

import polars as pl
from polars.testing import assert_frame_equal
from sweeps import results

from llm_flock_lab._experiments.sweep import fly_sweep
from llm_flock_lab._experiments.sweep_file import load_sweep
from llm_flock_lab._report.findings import pair_lines, usual_reference
from llm_flock_lab._report.results import Results

FILE = """
[sweep]
name = "factors"
seeds = 2

[grid]
team = ["triangle/3"]
factor = [
    { name = "default" },
    { name = "out: search", without = "search" },
    { name = "bursts", loss = 0.3, burst = 5 },
    { name = "in: baseline", protocol = "baseline", rounds = 10 },
    { name = "models: 2 err alike", model = "0=simulated:ideal,1-=simulated:distorted@0.5,alike" },
]
"""


def test_a_sweep_of_factors_goes_on_with_the_same_rows(tmp_path: Path) -> None:
    path = tmp_path / "factors.toml"
    path.write_text(FILE)
    assert fly_sweep(load_sweep(path, seeds=1), tmp_path / "twice", executor="one").finished == 5
    (tmp_path / "twice" / "trials" / ".cut.json.1.partial").write_text('{"id": ')  # what a killed process leaves
    assert fly_sweep(load_sweep(path), tmp_path / "twice", executor="one").complete
    assert fly_sweep(load_sweep(path), tmp_path / "once", executor="one").complete
    for twice, once in zip(results(tmp_path / "twice"), results(tmp_path / "once"), strict=True):
        assert_frame_equal(twice, once, check_exact=True)

    found = Results.read(tmp_path / "once")
    assert usual_reference(found) == "factor=default"
    lines = {line.cell.condition: line for line in pair_lines(found, "factor=default")}
    assert len(lines) == 4 and all(line.formed.pairs == 2 for line in lines.values())
    assert lines["factor in: baseline"].formed.only_second == 2
    formed = found.frame.filter(pl.col("formed"))
    assert (formed["distance_flown"] >= formed["distance_least"] - 1.5).all() and formed["formed_twice_tolerance"].all()
