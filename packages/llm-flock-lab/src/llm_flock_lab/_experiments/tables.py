"""The two tables of a sweep: a row for each trial, and a row for each round of each trial."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import polars as pl
from pydantic import AliasPath, BaseModel, Field

from llm_flock.errors import InputError, RecordError
from llm_flock.events import Origin
from llm_flock.printable import csv_cell
from llm_flock.validation import checked
from llm_flock_lab._experiments.store import TRIALS as TRIALS_FOLDER
from llm_flock_lab._experiments.store import read_trial, trial_files, write_whole
from llm_flock_lab._experiments.trial import TrialResult

AXIS = "axis_"  # prefix of the columns for further axes of a grid
WAYPOINTS = "waypoints_"  # prefix of the columns that count waypoints by their origin

KINDS: Mapping[type[pl.DataType], str] = {
    pl.String: "text",
    pl.Int64: "integer",
    pl.Float64: "number",
    pl.Boolean: "true or false",
}


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table; any of its values may be null. The data dictionary shows kind, unit and meaning."""

    name: str
    meaning: str
    unit: str = ""
    dtype: type[pl.DataType] = pl.String

    @property
    def kind(self) -> str:
        return KINDS[self.dtype]


_count = partial(Column, dtype=pl.Int64)
_number = partial(Column, dtype=pl.Float64)
_flag = partial(Column, dtype=pl.Boolean)

_ORIGINS = tuple(origin.value for origin in Origin if origin is not Origin.START)

TRIALS: tuple[Column, ...] = (
    Column("trial", "address of the trial, made of its resolved configuration; name of its file"),
    Column("cell", "everything but the seed, in a few words: trials of one cell differ in their seed only"),
    _count("seed", "seed of the trial; the same seed has the same starts in every cell of a shape and size"),
    Column("shape", "the mission's shape"),
    _count("n_robots", "team size N"),
    Column("protocol", "preset of rules"),
    Column("consensus", "rule that chose the plan"),
    Column("assignment", "rule that chose the places"),
    _flag("shield", "whether the safety shield was on"),
    Column("model", "models as configured"),
    Column("models", "the models that were asked, each once"),
    Column("answered_by", "the models that answered, by the names that their servers gave"),
    _flag("simulated", "whether any of them was a simulated stand-in"),
    Column("stopped", "why it ended: formed, rounds, budget, no_plan, no_answers or failed"),
    Column("reason", "the commonest or last failure, in words, where it ended by no_plan, no_answers or failed"),
    _flag("formed", "whether the formation was built (see Metrics); false for trials that broke off"),
    _flag("formed_by_models", "formed, and geometry stood in for no model's plan, waypoint or answer"),
    _flag("formed_half_tolerance", "as formed, with both tolerances halved"),
    _flag("formed_twice_tolerance", "as formed, with both tolerances doubled"),
    _count("plan_robot", "robot that proposed the plan in force at the end; null without one plan"),
    Column("plan_by", "who made that plan: a model, by its name, or geometry"),
    _flag("plan_taught", "whether that model was taught this plan; null where its source does not say"),
    Column("breakers_opened", "robots whose circuit breaker was open at any time"),
    _flag("cut", "the budget of the whole sweep ran out during the trial, so it says nothing about its cell"),
    _count("rounds", "motion rounds flown", "rounds"),
    _count("rounds_to_formed", "first round in which the formation stood; null if none did", "rounds"),
    _count("lower_bound_rounds", "lower bound of the rounds to build it; null without one plan", "rounds"),
    _number("distance_flown", "distance flown by all robots together", "units"),
    _number("distance_least", "least such distance from the starts to the plan; null without one that stands", "units"),
    _number("procrustes_mean", "mean distance to the ideal shape at the end; null without ideal", "units"),
    _number("procrustes_mean_squared", "mean squared distance to it", "units^2"),
    _number("min_separation", "smallest distance of two robots over the whole trial, along segments too", "units"),
    _number("nearest_read", "smallest distance of a robot as others sensed it; null if positions are exact", "units"),
    _count("start_violations", "pairs nearer than the safe distance at the start"),
    _count("rounds_to_separate", "first round at whose end these had come apart; null if they never did", "rounds"),
    _number("min_separation_after_start", "as min_separation, these pairs counted from when they came apart", "units"),
    _number("min_clearance", "smallest distance of a robot's centre to an obstacle; null without obstacles", "units"),
    _count("obstacle_violations", "rounds of robots with a moving obstacle too near", "rounds"),
    _count("steps_over_limit", "steps longer than max_step, which bodies flew up to there"),
    _number("center_distance", "distance of the robots' mean position from the mission's centre at the end", "units"),
    _number("safe_distance", "smallest distance allowed", "units"),
    _number("max_step", "longest move in a round", "units"),
    _number("spacing", "distance of neighbours in the formation", "units"),
    _count("plans_in_use", "different plans at the end"),
    _count("distinct_goals", "different goals at the end"),
    _count("awake", "robots at the end that have begun and have not died"),
    _count("robots_without_plan", "robots that never got a plan"),
    _count("gaps", "empty places at the end; null without one plan"),
    _count("spares", "robots awake at the end without a place; null without one plan"),
    _count("model_calls", "calls, retries of rejected answers included", "calls"),
    _count("calls_rejected", "answers that could not be used", "calls"),
    _count("calls_failed", "calls that got no answer", "calls"),
    Column("faults", "transport faults on the way, retried ones included: kind=count"),
    _count("tokens", "tokens in and out", "tokens"),
    _count("tokens_input", "tokens in", "tokens"),
    _count("tokens_output", "tokens out", "tokens"),
    _count("tokens_cached", "the part of tokens_input that came from the provider's cache", "tokens"),
    _number("cost_usd", "cost; null where the price of any call is not known", "US dollars"),
    _number("latency_mean_s", "mean duration of a call, waits included; null without calls", "s"),
    *(_count(f"{WAYPOINTS}{who}", f"waypoints flown whose origin is: {who}", "waypoints") for who in _ORIGINS),
    _count("messages_sent", "broadcasts", "messages"),
    _number("bytes_per_robot_round", "bytes broadcast per robot and round", "bytes"),
    Column("messages_rejected", "messages refused on receipt: reason=count"),
    Column("killed", "robots that died, and in which round: 3@12"),
    Column("joined", "robots that joined late or again, in the same form"),
    _count("missions", "missions of the trial"),
    _number("wall_s", "duration of the trial; it depends on the machine and its load", "s"),
    Column("error", "the error that broke the trial off; null without one"),
    _count("earlier_tries", "earlier tries, which the sweep's budget cut short or which broke off"),
    _number("earlier_cost_usd", "cost of the earlier tries; null where a price is not known", "US dollars"),
    Column("code", "version of the package that flew it, and revision of its checkout"),
    Column("record", "its record, relative to the directory; null where none was kept"),
)
"""Columns of trials.parquet; `axis_NAME` (text) follows for each further axis of the grid, in their order."""

