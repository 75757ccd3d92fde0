"""Reads whole records, also those whose end is missing because the run was killed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from llm_flock.errors import RecordError
from llm_flock.record.schema import (
    CHANNELS,
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
from llm_flock.record.stream import RawMessage, RecordStream

E = TypeVar("E", bound=Entry)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """One run, read into memory: its complete rounds, and the summary of a clean end.

    Attributes:
        missions: every mission, oldest first.
        plans: every plan, in the order in which they were first seen.
        states: the team after each round; the first is the start.
        bodies: of a real flight, every drone about ten times a second, measured and commanded [m].
        result: the run's summary; None when it did not end cleanly.
        positions: true positions, shape (rounds + 1, n, d) [units; world frame].
    """

    path: Path
    run: RunInfo
    missions: tuple[MissionInfo, ...]
    plans: tuple[PlanInfo, ...]
    states: tuple[State, ...]
    events: tuple[ProtocolEvent, ...] = field(repr=False)
    llm: tuple[LlmEntry, ...] = field(repr=False)
    metrics: tuple[MetricsRow, ...] = field(repr=False)
    bodies: tuple[BodySample, ...] = field(repr=False)
    flight: tuple[FlightEvent, ...] = field(repr=False)
    result: dict[str, Any] | None
    positions: NDArray[np.float64] = field(repr=False)

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
        """Mean Procrustes error of each round [units], shape (rounds + 1,); NaN where it is not known."""
        means = [row.procrustes_mean for row in self.metrics]
        return np.array([np.nan if mean is None else mean for mean in means], dtype=np.float64)

    @property
    def models(self) -> tuple[str, ...]:
        """The models that were called, each once, in the order of their first calls."""
        return tuple(dict.fromkeys(entry.model for entry in self.llm))


def iter_messages(path: Path) -> Iterator[RawMessage]:
    """Every whole message of a record in the order of writing; ends quietly where a killed run broke off.

    Call it for records that do not fit into memory, or to see messages as they stand in the file.

    Raises:
        RecordError: there is no such file, it is no MCAP file, or it is damaged other than at its end.
    """
    yield from _open(path).messages()


def read_record(path: Path) -> RunRecord:
    """Read a record up to its last complete round.

    Raises:
        RecordError: the file is missing, empty, not a record, of a newer format, damaged, or ends before round 0 did.
    """
    found: dict[type[Entry], list[Entry]] = {model: [] for model in CHANNELS.values()}
    kept = dict.fromkeys(found, 0)
    for entry in _open(path).entries():
        found[type(entry)].append(entry)
        if isinstance(entry, RoundEnd | SummaryMessage):
            # Everything up to here belongs to complete rounds, or to a run that ended cleanly within one.
            kept = {kind: len(entries) for kind, entries in found.items()}

    def all_of(model: type[E]) -> tuple[E, ...]:
        return tuple(entry for entry in found[model][: kept[model]] if isinstance(entry, model))

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
        size = path.stat().st_size
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from None
    if size == 0:
        raise RecordError(f"{path}: empty file")
    return RecordStream(path)
