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

KINDS: dict[str, str] = {
    name: {int: "Int64", bool: "Boolean"}.get(cast("type", info.annotation), "Float64")
    for name, info in MetricsRow.model_fields.items()
    if name != "messages_rejected"
}
"""Columns of the table of rounds, which are the fields of `/metrics`, and their types in polars."""

KINDS_OF_ROBOTS = {"robot": "Int64", "slot": "Int64", "plan_id": "String", "origin": "String", "phase": "String"}
"""Types of the columns of the table of robots that are neither the round nor a coordinate."""


def columns(record: RunRecord, table: TableName) -> dict[str, list[Any]]:
    """The columns of a table, all of one length; None where there is no value.

    `rounds`: the figures of each round, from the start, which is round 0. `robots`: of each round and robot its true
    position [units; world frame], the goal it heads for, its slot and plan, who supplied its waypoint, and its phase.
    """
    if table == "rounds":
        return {name: [getattr(row, name) for row in record.metrics] for name in KINDS}
    if table != "robots":
        raise InputError("table", table, "rounds or robots")
    axes = ("x", "y", "z")[: record.positions.shape[2]]
    names = ("round", "robot", *axes, *(f"goal_{axis}" for axis in axes), "slot", "plan_id", "origin", "phase")
    found: dict[str, list[Any]] = {name: [] for name in names}
    for state in record.states:
        robots = range(len(state.positions))
        found["round"] += [state.round] * len(robots)
        found["robot"] += robots
        for k, axis in enumerate(axes):
            found[axis] += [place[k] for place in state.positions]
            found[f"goal_{axis}"] += [None if goal is None else goal[k] for goal in state.goals]
        found["slot"] += state.slots
        found["plan_id"] += state.plan_ids
        found["origin"] += state.origins
        found["phase"] += state.phases
    return found


def to_polars(record: RunRecord, table: TableName) -> polars.DataFrame:
    """A table as a polars frame; needs the extra `sweep`."""
    require("sweep", "to_polars()")
    import polars as pl

    found = columns(record, table)
    return pl.DataFrame(found, schema={name: getattr(pl, _kind(name)) for name in found})


def _kind(name: str) -> str:
    return (KINDS | KINDS_OF_ROBOTS).get(name, "Float64")


def to_pandas(record: RunRecord, table: TableName) -> pandas.DataFrame:
    """A table as a pandas frame; whole numbers that may be missing are of type Int64. Needs the extra `notebook`."""
    require("notebook", "to_pandas()")
    found = columns(record, table)
    library: Any = import_module("pandas")
    frame = library.DataFrame(found)
    kinds = {name: "Int64" for name in ("slot",) if name in found}
    kinds |= {name: "float64" for name in found if _kind(name) == "Float64"}
    return cast("pandas.DataFrame", frame.astype(kinds))
