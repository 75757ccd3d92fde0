"""Writes a record as the run happens.

The file is unchunked: every message is a record of its own, so whatever reached the disk can be read. It is handed to
the operating system at the end of each round, so a killed process loses no round that was complete; a machine that
loses power may.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from mcap.writer import IndexType, Writer

from llm_flock.errors import InputError, RecordError
from llm_flock.record.scene import SCHEMA_NAME, SceneDrawer, scene_schema
from llm_flock.record.schema import (
    CHANNELS,
    ROUND_NS,
    SCENE_TOPIC,
    TOPICS,
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
    Summary,
    channel_schema,
)

LIBRARY = "llm-flock"
BUFFER_BYTES = 1 << 20
"""Larger than most rounds, so that the file usually grows by whole rounds [bytes]."""


class RecordSink(Protocol):
    """Takes note of a run. `run` and `mission` come first; `end_round` closes each round, from round 0 on."""

    def run(self, info: RunInfo) -> None:
        """Where the run came from."""
        ...

    def mission(self, info: MissionInfo) -> None:
        """What the team is asked to do."""
        ...

    def plan(self, info: PlanInfo) -> None:
        """A plan that was not seen before."""
        ...

    def state(self, state: State) -> None:
        """Every robot after a round."""
        ...

    def event(self, event: ProtocolEvent) -> None:
        """Something that a robot decided or met."""
        ...

    def llm(self, entry: LlmEntry) -> None:
        """One call of a language model."""
        ...

    def metrics(self, row: MetricsRow) -> None:
        """The figures of one round."""
        ...

    def body(self, sample: BodySample) -> None:
        """Every body of a flight at a time."""
        ...

    def flight(self, event: FlightEvent) -> None:
        """What happened to a flight."""
        ...

    def end_round(self, number: int) -> None:
        """The round is complete and must survive whatever comes."""
        ...

    def summary(self, result: Mapping[str, Any]) -> None:
        """What the run reports, at a clean end."""
        ...

    def close(self) -> None:
        """No more is to come. May be called twice."""
        ...


class NullWriter:
    """Takes note of nothing, for runs without a record."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def run(self, info: RunInfo) -> None:
        """Ignored."""

    def mission(self, info: MissionInfo) -> None:
        """Ignored."""

    def plan(self, info: PlanInfo) -> None:
        """Ignored."""

    def state(self, state: State) -> None:
        """Ignored."""

    def event(self, event: ProtocolEvent) -> None:
        """Ignored."""

    def llm(self, entry: LlmEntry) -> None:
        """Ignored."""

    def metrics(self, row: MetricsRow) -> None:
        """Ignored."""

    def body(self, sample: BodySample) -> None:
        """Ignored."""

    def flight(self, event: FlightEvent) -> None:
        """Ignored."""

    def end_round(self, number: int) -> None:
        """Ignored."""

    def summary(self, result: Mapping[str, Any]) -> None:
        """Ignored."""

    def close(self) -> None:
        """Nothing to close."""


class Tee:
    """Hands everything to two sinks, the first one first."""

    def __init__(self, first: RecordSink, second: RecordSink) -> None:
        self._both = (first, second)

    def run(self, info: RunInfo) -> None:
        """To both."""
        for sink in self._both:
            sink.run(info)

    def mission(self, info: MissionInfo) -> None:
        """To both."""
        for sink in self._both:
            sink.mission(info)

    def plan(self, info: PlanInfo) -> None:
        """To both."""
        for sink in self._both:
            sink.plan(info)

    def state(self, state: State) -> None:
        """To both."""
        for sink in self._both:
            sink.state(state)

    def event(self, event: ProtocolEvent) -> None:
        """To both."""
        for sink in self._both:
            sink.event(event)

    def llm(self, entry: LlmEntry) -> None:
        """To both."""
        for sink in self._both:
            sink.llm(entry)

    def metrics(self, row: MetricsRow) -> None:
        """To both."""
        for sink in self._both:
            sink.metrics(row)

    def body(self, sample: BodySample) -> None:
        """To both."""
        for sink in self._both:
            sink.body(sample)

    def flight(self, event: FlightEvent) -> None:
        """To both."""
        for sink in self._both:
            sink.flight(event)

    def end_round(self, number: int) -> None:
        """To both."""
        for sink in self._both:
            sink.end_round(number)

    def summary(self, result: Mapping[str, Any]) -> None:
        """To both."""
        for sink in self._both:
            sink.summary(result)

    def close(self) -> None:
        """To both."""
        for sink in self._both:
            sink.close()