ROUNDS: tuple[Column, ...] = (
    Column("trial", "the trial"),
    _count("round", "motion round, 0 at the start"),
    _number("error", "mean distance to the ideal shape; null without ideal or where it was not measured", "units"),
    _number("error_squared", "mean squared distance to it", "units^2"),
    _number("min_separation", "smallest distance of two robots in this round, along segments too", "units"),
    _count("plans_in_use", "different plans followed"),
    _count("distinct_goals", "different goals headed for"),
    _count("at_goal", "robots within 0.05 spacing of their goal", "robots"),
    _count("calls", "model calls so far", "calls"),
    _count("tokens", "tokens in and out so far", "tokens"),
    _number("cost_usd", "cost so far; null where a price is not known", "US dollars"),
)
"""Columns of rounds.parquet."""


def read_tables(folder: Path) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Both tables, built from the finished trials: trials by cell and seed, and their rounds in the same order."""
    if not (folder / TRIALS_FOLDER).is_dir():
        raise InputError("dir", str(folder), "a directory of results, as `llm-flock sweep` makes it")
    trials = load_all(folder)
    try:
        return _trials_frame(trials), _rounds_frame(trials)
    except (pl.exceptions.PolarsError, LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        says = f"not all trials have the fields of one ({type(error).__name__}: {error})"
        raise RecordError(f"{folder}: {says}") from None


def read_trials(folder: Path) -> pl.DataFrame:
    """The first of `read_tables`: a row for each finished trial."""
    return read_tables(folder)[0]


def read_rounds(folder: Path) -> pl.DataFrame:
    """The second of `read_tables`: a row for each round of each finished trial."""
    return read_tables(folder)[1]


def build_tables(folder: Path) -> None:
    """Write both tables as files, for other programs."""
    for name, frame in zip(("trials.parquet", "rounds.parquet"), read_tables(folder), strict=True):
        file = io.BytesIO()
        frame.write_parquet(file)
        write_whole(folder / name, file.getvalue())


def export_csv(folder: Path, out: Path) -> list[Path]:
    """Write `trials.csv` and `rounds.csv`; results come from anywhere, so every text is a `csv_cell`."""
    frames = dict(zip(("trials.csv", "rounds.csv"), read_tables(folder), strict=True))
    for name, frame in frames.items():
        head = io.StringIO()
        csv.writer(head, lineterminator="\n").writerow(map(csv_cell, frame.columns))
        texts = frame.select(pl.col(pl.String))
        plain = [pl.Series(one.name, [None if x is None else csv_cell(x) for x in one], pl.String) for one in texts]
        body = frame.with_columns(plain).write_csv(include_header=False)
        write_whole(out / name, (head.getvalue() + body).encode())
    return [out / name for name in frames]


class _TrialFields(BaseModel):
    """Settings of a finished trial on which tables and reports rely; it may come from anywhere."""

    shape: str = Field(validation_alias=AliasPath("mission", "shape"))
    n_robots: int = Field(ge=1, le=10**6, validation_alias=AliasPath("mission", "n_robots"))
    seed: int = Field(ge=0, lt=2**63, validation_alias=AliasPath("trial", "seed"))


def load_all(folder: Path) -> list[TrialResult]:
    """Read every finished trial, sorted by cell and seed."""
    trials = [read_trial(path) for path in list(trial_files(folder))]
    for trial in trials:
        try:
            checked(_TrialFields, trial.config)
        except InputError as error:
            raise RecordError(f"{folder}: trial {trial.id} is not valid ({error})") from None
    return sorted(trials, key=lambda t: (_natural(t.cell), t.config["trial"]["seed"], t.id))


def _trials_frame(trials: Sequence[TrialResult]) -> pl.DataFrame:
    schema: dict[str, type[pl.DataType]] = {column.name: column.dtype for column in TRIALS}
    schema.update({AXIS + name: pl.String for trial in trials for name in trial.axes})
    rows = [_row(trial) for trial in trials]
    if any(isinstance(row.get(name), list | dict) for row in rows for name in schema):
        raise TypeError("a list or a table as a value")  # polars takes gigabytes for one that is nested deeply
    return pl.DataFrame({name: [row.get(name) for row in rows] for name in schema}, schema=schema)


def _rounds_frame(trials: Sequence[TrialResult]) -> pl.DataFrame:
    columns: dict[str, list[Any]] = {column.name: [] for column in ROUNDS}
    for trial in trials:
        columns["trial"] += [trial.id] * len(trial.rounds["round"])
        for name in columns.keys() - {"trial"}:
            columns[name] += trial.rounds[name]
    return pl.DataFrame(columns, schema={column.name: column.dtype for column in ROUNDS})


def _row(trial: TrialResult) -> dict[str, Any]:
    """The values of one trial, by column; names that are no columns are ignored."""
    config, costs = trial.config, [earlier.cost_usd for earlier in trial.earlier]
    summary: Mapping[str, Any] = trial.summary or {}
    opened = summary.get("breakers_opened")
    own = ("cell", "simulated", "stopped", "formed", "cut", "error", "code", "record")
    return {
        **summary,
        **{f"{WAYPOINTS}{origin}": (summary["waypoints"].get(origin, 0) if summary else None) for origin in _ORIGINS},
        **{name: _counts(summary.get(name)) for name in ("faults", "messages_rejected")},
        **{name: _words(summary.get(name)) for name in ("models", "answered_by", "killed", "joined")},
        "breakers_opened": None if opened is None else _words(map(str, opened)),
        "missions": len(summary["missions"]) if summary else None,
        "trial": trial.id,
        "seed": config["trial"]["seed"],
        "model": config["model"]["model"],
        **{name: config["mission"][name] for name in ("shape", "n_robots", "safe_distance", "max_step", "spacing")},
        **{name: config["protocol"][name] for name in ("protocol", "consensus", "assignment", "shield")},
        **{name: getattr(trial, name) for name in own},
        "earlier_tries": len(costs),
        "earlier_cost_usd": None if None in costs else sum(cost for cost in costs if cost is not None),
        **{AXIS + name: value for name, value in trial.axes.items()},
    }


def _counts(counts: Mapping[str, int] | None) -> str | None:
    return None if counts is None else " ".join(f"{name}={count}" for name, count in counts.items())


def _words(words: Iterable[str] | None) -> str | None:
    return None if words is None else " ".join(words)


def _natural(text: str) -> list[tuple[int, int | str]]:
    """A key that sorts triangle/6 before triangle/10."""
    return [
        (0, int(part)) if part.isascii() and part.isdigit() and len(part) < 1_000 else (1, part)
        for part in re.split(r"(\d+)", text)
    ]
