"""Reads whole records, also those whose end is missing because the run was killed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from llm_flock import plugins
from llm_flock.errors import InputError, RecordError
from llm_flock.extras import ExtraMissing, require
from llm_flock.record import RECORD_NAME
from llm_flock.record._diagnosis import Diagnosis, diagnose
from llm_flock.record._history import RunHistory
from llm_flock.record._outcome import RunOutcome, outcome_of
from llm_flock.record._schema import (
    BodySample,
    Entry,
    FlightEvent,
    LlmEntry,
    MetricsRow,
    MissionInfo,
    PlanInfo,
    ProtocolEvent,
    RoundEnd,
    RunInfo,
    State,
    SummaryMessage,
)
from llm_flock.record._stream import ROS_BAG, RawMessage, RecordStream, record_file
from llm_flock.record._words import ending

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingTypeStubs]
    import polars

E = TypeVar("E", bound=Entry)

TableName: TypeAlias = Literal["rounds", "robots"]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RunRecord:
    """One run, read into memory: its complete rounds, the start included, and the summary of a clean end."""

    path: Path
    run: RunInfo
    missions: tuple[MissionInfo, ...]
    plans: tuple[PlanInfo, ...]
    states: tuple[State, ...]
    events: tuple[ProtocolEvent, ...] = field(repr=False)
    llm: tuple[LlmEntry, ...] = field(repr=False)
    metrics: tuple[MetricsRow, ...] = field(repr=False)
    bodies: tuple[BodySample, ...] = field(repr=False)  # of a real flight [m]
    flight: tuple[FlightEvent, ...] = field(repr=False)
    result: dict[str, Any] | None  # None when the run did not end cleanly
    positions: NDArray[np.float64] = field(repr=False)  # true ones, shape (rounds + 1, n, d) [units; world frame]

    @property
    def complete(self) -> bool:
        """Whether the run came to a clean end; False after a fault, a crash or a kill."""
        return self.result is not None and self.result.get("stopped") != "failed"

    @property
    def mission(self) -> MissionInfo:
        """The last mission."""
        return self.missions[-1]

    @property
    def rounds(self) -> int:
        """Complete motion rounds, the start not counted."""
        return len(self.states) - 1

    @property
    def errors(self) -> NDArray[np.float64]:
        """Mean Procrustes error of each round [units], shape (rounds + 1,); NaN if it is not known."""
        means = [row.procrustes_mean for row in self.metrics]
        return np.array([np.nan if mean is None else mean for mean in means], dtype=np.float64)

    @property
    def models(self) -> tuple[str, ...]:
        """The models that were called, each once, in the order of their first calls."""
        return tuple(dict.fromkeys(entry.model for entry in self.llm))

    def diagnosis(self) -> Diagnosis:
        """Why the team did not form its last mission; empty for a run that formed, or has no round."""
        return Diagnosis() if ending(self.result) == "formed" else diagnose(self._history())

    def outcome(self) -> RunOutcome:
        """What came of the run: whether, when and until when its last mission was formed, or how it ended."""
        return outcome_of(self._history())

    def _history(self) -> RunHistory:
        end = () if self.result is None else (SummaryMessage(result=self.result),)
        seen = (self.run, *self.missions, *self.plans, *self.states, *self.metrics, *self.events, *self.llm)
        return RunHistory.of((*seen, RoundEnd(round=self.rounds), *end))

    def animate(self, *, fps: int = 12) -> Any:
        """The run as an animation that a notebook shows, and `save` writes; `fps` frames a second, four a round."""
        if "animation" not in plugins.entries("views"):
            raise ExtraMissing("animate()", "figures")
        return plugins.load("views", "animation")(self, fps=fps)

    def to_polars(self, table: TableName = "rounds") -> polars.DataFrame:
        """The run as a table: `rounds` has a row for each round, `robots` one for each robot and round.

        Needs the extra `sweep`.
        """
        require("sweep", "to_polars()")
        import polars as pl

        table_columns = columns(self, table)
        return pl.DataFrame(table_columns, schema={name: getattr(pl, _kind(name)) for name in table_columns})

    def to_pandas(self, table: TableName = "rounds") -> pandas.DataFrame:
        """As `to_polars`, for pandas, where whole numbers that may be missing are of type Int64.

        Needs the extra `notebook`.
        """
        require("notebook", "to_pandas()")
        table_columns = columns(self, table)
        library: Any = import_module("pandas")
        frame = library.DataFrame(table_columns)
        kinds = {name: "Int64" for name in ("slot", "in_order_since") if name in table_columns}
        kinds |= {name: "float64" for name in table_columns if _kind(name) == "Float64"}
        return cast("pandas.DataFrame", frame.astype(kinds))

    def __repr__(self) -> str:
        state = "complete" if self.complete else "ends early"
        return f"RunRecord({self.path}, {self.positions.shape[1]} robots, {self.rounds} rounds, {state})"

    def html(self) -> str | None:
        """The picture and the table that a notebook shows; None if no installed part draws them."""
        return plugins.load("views", "html")(self) if "html" in plugins.entries("views") else None

    def _repr_html_(self) -> str | None:
        return self.html()


KINDS: dict[str, str] = {
    name: {int: "Int64", bool: "Boolean"}.get(cast("type", info.annotation), "Float64")
    for name, info in MetricsRow.model_fields.items()
    if name != "messages_rejected"
} | {"in_order_since": "Int64"}
"""Columns of the table of rounds, which are the fields of `/metrics`, and their types in polars."""

KINDS_OF_ROBOTS = {"robot": "Int64", "slot": "Int64", "plan_id": "String", "origin": "String", "phase": "String"}
"""Types of the columns of the table of robots that are neither the round nor a coordinate."""


def columns(record: RunRecord, table: TableName) -> dict[str, list[Any]]:
    """The columns of a table, all of one length; None without a value. Positions are true ones [units]."""
    if table == "rounds":
        return {name: [getattr(row, name) for row in record.metrics] for name in KINDS}
    if table != "robots":
        raise InputError("table", table, "rounds or robots")
    axes = ("x", "y", "z")[: record.positions.shape[2]]
    names = ("round", "robot", *axes, *(f"goal_{axis}" for axis in axes), "slot", "plan_id", "origin", "phase")
    table_columns: dict[str, list[Any]] = {name: [] for name in names}
    for state in record.states:
        robots = range(len(state.positions))
        table_columns["round"] += [state.round] * len(robots)
        table_columns["robot"] += robots
        for k, axis in enumerate(axes):
            table_columns[axis] += [place[k] for place in state.positions]
            table_columns[f"goal_{axis}"] += [None if goal is None else goal[k] for goal in state.goals]
        table_columns["slot"] += state.slots
        table_columns["plan_id"] += state.plan_ids
        table_columns["origin"] += state.origins
        table_columns["phase"] += state.phases
    return table_columns


def _kind(name: str) -> str:
    return (KINDS | KINDS_OF_ROBOTS).get(name, "Float64")


def iter_messages(path: str | Path) -> Iterator[RawMessage]:
    """Every whole message of a record in the order of writing. Ends without error at the end of a killed run."""
    yield from _open(record_file(path)).messages()


def read_record(path: str | Path) -> RunRecord:
    """Read a record, the file or the folder that holds its `run.mcap`, up to its last complete round.

    Raises:
        RecordError: the file is missing, empty, not a record, of a newer format, damaged, or ends before round 0 did.
    """
    path = record_file(path)
    entries: list[Entry] = []
    kept = 0
    for entry in _open(path).entries():
        entries.append(entry)
        if isinstance(entry, RoundEnd | SummaryMessage):
            kept = len(entries)  # up to here, all belongs to complete rounds, or to a run that ended cleanly within one
    return gather_record(path, entries[:kept])


def gather_record(path: Path, entries: Iterable[Entry]) -> RunRecord:
    """A record of entries in the order of writing, which may lack no round, run or mission; `path` is only named."""
    by_model: defaultdict[type[Entry], list[Any]] = defaultdict(list)
    for entry in entries:
        by_model[type(entry)].append(entry)

    def all_of(model: type[E]) -> tuple[E, ...]:
        return tuple(by_model[model])

    runs, missions, rounds = all_of(RunInfo), all_of(MissionInfo), len(all_of(RoundEnd))
    if not rounds:
        raise RecordError(f"{path}: the run ended before its start was recorded; there is nothing to show")
    states, metrics = all_of(State)[:rounds], all_of(MetricsRow)[:rounds]
    if not runs or not missions or len(states) != rounds:
        raise RecordError(f"{path}: not a record of a run (/run, /mission or /state is missing)")
    results = all_of(SummaryMessage)
    return RunRecord(
        path=path,
        run=runs[0],
        missions=missions,
        plans=all_of(PlanInfo),
        states=states,
        events=all_of(ProtocolEvent),
        llm=all_of(LlmEntry),
        metrics=metrics,
        bodies=all_of(BodySample),
        flight=all_of(FlightEvent),
        result=results[-1].result if results else None,
        positions=np.array([state.positions for state in states], dtype=np.float64),
    )


def _open(path: Path) -> RecordStream:
    try:
        if path.stat().st_size == 0:
            raise RecordError(f"{path}: empty file")
    except OSError as error:
        if path.name == RECORD_NAME and (path.parent / "metadata.yaml").is_file():
            raise RecordError(f"{path.parent}: {ROS_BAG}") from None
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:  # NUL in the name
        raise RecordError(f"{path}: cannot be read ({error})") from None
    return RecordStream(path)
