"""Small sweeps for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import polars as pl

from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.sweep_file import Sweep, load_sweep

SMALL = """
[sweep]
name = "small"
seeds = {seeds}
{sweep}
[grid]
team = ["triangle/3"]
protocol = ["flock", "baseline"]
{grid}
[run.trial]
rounds = 15
{more}
"""

CLOCK = ("wall_s", "latency_mean_s")
"""Columns that the clock decides."""


def small_file(folder: Path, *, seeds: int = 2, sweep: str = "", grid: str = "", more: str = "") -> Path:
    """A file with two cells."""
    path = folder / "small.toml"
    path.write_text(SMALL.format(seeds=seeds, sweep=sweep, grid=grid, more=more), encoding="utf-8")
    return path


def small(folder: Path, *, seeds: int = 2, sweep: str = "", grid: str = "", more: str = "", **overrides: Any) -> Sweep:
    """The same, read."""
    return load_sweep(small_file(folder, seeds=seeds, sweep=sweep, grid=grid, more=more), **overrides)


def results(folder: Path) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Both tables, without what the clock decides."""
    return tables.read_trials(folder).drop(CLOCK), tables.read_rounds(folder)
