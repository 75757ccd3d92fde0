"""A run as tables: columns for polars and pandas."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

from llm_flock.errors import InputError
from llm_flock.extras import require
from llm_flock.record._schema import MetricsRow

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingTypeStubs]
    import polars

    from llm_flock.record._reader import RunRecord

TableName: TypeAlias = Literal["rounds", "robots"]

AXES = ("x", "y", "z")

FIGURES = tuple(name for name in MetricsRow.model_fields if name != "messages_rejected")
"""Columns of the table of rounds: the fields of `/metrics`."""

TEXTS = frozenset({"plan_id", "origin", "phase"})
WHOLE = frozenset({"round", "robot", "slot", "plans_in_use", "distinct_goals", "robots_at_goal"}) | {
    "model_calls",
    "tokens",
    "messages_sent",
    "bytes_sent",
}


def columns(record: RunRecord, table: TableName) -> dict[str, list[Any]]:
    """The columns of a table, all of one length; None where there is no value.

    `rounds`: the figures of each round, from the start, which is round 0. `robots`: of each round and robot its true
    position [units; world frame], the goal it heads for, its slot and plan, who supplied its waypoint, and its phase.

    Raises:
        InputError: there is no such table.
    """
    if table == "rounds":
        return {name: [getattr(row, name) for row in record.metrics] for name in FIGURES}
    if table != "robots":
        raise InputError("table", table, "rounds or robots")
    dim = record.positions.shape[2]
    found: dict[str, list[Any]] = {name: [] for name in ("round", "robot", *AXES[:dim])}
    found |= {f"goal_{axis}": [] for axis in AXES[:dim]}
    found |= {name: [] for name in ("slot", "plan_id", "origin", "phase")}
    for state in record.states:
        robots = range(len(state.positions))
        found["round"] += [state.round] * len(robots)
        found["robot"] += robots
        for k, axis in enumerate(AXES[:dim]):
            found[axis] += [place[k] for place in state.positions]
            found[f"goal_{axis}"] += [None if goal is None else goal[k] for goal in state.goals]
        found["slot"] += state.slots
        found["plan_id"] += state.plan_ids
        found["origin"] += state.origins
        found["phase"] += state.phases
    return found


def to_polars(record: RunRecord, table: TableName) -> polars.DataFrame:
    """A table as a polars frame.

    Raises:
        InputError: there is no such table.
        ExtraMissing: the extra `sweep` is not installed.
    """
    require("sweep", "to_polars()")
    import polars as pl

    def kind(name: str) -> Any:
        return (
            pl.Int64
            if name in WHOLE
            else pl.String
            if name in TEXTS
            else pl.Boolean
            if name == "connected"
            else pl.Float64
        )

    found = columns(record, table)
    return pl.DataFrame(found, schema={name: kind(name) for name in found})


def to_pandas(record: RunRecord, table: TableName) -> pandas.DataFrame:
    """A table as a pandas frame; whole numbers that may be missing are of type Int64.

    Raises:
        InputError: there is no such table.
        ExtraMissing: the extra `notebook` is not installed.
    """
    require("notebook", "to_pandas()")
    found = columns(record, table)
    library: Any = import_module("pandas")
    frame = library.DataFrame(found)
    kinds = {name: "Int64" for name in ("slot",) if name in found}
    kinds |= {name: "float64" for name in found if name not in WHOLE | TEXTS | {"connected"}}
    return cast("pandas.DataFrame", frame.astype(kinds))