class RecordWriter:
    """Writes one MCAP file; a context manager.

    Args:
        path: file to write; missing folders are made, an existing file is never overwritten.

    Raises:
        InputError: the file exists, or cannot be made.
        RecordError: by every method, when the disk does not take what is written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb", buffering=BUFFER_BYTES)
        except OSError as error:
            if path.exists():
                raise InputError("out", str(path), "a place without a record: none is ever overwritten") from None
            raise InputError("out", str(path), f"a place that can be written to ({error.strerror})") from None
        self._mcap = Writer(
            self._file, use_chunking=False, index_types=IndexType.NONE, use_summary_offsets=False, enable_crcs=True
        )
        self._mcap.start(library=LIBRARY)
        self._sequence: Counter[str] = Counter()
        self._channels = {
            topic: self._register(topic, f"llm_flock.{model.__name__}", channel_schema(model))
            for topic, model in CHANNELS.items()
        }
        self._channels[SCENE_TOPIC] = self._register(SCENE_TOPIC, SCHEMA_NAME, scene_schema())
        self._scene: SceneDrawer | None = None
        self._last_round = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def run(self, info: RunInfo) -> None:
        """Where the run came from."""
        self._put(info, 0)

    def mission(self, info: MissionInfo) -> None:
        """What the team is asked to do."""
        if self._scene is None:  # colours of plans stay, whatever the mission; a mission changes no size and no range
            self._scene = SceneDrawer(info)
        self._put(info, info.round)

    def plan(self, info: PlanInfo) -> None:
        """A plan that was not seen before."""
        if self._scene is not None:
            self._scene.know([info.plan_id])
        self._put(info, info.round)

    def state(self, state: State) -> None:
        """Every robot after a round; draws the scene as well.

        Raises:
            RecordError: no mission was written before.
        """
        if self._scene is None:
            raise RecordError(f"{self.path}: a state comes before the mission")
        self._put(state, state.round)
        self._write(SCENE_TOPIC, self._scene.draw(state), state.round)

    def event(self, event: ProtocolEvent) -> None:
        """Something that a robot decided or met."""
        self._put(event, event.round)

    def llm(self, entry: LlmEntry) -> None:
        """One call of a language model."""
        self._put(entry, entry.round)

    def metrics(self, row: MetricsRow) -> None:
        """The figures of one round."""
        self._put(row, row.round)

    def body(self, sample: BodySample) -> None:
        """Every body of a flight at a time."""
        self._put(sample, sample.round)

    def flight(self, event: FlightEvent) -> None:
        """What happened to a flight; handed to the operating system at once, with all that came before."""
        self._put(event, event.round)
        self._flush()

    def end_round(self, number: int) -> None:
        """Mark the round as complete and hand it to the operating system."""
        self._last_round = number
        self._put(RoundEnd(round=number), number)
        self._flush()

    def summary(self, result: Mapping[str, Any]) -> None:
        """What the run reports, at a clean end."""
        self._put(Summary(result=dict(result)), self._last_round)
        self._flush()

    def close(self) -> None:
        """Write the end of the file and close it. May be called twice."""
        if self._file.closed:
            return
        try:
            self._mcap.finish()
        except OSError as error:
            raise self._failure(error) from error
        finally:
            self._close_file()

    def _close_file(self) -> None:
        try:
            self._file.close()
        except OSError as error:
            raise self._failure(error) from error

    def _register(self, topic: str, name: str, schema: Mapping[str, Any]) -> int:
        number = self._mcap.register_schema(name, "jsonschema", json.dumps(schema, separators=(",", ":")).encode())
        return self._mcap.register_channel(topic, "json", number)

    def _put(self, entry: Entry, number: int) -> None:
        self._write(TOPICS[type(entry)], entry.encoded(), number)

    def _write(self, topic: str, data: bytes, number: int) -> None:
        time = number * ROUND_NS
        sequence = self._sequence[topic]
        self._sequence[topic] = sequence + 1
        try:
            self._mcap.add_message(self._channels[topic], time, data, time, sequence)
        except OSError as error:
            raise self._failure(error) from error

    def _flush(self) -> None:
        try:
            self._file.flush()
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> RecordError:
        return RecordError(f"{self.path}: cannot be written ({error.strerror})")
